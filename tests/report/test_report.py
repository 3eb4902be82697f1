"""The page opens anywhere, says the verdict first, and shows every joint, measured or not."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report.fabricated import STATEMENT, curve, diagnosis, identification, with_friction

from torchrbd.diagnosis.numbers import number
from torchrbd.diagnosis.results import Alternative, Diagnosis, Location, Proof, Quantity, Ratio, Region, Where
from torchrbd.inference.verdict import verdict_of
from torchrbd.report import write_report
from torchrbd.report.words import change, worth


def render(result: Any, folder: Path) -> str:
    write_report(result, folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


class Text(HTMLParser):
    """Collect the text of the body and check that every element is closed."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.open: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if data.strip() and "body" in self.open:
            self.words.append(" ".join(data.split()))


@pytest.mark.parametrize("n", [1, 7, 30])
def test_page_is_one_file_that_needs_nothing_else(tmp_path, n):
    page = render(diagnosis(tuple(f"joint{i + 1}" for i in range(n))), tmp_path)
    names = re.findall(r'\bid="([^"]+)"', page)
    assert len(names) == len(set(names))
    assert not re.search(r"https?:|<script|<link|\bsrc=|@import|url\((?!#)|href=\"(?!#|data:image/png;base64,)", page)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert len(page) < n * 200_000 + 100_000
    Text(page)


def test_verdict_comes_before_anything_else(tmp_path):
    words = Text(render(diagnosis(("joint1", "joint2")), tmp_path)).words
    assert words[:2] == ["! Missing physics", STATEMENT]


def test_finding_says_what_where_and_how_sure(tmp_path):
    text = " ".join(Text(render(diagnosis(("joint1", "joint2", "joint3")), tmp_path)).words)
    parts = """
        Coulomb friction at joint2 | 1.000 ± 0.024 N m | 98 % | c sign(qd) | 0.0200 → 5.00·10⁻⁵ | in hold.csv |
        4.0 to 7.0 s | Stribeck friction | joint2 resists motion with 1.0 N m. | Unexplained at joint2 | 42 % |
        q_joint1 from −0.1 to 0.3 | where a finding holds | position of joint1 [rad]
    """
    for part in map(str.strip, parts.split("|")):
        assert part in text


