"""What was considered: a section of the page, below what was found; nothing on the terminal."""

import re
from dataclasses import replace

import pytest
from report.fabricated import diagnosis, ranking
from report.rendered import Text, render, tidy

from torchrbd.cli.tables import print_diagnosis
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.ranked import Ranked
from torchrbd.likelihood.misfit import Misfit
from torchrbd.report.considered import nats
from torchrbd.report.text.hypotheses import misfit_sentence
from torchrbd.report.text.names import words_of

pytestmark = pytest.mark.usefixtures("without_joint_figures")

JOINTS = ("joint1", "joint2", "slide")
RIPPLE = Ranked("torque_ripple", ("joint1",), (), 33.0, {"amplitude": 1.0})


def ranked(*adopted: Ranked, joints: tuple[str, ...] = JOINTS) -> Diagnosis:
    return replace(diagnosis(joints), ranking=ranking(joints, adopted))


def section(page: str) -> str:
    return page.partition("<h2>What was considered</h2>")[2].partition("<h2>")[0]


def test_hypotheses_are_shown_with_bars_places_units_and_times(tmp_path):
    page = render(ranked(), tmp_path)
    part = section(page)
    Text(page)
    text = tidy(" ".join(Text(f"<body>{part}</body>").words))
    for words in (
        "Payload hand 41.2",
        "mass 0.500 kg, x 0.100 m, y –, z 0 m and 2 more in fit.csv, 2.0 to 8.0 s",
        "Coupling to joint1's position slide 6.0 stiffness 3.00 N/m, offset −1.00 N",
        "ln 42 = 3.7",
        "below 15 Hz",
        "30 more were considered",
        "Whitened rows and plain least squares disagree on the friction of slide (p = 4.00·10⁻⁹). Another law",
        "fit.csv 1.20 ± 0.20 ms earlier",
        "hold.csv 0 ± 50 ms later",
        "joint1 0.500 N m s/rad URDF 0.250 120 0.500 N m 0.500 N m 0.0100 rad/s 120",
        "slide 0.500 N s/m −10.0 0.500 N 0.500 N 0.0100 m/s −10.0",
    ):
        assert words in text
    assert "Last step" not in text
    assert "adopted" not in text
    assert [float(x) for x in re.findall(r'<i class="[^"]*" style="width: ([\d.]+)%"', part)][:3] == [100.0, 20.0, 0.0]
    assert part.count('<i class="likely beyond"') == 1
    assert part.count("<details>") == 2


def test_what_is_adopted_is_marked_beside_the_last_step(tmp_path):
    load = ranking(JOINTS).first[0]
    part = section(render(ranked(load), tmp_path))
    assert part.count(">adopted<") == 2
    assert "given payload on hand" in part
    assert "given the 2 adopted effects" in section(render(ranked(load, RIPPLE), tmp_path))


def test_nothing_to_consider_and_no_ranking_are_shown_as_such(tmp_path):
    empty = replace(ranking(JOINTS), first=(), last=(), ordinary=(), delay_s={}, considered=0)
    page = render(replace(diagnosis(JOINTS), ranking=empty), tmp_path)
    assert "No effect" in section(page)
    assert "ln " not in section(page)
    Text(page)
    assert section(render(diagnosis(JOINTS), tmp_path)) == ""


def test_what_was_considered_is_not_on_the_terminal(capsys):
    print_diagnosis(ranked())
    shown = " ".join(capsys.readouterr().out.split())
    found = {words_of(f.effect) for f in ranked().findings}
    others = {words_of(one.effect) for one in ranking(JOINTS).first} - found
    assert others
    assert not [words for words in others if words in shown]
    assert "log evidence" not in shown


def test_an_effect_that_is_not_registered_here_has_its_row(tmp_path):
    foreign = Ranked("gear_whine", ("joint1",), (), 7.0, {"loudness": 2.0}, other="joint2")
    found = replace(ranking(JOINTS), first=(foreign,))
    text = " ".join(Text(render(replace(diagnosis(JOINTS), ranking=found), tmp_path)).words)
    assert "Gear whine that depends on the position of joint2 joint1 7.0 loudness 2.00" in text


@pytest.mark.parametrize(
    ("evidence", "words"),
    [(0.04, "0.0"), (-0.04, "0.0"), (-0.26, "−0.3"), (645.37, "645"), (-float("inf"), "–"), (float("nan"), "–")],
)
def test_nats(evidence, words):
    assert nats(evidence) == words


def test_estimates_that_agree_are_said_to_agree():
    agrees = "Whitened rows and plain least squares agree on the friction of every joint."
    assert misfit_sentence({"a": Misfit(2.0, 3, 0.57), "b": Misfit(0.0, 0, 1.0)}) == agrees
    assert misfit_sentence({"a": Misfit(0.0, 0, 1.0)}) == misfit_sentence({}) == ""
