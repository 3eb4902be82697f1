"""What the figures choose and how numbers are written."""

import numpy as np
import pytest

from torchrbd.inference.results import TorqueSeries
from torchrbd.report.figures import ErrorScale, binned_median, informative_stretch, telling_signal
from torchrbd.report.page import change, measure, number, percent
from torchrbd.report.svg import Axes, limits, ticks


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
    stretch = informative_stretch(series(residual, held_out), 0, "urdf")
    assert stretch.recording == "b"
    assert set(range(600, 650)) <= set(stretch.index)
    assert len(stretch.index) == 151
    assert stretch.index.min() >= 400


def test_short_recording_is_shown_whole():
    s = series(np.ones(800), np.ones(800, dtype=bool))
    short = TorqueSeries(
        s.joints, s.recordings, s.recording, s.t / 10, s.held_out, s.q, s.qd, s.qdd, s.measured, s.predicted
    )
    stretch = informative_stretch(short, 0, "urdf")
    assert len(stretch.index) == 400
    assert stretch.words == "a"


def test_telling_signal_of_friction_is_the_velocity():
    qd = np.random.default_rng(2).standard_normal(800)
    assert telling_signal(series(np.sign(qd), np.ones(800, dtype=bool), qd), 0, "urdf") == "qd"


def test_binned_median_is_the_loop_over_bins():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-1, 1, (2, 900))
    centre, median, count = binned_median(x, y)
    width = centre[1] - centre[0]
    for c, m, k in list(zip(centre, median, count, strict=True))[1:-1]:
        inside = y[(x >= c - width / 2) & (x < c + width / 2)]
        assert (np.median(inside), len(inside)) == (m, k)


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.1, 2.9), (1e-7, 3e-7), (-2e5, 9e5)])
def test_ticks_are_round_inside_and_evenly_apart(low, high):
    found = ticks(low, high, about=5)
    assert 3 <= len(found) <= 9
    assert found[0] >= low - 1e-9 * (high - low)
    assert found[-1] <= high + 1e-9 * (high - low)
    leading = np.diff(found) / 10 ** np.floor(np.log10(np.diff(found)) + 1e-9)
    np.testing.assert_allclose(leading, np.round(leading[0]), rtol=1e-6)


def test_limits_of_constant_or_missing_data_are_not_empty():
    for values in (np.full(3, 2.0), np.zeros(3), np.full(3, np.nan)):
        low, high = limits(values)
        assert low < high


def test_line_breaks_at_nan():
    line = Axes(0, 0, 10, 10, (0, 4), (0, 1)).line(np.arange(5.0), np.array([0, 1, np.nan, 0, 1]), "urdf")
    assert str(line).count("M") == 2
    assert "nan" not in line


def test_error_scale_holds_all_errors():
    assert ErrorScale.over([3e-5, 0.2, float("nan"), 0.0]) == ErrorScale(-5, 0)
    assert ErrorScale.over([float("nan")]) == ErrorScale(0, 1)


def test_numbers_are_short_and_honest():
    assert [number(x) for x in (0.0, 0.11, 12.345, 1234.5, -3.21e-6, float("nan"))] == [
        "0", "0.110", "12.3", "1234", "−3.21·10⁻⁶", "–",
    ]  # fmt: skip
    assert [measure(2.41, 0.021), measure(-150.4, 12.0), measure(1.0, 0.0)] == ["2.410 ± 0.021", "−150 ± 12", "1.00"]
    assert [percent(x) for x in (1.0, 0.999, 0.5, 0.001, 0.0)] == ["100 %", "> 99 %", "50 %", "< 1 %", "0 %"]
    assert [change(1.0, 0.5), change(1.0, 1.2), change(1.0, 1e-3), change(0.0, 1.0)] == [
        "−50 %",
        "+20 %",
        "1\u202f000 times less",
        "",
    ]