def test_finding_on_a_link_is_shown_at_the_joint_that_gains(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    payload = replace(result.findings[0], effect="payload", joints=(), links=("tool",))
    page = render(replace(result, findings=(payload,), unexplained=()), tmp_path)
    assert "Payload on tool" in page
    assert "<b>joint2, hold.csv</b>" in page


def test_finding_with_a_shared_probability_says_so_and_shows_the_state_of_its_equation(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    inertia = replace(result.findings[0], effect="rotor_inertia", probability=0.5, where=Where())
    page = render(replace(result, findings=(inertia,), unexplained=()), tmp_path)
    assert "Something is missing here beyond doubt. The probability is shared" in page
    assert "residual of joint2 against acceleration" in page
    alone = render(replace(result, findings=(replace(inertia, indistinguishable_from=()),), unexplained=()), tmp_path)
    assert "a cause outside the list may look like it" in alone
    assert "shared" not in render(replace(result, unexplained=()), tmp_path)


def test_every_joint_has_its_row_and_figures(tmp_path):
    joints = tuple(f"joint{i + 1}" for i in range(30))
    page = render(diagnosis(joints), tmp_path)
    assert re.findall(r'<section class="panel joint" id="joint-\d+">\s*<header>\s*<h3>(\w+)', page) == list(joints)
    assert page.count('aria-label="torque of') == 30
    assert page.count("where the residual is largest") == 30


def test_figures_are_well_formed_and_finite(tmp_path):
    page = render(diagnosis(("joint1", "joint2"), unmeasured=0), tmp_path)
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


def test_identification_says_by_how_much_the_error_fell(tmp_path):
    result = identification(("joint1", "joint2"))
    before, after = (result.fits[k].mean_nmse for k in ("urdf", "rigid_body"))
    words = Text(render(result, tmp_path)).words
    assert words[0] == "✓ Identified"
    assert f"by {100 * (1 - after / before):.0f} %" in words[1]
    assert "extended" not in " ".join(words)


def test_badge_says_what_is_the_case(tmp_path):
    result = identification(("joint1", "joint2"))
    fits = {"urdf": result.fits["rigid_body"], "rigid_body": result.fits["urdf"]}
    worse = replace(result, fits=fits, verdict=verdict_of(fits, ()))
    words = Text(render(worse, tmp_path)).words
    assert words[0] == "✗ Worse than the URDF"
    assert words[1].startswith("Re-fitting raises the held-out torque error of arm: mean nmse ")
    even = replace(worse, verdict="identified")
    assert "does not lower" in Text(render(even, tmp_path)).words[1]
    doubted = identification(("joint1", "joint2"), doubts=("check the unit of tau",))
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


def test_doubts_stand_under_the_headline_and_notes_at_the_end(tmp_path):
    for result in (
        identification(("joint1", "joint2"), doubts=("check the unit of tau",)),
        diagnosis(("joint1", "joint2"), doubts=("check the unit of tau",)),
    ):
        words = Text(render(result, tmp_path)).words
        assert words.index("Check the unit of tau.") == 2
        assert words.index("Column 'mode' was ignored.") > words.index("How it was made")


def test_headline_speaks_of_the_last_model(tmp_path):
    result = identification(("joint1", "joint2"), extended=True)
    before, between, after = (result.fits[k].mean_nmse for k in ("urdf", "rigid_body", "extended"))
    words = Text(render(result, tmp_path)).words
    assert words[1].startswith("The extended model lowers the held-out torque error of arm by ")
    assert f"nmse {number(before)} → {number(after)}" in words[1]
    assert number(between) in words[2]


def test_noise_is_called_what_it_is(tmp_path):
    result = identification(("turn", "slide"))
    words = "position noise 0.000100 {}, torque from {} 0.0200 {}, torque left over 0.0500 {}"
    text = " ".join(Text(render(result, tmp_path)).words)
    assert words.format("rad", "it", "N m", "N m") in text
    assert words.format("m", "it", "N", "N") in text
    smoothed = " ".join(Text(render(replace(result, states="smoothed"), tmp_path)).words)
    assert words.format("rad", "it, if filtered,", "N m", "N m") in smoothed


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
    assert "does not tell how sure it is" in text
    assert "nan" not in text.lower().split()
    assert "width: nan" not in page
    assert "does not tell how sure it is" not in render(result, tmp_path)


def test_units_follow_the_joint(tmp_path):
    page = render(identification(("turn", "slide")), tmp_path)
    turn, slide = (page.split(f'id="joint-{i}"')[1].split("</section>")[0] for i in (1, 2))
    assert all(label in turn for label in ("torque [N m]", "position [rad]", "velocity [rad/s]"))
    assert all(label in slide for label in ("force [N]", "position [m]", "velocity [m/s]"))


def test_parameters_show_interval_prior_share_and_status(tmp_path):
    text = " ".join(Text(render(identification(("joint1",)), tmp_path)).words)
    for part in ("m_link1", "2.10 ± 0.10", "not identifiable", "1.000 ± 0.024", "Izz_link1 + Iyy_link2", "'mode'"):
        assert part in text


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


def test_consistent_robot_needs_no_findings(tmp_path):
    result = Diagnosis(identification(("joint1", "joint2")), "consistent", "The URDF explains the data.", ())
    words = Text(render(result, tmp_path)).words
    assert words[:2] == ["✓ URDF consistent", "The URDF explains the data."]
    assert "Probability" not in words


def test_friction_at_all_joints_is_one_table_behind_the_special_findings(tmp_path):
    joints = tuple(f"joint{i + 1}" for i in range(7))
    page = render(with_friction(diagnosis(joints)), tmp_path)
    words = Text(page).words
    assert re.findall(r'id="(finding-\d+|friction)"', page) == ["finding-1", "friction"]
    assert words.index("Torque ripple at joint2") < words.index("Plain friction and offsets")
    table = page.split('id="friction"')[1].split("</section>")[0]
    assert table.count("<tr>") == 8
    text = " ".join(Text(f"<body>{table[table.index('<table') :].split('</table>')[0]}</table></body>").words)
    assert "viscous friction [N m s/rad] Coulomb friction [N m] could also be" in text
    assert "joint1 0.50 ± 0.04 URDF 0.250 99 % 0.50 ± 0.04 URDF 0.250 99 % joint2" in tidy(text)
    assert "joint7 0.50 ± 0.04 90 % 0.50 ± 0.04 90 % viscous friction: Stribeck friction at joint2;" in tidy(text)
    assert "offset" not in text


def test_little_friction_keeps_its_cards(tmp_path):
    page = render(with_friction(diagnosis(("joint1",))), tmp_path)
    assert re.findall(r'id="(finding-\d+|friction)"', page) == ["finding-1", "finding-2", "finding-3"]


def test_cards_draw_curves_and_say_what_data_is(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    ripple = replace(result.findings[0], effect="torque_ripple", where=Where(), curve=curve("q_joint1"))
    load = replace(ripple, effect="load_dependent_friction", curve=curve("tau_joint2"))
    drag = replace(ripple, effect="cable_drag", curve=curve("q_joint2"))
    left = replace(result.unexplained[0], curve=curve("t"))
    page = render(replace(result, findings=(ripple, load, drag), unexplained=(left,)), tmp_path)
    text = " ".join(Text(page).words)
    assert text.count("joint2: what it adds ± 95 %, dots: data") == 2
    assert text.count("joint2: what it adds ± 95 % ") == 2
    for label in ("position of joint1 [rad]", "torque of the rigid body [N]", "force against the motion [N]"):
        assert label in text
    labels = re.findall(r'aria-label="torque added at joint2 against ([^"]*)"', page)
    assert labels == ["position of joint1", "torque of the rigid body", "position", "time"]


def test_a_hum_is_drawn_over_time(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    hum = Where(region=(Region("frequency", 2.9, 3.1),))
    left = replace(result.unexplained[0], depends_on=("t",), where=hum, curve=None)
    page = render(replace(result, unexplained=(left,)), tmp_path)
    assert f'aria-label="residual of joint2 in {result.identification.series.recordings[0]}"' in page
    text = " ".join(Text(page).words)
    assert "frequency from 2.9 to 3.1 Hz" in tidy(text)


def test_curve_of_a_signal_that_is_not_known_is_drawn(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    odd = replace(result.findings[0], curve=curve("voltage"))
    assert "against voltage" in render(replace(result, findings=(odd,)), tmp_path)


def test_what_was_located_in_the_last_leftover_is_shown_of_the_last_model(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    (left,) = result.unexplained
    here = Location("extended", ("joint2",), (), Where(), (), "level", "", 9.0, {}, {}, None, None, left.statement)
    alone = render(replace(result, findings=(), locations=(here,)), tmp_path)
    both = render(replace(result, findings=()), tmp_path)
    card = [page.split('class="panel card unnamed')[1].split("</section>")[0] for page in (alone, both)]
    assert ["re-fitted rigid body" in c for c in card] == [False, True]


def test_finding_in_a_stretch_of_time_shows_it_in_its_recording(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    load = replace(result.findings[0], effect="payload", joints=(), links=("tool",), where=Where(("fit.csv",), None))
    text = " ".join(Text(render(replace(result, findings=(load,), unexplained=()), tmp_path)).words)
    assert "joint2, fit.csv" in text
    gone = replace(load, where=Where(("elsewhere.csv",), ((1.0, 2.0),)))
    text = " ".join(Text(render(replace(result, findings=(gone,), unexplained=()), tmp_path)).words)
    assert "joint2, held out" in text


def test_many_quantities_are_a_list_and_a_pure_number_has_no_unit(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    many = {name: Quantity(0.1, 0.01, "1") for name in ("a", "b", "c", "d_e")}
    listed = replace(result, findings=(replace(result.findings[0], parameters=many),))
    text = " ".join(Text(render(listed, tmp_path)).words)
    assert "c 0.100 ± 0.020 d e 0.100 ± 0.020 ± 95 %" in text


def test_tilted_base_names_the_joints_that_change(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    worth = {"nmse_before": {"joint1": 0.02, "joint2": 0.5}, "nmse_after": {"joint1": 0.02, "joint2": 0.1}}
    tilt = replace(result.findings[0], effect="base_tilt", joints=(), where=Where(), **worth)
    text = " ".join(Text(render(replace(result, findings=(tilt,), unexplained=()), tmp_path)).words)
    assert "Tilted base (whole robot)" in text
    assert "nmse, joint2 0.500 → 0.100 (−80 %)" in text
    assert "nmse, joint1" not in text


def tidy(text: str) -> str:
    return text.replace("\N{NO-BREAK SPACE}", " ")


def test_worth_of_the_extended_model_is_shown_where_it_has_something(tmp_path):
    result = diagnosis(("joint1", "joint2", "joint3"), unmeasured=0)
    over = {"rigid_body": Ratio(0.312, 0.252, 0.403), "urdf": Ratio(0.0054, 0.0042, 0.0071)}
    memory = {"urdf": 1.2, "rigid_body": 0.35, "extended": 0.11}
    worse = {"rigid_body": Ratio(1.15, 1.08, 1.2), "urdf": Ratio(0.9, 0.7, 1.1)}
    result = replace(
        result,
        proofs=(Proof("joint2", over, memory, 0.0999), Proof("joint3", worse, memory | {"extended": 0.4}, 0.0999)),
    )
    page = render(result, tmp_path)
    text = " ".join(Text(page).words).replace("\N{NO-BREAK SPACE}", " ")
    assert "joint2 31 % (25 to 40) 0.54 % (0.42 to 0.71) 1.2 s 0.35 s 0.11 s" in text
    assert "joint3 115 % (108 to 120) 90 % (70 to 110) 1.2 s 0.35 s 0.4 s" in text
    assert "white noise below 5 Hz for 0.1 s" in text
    cells = re.findall(r'<td class="([^"]*)">[^<]* to ', page)
    assert [" ".join(c.split()) for c in cells] == ["group best", "best", "group worse", ""]
    for without in (replace(result, findings=()), replace(result, proofs=()), result.identification):
        assert "errors stay alike" not in render(without, tmp_path)


def test_one_line_says_what_findings_are_worth():
    result, memory = diagnosis(("joint1",)), dict.fromkeys(("urdf", "rigid_body", "extended"), 0.1)

    def told(*parts: float) -> str:
        ratios = ({"rigid_body": Ratio(x, 0.9 * x, 1.1 * x), "urdf": Ratio(x, x, x)} for x in parts)
        return worth(replace(result, proofs=tuple(Proof(f"j{k}", r, memory, 0.1) for k, r in enumerate(ratios))))

    begin = "Of the re-fitted rigid body's squared error on held-out data is left, with 95 % intervals: "
    assert told(0.5, 1.0, 0.2) == f"{begin}20 % (18 to 22) at j2 and 50 % (45 to 55) at j0."
    assert told(0.5, 0.6, 0.4, 0.3, 2.0) == (
        f"{begin}30 % (27 to 33) at j3 to 60 % (54 to 66) at j1, less at 4 of 5 joints."
    )
    assert "at no joint surely better" in told(0.95, 1.2)
    assert told() == worth(replace(result, findings=())) == ""


def test_a_guess_leads_neither_card_nor_table(tmp_path):
    result = with_friction(diagnosis(("joint1", "joint2", "joint3")))
    rival = Alternative("torque_scale", ("joint3",))
    guess = replace(
        result.findings[0],
        effect="torque_offset",
        joints=("joint2",),
        probability=0.01,
        indistinguishable_from=(rival,),
    )
    page = render(replace(result, findings=(*result.findings, guess)), tmp_path)
    titles = re.findall(r"<h3>(.*?)</h3>", page)
    assert titles[0] == "Torque ripple at joint2"
    assert titles[1].endswith("at joint3 or perhaps constant torque offset at joint2")
    assert "constant torque offset [" not in page
