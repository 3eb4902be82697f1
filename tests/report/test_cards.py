"""A card says what was found, where, when and how sure, with its curve; plain friction is one table."""

import re
from dataclasses import replace

import pytest
from report.fabricated import curve, diagnosis, with_friction
from report.rendered import Text, render, tidy

from torchrbd.diagnosis.results import Alternative, Elpd, Law, Quantity, Region, Where
from torchrbd.report.text.numbers import number

pytestmark = pytest.mark.usefixtures("without_joint_figures")


def test_finding_says_what_where_and_how_sure(tmp_path):
    result = diagnosis(("joint1", "joint2", "joint3"))
    text = " ".join(Text(render(result, tmp_path)).words)
    (one,) = result.findings
    before, after = (number(nmse["joint2"]) for nmse in (one.nmse_before, one.nmse_after))
    parts = f"""
        Coulomb friction at joint2 | 1.000 ± 0.024 N m | 98 % | c sign(qd) | {before} → {after} | in hold.csv |
        4.0 to 7.0 s | Stribeck friction | cannot distinguish it from Stribeck friction. |
        Unexplained at joint2 | 42 % |
        q_joint1 from −0.1 to 0.3
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
    assert "An effect is certainly missing here. The probability is shared" in page
    assert "residual of joint2 against acceleration" in page
    alone = render(replace(result, findings=(replace(inertia, indistinguishable_from=()),), unexplained=()), tmp_path)
    assert "probability is shared" not in alone
    assert "shared" not in render(replace(result, unexplained=()), tmp_path)


def test_friction_at_all_joints_is_one_table_behind_the_special_findings(tmp_path):
    joints = tuple(f"joint{i + 1}" for i in range(7))
    page = render(with_friction(diagnosis(joints)), tmp_path)
    words = Text(page).words
    assert re.findall(r'id="(finding-\d+|friction)"', page) == ["finding-1", "friction"]
    assert words.index("Torque ripple at joint2") < words.index("Friction and offsets by joint")
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
    drag = replace(ripple, effect="position_dependent_friction", curve=curve("q_joint2"))
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
    assert "c 0.100 ± 0.020 d e 0.100 ± 0.020 ± is the 95 % interval." in text


def test_tilted_base_names_the_joints_that_change(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    worth = {"nmse_before": {"joint1": 0.02, "joint2": 0.5}, "nmse_after": {"joint1": 0.02, "joint2": 0.1}}
    tilt = replace(result.findings[0], effect="base_tilt", joints=(), where=Where(), **worth)
    text = " ".join(Text(render(replace(result, findings=(tilt,), unexplained=()), tmp_path)).words)
    assert "Tilted base (whole robot)" in text
    assert "NMSE, joint2 0.500 → 0.100 (−80 %) extended model without it → with it" in text
    assert "NMSE, joint1" not in text


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
    assert titles[1].endswith("at joint3 or possibly constant torque offset at joint2")
    assert "constant torque offset [" not in page


def test_laws_that_explain_the_same_are_told_with_their_family(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    laws = (Law("coulomb_friction", 0.62), Law("stribeck_friction", 0.31))
    sure = replace(result.findings[0], probability=0.61, family="friction", family_probability=0.97, laws=laws)
    text = " ".join(Text(render(replace(result, findings=(sure,)), tmp_path)).words)
    assert "Friction of some kind 97 %" in text
    assert "Which law, if any Coulomb friction 62 %, Stribeck friction 31 %" in text
    alone = replace(sure, family_probability=0.61, laws=laws[:1])
    text = " ".join(Text(render(replace(result, findings=(alone,)), tmp_path)).words)
    assert "of some kind" not in text
    assert "Which law" not in text


def test_a_card_says_what_cross_validation_gains(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    (one,) = result.findings
    sure = replace(result, findings=(replace(one, elpd=Elpd(412.0, 33.0, 25.0, 0.87, 0.3)),))
    text = " ".join(Text(render(sure, tmp_path)).words).replace("\N{NO-BREAK SPACE}", " ")
    gain = "log Bayes factor 25.0 nats; elpd gain 412 ± 33 nats (± standard error)"
    assert f"Cross-validation 87 % of the error of left-out blocks; {gain}" in text
    assert "left-out blocks" not in render(result, tmp_path)


def test_what_cross_validation_does_not_confirm_has_its_own_section(tmp_path):
    result = diagnosis(("joint1", "joint2"))
    small = replace(result.findings[0], effect="torque_ripple")
    page = render(replace(result, not_confirmed=(small,)), tmp_path)
    assert "<h2>Not confirmed by cross-validation</h2>" in page
    part = page.partition('id="not-confirmed"')[2].partition("</section>")[0]
    assert "Torque ripple at joint2 (in hold.csv, 4.0 to 7.0 s)" in " ".join(Text(f"<body>{part}</body>").words)
    order = (
        page.index(mark) for mark in ("<h2>Torque error on held-out data</h2>", 'id="finding-1"', 'id="not-confirmed"')
    )
    assert (found := list(order)) == sorted(found), "first what was found"
    alone = render(replace(result, findings=(), unexplained=(), not_confirmed=(small,)), tmp_path)
    assert "Torque ripple at joint2" in alone
    assert 'id="not-confirmed"' not in render(result, tmp_path)
