"""What the figures choose and how numbers are written."""

import re

import matplotlib
import numpy as np
import pytest

from torchrbd.inference.results import TorqueSeries
from torchrbd.report.excerpt import binned_mean, informative_excerpt, telling_signal
from torchrbd.report.figures import Units, decades, dependence_figure, error_figure
from torchrbd.report.inline import canvas, inline, page_style
from torchrbd.report.text.numbers import change, measure, number, probability, unit


def series(residual: np.ndarray, held_out: np.ndarray, signal: np.ndarray | None = None) -> TorqueSeries:
    """One joint, two recordings of 40 s at 10 Hz."""
    rng, m = np.random.default_rng(1), 800
    q, qd, qdd = rng.standard_normal((3, m, 1))
    qd = qd if signal is None else signal[:, None]
    recording, t = np.repeat([0, 1], m // 2), np.tile(np.arange(m // 2) / 10, 2)
    tau = residual[:, None]
    return TorqueSeries(("j",), ("a", "b"), recording, t, held_out, q, qd, qdd, tau, {"urdf": np.zeros((m, 1))})


def test_stretch_holds_the_largest_held_out_residual_and_stays_in_one_recording():
    residual, held_out = np.full(800, 0.1), np.arange(800) >= 400
    residual[100:200] = 50.0  # seen by the fit
    residual[600:650] = 5.0  # held out: second recording, 20 to 25 s
    excerpt = informative_excerpt(series(residual, held_out), 0, "urdf")
    assert excerpt.recording == "b"
    assert set(range(600, 650)) <= set(excerpt.index)
    assert len(excerpt.index) == 151
    assert excerpt.index.min() >= 400


def test_short_recording_is_shown_whole():
    s = series(np.ones(800), np.ones(800, dtype=bool))
    short = TorqueSeries(
        s.joints, s.recordings, s.recording, s.t / 10, s.held_out, s.q, s.qd, s.qdd, s.measured, s.predicted
    )
    excerpt = informative_excerpt(short, 0, "urdf")
    assert len(excerpt.index) == 400
    assert excerpt.words == "a"


def test_telling_signal_of_friction_is_the_velocity():
    qd = np.random.default_rng(2).standard_normal(800)
    assert telling_signal(series(np.sign(qd), np.ones(800, dtype=bool), qd), 0, "urdf") == "qd"


def test_binned_mean_is_the_loop_over_bins_and_zero_is_an_edge():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-1, 1, (2, 900))
    centre, mean, error, count = binned_mean(x, y)
    width = centre[1] - centre[0]
    assert np.abs(centre / width - np.round(centre / width)).min() > 0.49
    for c, m, e, k in list(zip(centre, mean, error, count, strict=True))[1:-1]:
        inside = y[(x >= c - width / 2) & (x < c + width / 2)]
        assert (m, k) == (pytest.approx(inside.mean()), len(inside))
        assert e == pytest.approx(inside.std() / np.sqrt(len(inside)), rel=0.5)  # nearly every visit is one sample


def test_error_of_a_bin_does_not_shrink_with_repeated_samples():
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-1, 1, (2, 900))
    once, often = binned_mean(x, y), binned_mean(np.repeat(x, 10), np.repeat(y, 10))
    for few, many in zip(once[:3], often[:3], strict=True):  # only the scarce last bin may differ
        np.testing.assert_allclose(many[: len(few) - 1], few[:-1], rtol=2e-3)


@pytest.mark.parametrize("x", [np.zeros(40), np.full(40, -3.0), np.arange(40.0), np.zeros(1)])
def test_constant_or_few_samples_still_have_bins(x):
    centre, mean, error, count = binned_mean(x, np.ones(len(x)))
    assert len(centre) == len(mean) == len(error) == len(count)
    np.testing.assert_allclose(mean, 1.0)


def test_a_single_visit_has_no_error():
    assert np.isnan(binned_mean(np.arange(240.0), np.random.default_rng(5).standard_normal(240))[2]).all()


def test_decades_hold_all_errors():
    assert decades([3e-5, 0.2, float("nan"), 0.0]) == pytest.approx((1e-5, 1.0))
    assert decades([float("nan")]) == (1.0, 10.0)


def test_inlined_figure_names_nothing_outside_itself_and_clashes_with_no_other():
    s = series(np.ones(800), np.ones(800, dtype=bool))
    with page_style():
        figures = [dependence_figure(s, 0, ("q", 0), (Units("N", "m"),) * 2, ["urdf"]) for _ in range(2)]
        a, b = (inline(f, "<residual>", f"f{i}") for i, f in enumerate(figures))
        inline(error_figure({"urdf": float("nan")}, (1.0, 10.0)), "nothing", "f2")
    names = [set(re.findall(r'\bid="([^"]+)"', svg)) for svg in (a, b)]
    assert names[0]
    assert not names[0] & names[1]
    assert set(re.findall(r'(?:href="|url\()#([^")]+)', a)) <= names[0]
    assert 'href="data:image/png' in a
    assert re.match(r'<svg viewBox="0 0 510 250" role="img" aria-label="&lt;residual&gt;">', a)
    assert not re.search(r"https?:|<style|<metadata|<!", a)


def test_names_that_matplotlib_cannot_draw_stay_text():
    with page_style():
        figure = canvas(100, 50)
        figure.text(0, 0, "$q_1$ 関節 <b>")
        svg = inline(figure, "", "f")
    assert "$q_1$ 関節 &lt;b&gt;" in svg


def test_style_of_the_user_is_neither_used_nor_changed():
    with matplotlib.rc_context({"font.size": 31.0, "text.parse_math": True}):
        with page_style():
            assert matplotlib.rcParams["font.size"] == 12
        assert matplotlib.rcParams["font.size"] == 31
        assert matplotlib.rcParams["text.parse_math"]


def test_numbers_are_short_and_honest():
    assert [number(x) for x in (0.0, 0.11, 12.345, 1234.5, -3.21e-6, float("nan"))] == [
        "0", "0.110", "12.3", "1234", "−3.21·10⁻⁶", "–",
    ]  # fmt: skip
    assert [measure(2.41, 0.021), measure(-150.4, 12.0), measure(1.0, 0.0)] == ["2.410 ± 0.021", "−150 ± 12", "1.00"]
    assert [probability(x) for x in (1.0, 0.999, 0.5, 0.001, 0.0)] == ["100 %", "> 99 %", "50 %", "< 1 %", "0 %"]
    assert [change(1.0, 0.5), change(1.0, 1.2), change(1.0, 1e-3), change(0.0, 1.0)] == [
        "−50 %",
        "+20 %",
        "1\u202f000 times less",
        "",
    ]
    assert unit("kg m^2") == "kg m²"
