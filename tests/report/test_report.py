"""The page opens anywhere, says the verdict first, and shows every joint, measured or not."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from report.fabricated import HEADLINE, diagnosis, identification
from report.rendered import Text, render
from shortened import slow_but

from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.results import HeldOutCheck, Ratio
from torchrbd.display import Remark
from torchrbd.inference.verdict import verdict_of
from torchrbd.report.text.numbers import change, number, sentence
from torchrbd.report.text.verdict import worth

STOPPED = "The fit stopped early: the torques are far from those of any rigid body. Check units and signs."


@pytest.mark.parametrize("n", slow_but((1, 7), (1, 7, 30)))
def test_page_is_one_file_that_needs_nothing_else(tmp_path, n):
    page = render(diagnosis(tuple(f"joint{i + 1}" for i in range(n))), tmp_path)
    names = re.findall(r'\bid="([^"]+)"', page)
    assert len(names) == len(set(names))
    assert not re.search(r"https?:|<script|<link|\bsrc=|@import|url\((?!#)|href=\"(?!#|data:image/png;base64,)", page)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert len(page) < n * 200_000 + 100_000
    Text(page)


@pytest.mark.usefixtures("without_joint_figures")
def test_verdict_comes_before_anything_else(tmp_path):
    words = Text(render(diagnosis(("joint1", "joint2")), tmp_path)).words
    assert words[:2] == ["! Missing physics", HEADLINE]


def test_every_joint_has_its_row_and_figures(tmp_path):
    joints = tuple(f"joint{i + 1}" for i in range(12))
    page = render(diagnosis(joints), tmp_path)
    assert re.findall(r'<section class="panel joint" id="joint-\d+">\s*<header>\s*<h3>(\w+)', page) == list(joints)
    assert page.count('aria-label="torque of') == 12
    assert page.count("where the residual is largest") == 12


def test_figures_are_well_formed_and_finite(tmp_path):
    page = render(diagnosis(("joint1", "joint2"), unmeasured=0), tmp_path)
    text = " ".join(Text(page).words)
    assert "where a finding holds" in text
    assert "position of joint1 [rad]" in text
    figures = re.findall(r"<svg.*?</svg>", page, flags=re.S)
    assert len(figures) > 5
    for svg in figures:
        ET.fromstring(svg)
        assert "nan" not in svg.replace("nmse urdf nan, rigid_body nan", "")


def test_unmeasured_joint_says_so_and_leaves_the_mean_alone(tmp_path):
    text = " ".join(Text(render(identification(("joint1", "joint2"), unmeasured=0), tmp_path)).words)
    assert "torque not recorded" in text
    assert "nothing can be compared" in text
    assert "nan" not in text


@pytest.mark.usefixtures("without_joint_figures")
def test_identification_says_by_how_much_the_error_fell(tmp_path):
    result = identification(("joint1", "joint2"))
    before, after = (result.fits[k].mean_nmse for k in ("urdf", "rigid_body"))
    words = Text(render(result, tmp_path)).words
    assert words[0] == "✓ Identified"
    assert words[1].endswith(f"on held-out data: {number(before)} → {number(after)}.")
    assert "extended" not in " ".join(words)


@pytest.mark.usefixtures("without_joint_figures")
def test_badge_says_what_is_the_case(tmp_path):
    result = identification(("joint1", "joint2"))
    fits = {"urdf": result.fits["rigid_body"], "rigid_body": result.fits["urdf"]}
    worse = replace(result, fits=fits, verdict=verdict_of(fits, ()))
    words = Text(render(worse, tmp_path)).words
    assert words[0] == "✗ Worse than the URDF"
    assert words[1].startswith("Re-fitting raises the mean NMSE of arm on held-out data: ")
    even = replace(worse, verdict="identified")
    assert "does not lower" in Text(render(even, tmp_path)).words[1]
    doubted = identification(("joint1", "joint2"), remarks=(Remark("fit stopped early"),))
    assert Text(render(doubted, tmp_path)).words[0] == "! Identified, with doubts"


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (2.0, 1.0, "−50 %"),
        (1.0, 2.0, "+100 %"),
        (1.0, 4e-4, "2\u202f500 times less"),
        (3e-5, 2.7, "90\u202f000 times more"),
        (1.0, 0.0, "−100 %"),
        (1.0, 0.996, "±0 %"),
        (1.0, 1.004, "±0 %"),
        (1.0, 0.1, "−90 %"),
        (1.0, 1.1, "+10 %"),
        (0.0, 1.0, ""),
    ],
)
def test_change(before, after, words):
    assert change(before, after) == words


@pytest.mark.usefixtures("without_joint_figures")
def test_doubts_stand_under_the_headline_and_notes_at_the_end(tmp_path):
    for result in (
        identification(("joint1", "joint2"), remarks=(Remark("fit stopped early"),)),
        diagnosis(("joint1", "joint2"), remarks=(Remark("fit stopped early"),)),
    ):
        words = Text(render(result, tmp_path)).words
        assert 2 <= words.index(STOPPED) <= 3
        assert words.index("a.csv: columns not used: mode") > words.index("Data and notes")


@pytest.mark.usefixtures("without_joint_figures")
def test_headline_speaks_of_the_last_model(tmp_path):
    result = identification(("joint1", "joint2"), extended=True)
    before, between, after = (result.fits[k].mean_nmse for k in ("urdf", "rigid_body", "extended"))
    words = Text(render(result, tmp_path)).words
    assert words[1].startswith("The extended model lowers the mean NMSE of arm on held-out data: ")
    assert f"{number(before)} → {number(after)}" in words[1]
    assert number(between) in words[2]


@pytest.mark.usefixtures("without_joint_figures")
def test_noise_is_called_what_it_is(tmp_path):
    result = identification(("turn", "slide"))
    words = "position noise 0.000100 {}, torque from {} 0.0200 {}, residual torque 0.0500 {}"
    text = " ".join(Text(render(result, tmp_path)).words)
    assert words.format("rad", "it", "N m", "N m") in text
    assert words.format("m", "it", "N", "N") in text
    smoothed = " ".join(Text(render(replace(result, regime=replace(result.regime, states="smoothed")), tmp_path)).words)
    assert words.format("rad", "it, if filtered,", "N m", "N m") in smoothed


@pytest.mark.usefixtures("without_joint_figures")
def test_what_no_interval_is_known_of_gets_a_dash(tmp_path):
    result = identification(("joint1",))
    unknown = {"std": np.nan, "prior_share": np.nan}
    parameters = [replace(p, **unknown, status="not judged") for p in result.parameters]
    base = [replace(p, **unknown) for p in result.base]
    bare = replace(result, parameters=tuple(parameters), base=tuple(base), covariance=None, base_covariance=None)
    page = render(bare, tmp_path)
    text = " ".join(Text(page).words)
    assert "2.10 ± – kg – not judged" in text
    assert "0.300 ± – kg m² 0.310 – Izz_link1" in text
    assert "This estimator has no intervals" in text
    assert "nan" not in text.lower().split()
    assert "width: nan" not in page
    assert "This estimator has no intervals" not in render(result, tmp_path)


def test_units_follow_the_joint(tmp_path):
    page = render(identification(("turn", "slide")), tmp_path)
    turn, slide = (page.split(f'id="joint-{i}"')[1].split("</section>")[0] for i in (1, 2))
    assert all(label in turn for label in ("torque [N m]", "position [rad]", "velocity [rad/s]"))
    assert all(label in slide for label in ("force [N]", "position [m]", "velocity [m/s]"))


@pytest.mark.usefixtures("without_joint_figures")
def test_parameters_show_interval_prior_share_and_status(tmp_path):
    text = " ".join(Text(render(identification(("joint1",)), tmp_path)).words)
    for part in (
        "m_link1",
        "2.10 ± 0.10",
        "not identifiable",
        "1.000 ± 0.024",
        "Izz_link1 + Iyy_link2",
        "not used: mode",
    ):
        assert part in text


@pytest.mark.usefixtures("without_joint_figures")
def test_names_are_escaped(tmp_path):
    evil = '<b onclick="x">&j'
    page = render(diagnosis((evil, "joint2"), name="<script>alert(1)</script>"), tmp_path)
    assert evil not in page
    assert "<script" not in page
    assert evil in Text(page).words


def test_all_samples_are_shown_if_none_is_held_out(tmp_path):
    result = identification(("joint1", "joint2"))
    series = replace(result.series, held_out=np.zeros(len(result.series.t), dtype=bool))
    page = render(replace(result, series=series), tmp_path)
    assert page.count("<image") == 4


def test_same_result_gives_the_same_page(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    assert render(result, tmp_path) == render(result, tmp_path)


@pytest.mark.parametrize("samples", [1, 2, 40])
def test_a_handful_of_samples_is_enough_for_a_page(tmp_path, samples):
    result = identification(("joint1", "joint2"))
    s, k = result.series, slice(600, 600 + samples)
    arrays = {name: getattr(s, name)[k] for name in ("recording", "t", "held_out", "q", "qd", "qdd", "measured")}
    few = replace(s, **arrays, predicted={m: y[k] for m, y in s.predicted.items()})
    Text(render(replace(result, series=few), tmp_path))


@pytest.mark.usefixtures("without_joint_figures")
def test_consistent_robot_needs_no_findings(tmp_path):
    result = Diagnosis(identification(("joint1", "joint2"), extended=True), "consistent", ())
    words = Text(render(result, tmp_path)).words
    assert words[:2] == ["✓ URDF consistent", "The URDF as given explains the recordings."]
    assert "Probability" not in words


@pytest.mark.usefixtures("without_joint_figures")
def test_worth_of_the_extended_model_is_shown_where_it_has_something(tmp_path):
    result = diagnosis(("joint1", "joint2", "joint3"), unmeasured=0)
    over = {"baseline": Ratio(0.312, 0.252, 0.403), "urdf": Ratio(0.0054, 0.0042, 0.0071)}
    memory = {"urdf": 1.2, "baseline": 0.71, "rigid_body": 0.35, "extended": 0.11}
    worse = {"baseline": Ratio(1.15, 1.08, 1.2), "urdf": Ratio(0.9, 0.7, 1.1)}
    result = replace(
        result,
        held_out_checks=(
            HeldOutCheck("joint2", over, memory, 0.0999),
            HeldOutCheck("joint3", worse, memory | {"extended": 0.4}, 0.0999),
        ),
    )
    page = render(result, tmp_path)
    text = " ".join(Text(page).words).replace("\N{NO-BREAK SPACE}", " ")
    assert "joint2 31 % (25 to 40) 0.54 % (0.42 to 0.71) 1.2 s 0.71 s 0.35 s 0.11 s" in text
    assert "joint3 115 % (108 to 120) 90 % (70 to 110) 1.2 s 0.71 s 0.35 s 0.4 s" in text
    assert "White noise below 5 Hz has 0.1 s" in text
    cells = re.findall(r'<td class="([^"]*)">[^<]* to ', page)
    assert [" ".join(c.split()) for c in cells] == ["group best", "best", "group worse", ""]
    hardly = HeldOutCheck("joint3", worse | {"baseline": Ratio(1.01, 1.005, 1.02)}, memory, 0.0999)
    assert "group worse" not in " ".join(render(replace(result, held_out_checks=(hardly,)), tmp_path).split())
    for without in (replace(result, findings=()), replace(result, held_out_checks=()), result.identification):
        assert "autocorrelation" not in render(without, tmp_path)


def test_one_line_says_what_findings_are_worth():
    result, memory = diagnosis(("joint1",)), dict.fromkeys(("urdf", "baseline", "extended"), 0.1)

    def told(*parts: float) -> str:
        ratios = ({"baseline": Ratio(x, 0.9 * x, 1.1 * x), "urdf": Ratio(x, x, x)} for x in parts)
        return worth(
            replace(result, held_out_checks=tuple(HeldOutCheck(f"j{k}", r, memory, 0.1) for k, r in enumerate(ratios)))
        )

    begin = "Squared error on held-out data relative to least squares with friction, with 95 % intervals: "
    assert told(0.5, 1.0, 0.2) == f"{begin}20 % (18 to 22) at j2 and 50 % (45 to 55) at j0."
    assert told(0.5, 0.6, 0.4, 0.3, 2.0) == (
        f"{begin}30 % (27 to 33) at j3 to 60 % (54 to 66) at j1; less at 4 of 5 joints."
    )
    assert "does not predict any joint significantly better" in told(0.95, 1.2)
    assert told() == worth(replace(result, findings=())) == ""


@pytest.mark.parametrize(("words", "told"), [("masses are odd", "Masses are odd."), ("is it odd?", "Is it odd?")])
def test_words_are_told_as_a_sentence(words: str, told: str) -> None:
    assert sentence(words) == told
