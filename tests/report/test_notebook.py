"""A notebook shows a result as a card that says what was found; printing one takes a line."""

import re
from dataclasses import replace

import numpy as np
import pytest
from report.fabricated import HEADLINE, diagnosis, identification, with_friction
from report.rendered import Text, tidy

from torchrbd.diagnosis.results import Finding
from torchrbd.display import Remark
from torchrbd.inference.torque_error import Fit
from torchrbd.inference.verdict import verdict_of

JOINTS = tuple(f"joint{i + 1}" for i in range(7))


def words(result) -> str:
    return tidy(" ".join(Text(f"<body>{result._repr_html_()}</body>").words))


def test_a_diagnosis_says_what_where_how_sure_and_what_is_left() -> None:
    text = words(diagnosis(JOINTS[:3], remarks=(Remark("fit stopped early"),)))
    parts = f"""
        ! Missing physics arm {HEADLINE} | The fit stopped early: the torques are far from those of any rigid body. |
        where missing value ± 95 % probability |
        joint2 (in hold.csv, 4.0 to 7.0 s) Coulomb friction 1.000 ± 0.024 N m 98 % |
        A torque at joint2 is unexplained. |
        held-out nmse URDF baseline re-fitted extended against the URDF joint1 0.0301 0.00500 0.0200 |
        mean 0.0298 0.00504 0.0200 5.02·10⁻⁵ 590 times less | held-out data (hold.csv), below 5 Hz |
        Inertial parameters: 1 identified, 1 not identifiable.
    """
    assert [part.strip() for part in parts.split("|") if part.strip() not in text] == []


def test_an_identification_shows_its_terms_and_where_it_does_worse() -> None:
    result = identification(JOINTS[:1])
    text = words(result)
    assert "✓ Identified arm Re-fitting lowers the mean NMSE of arm on held-out data: " in text
    assert "Friction and other terms, ± 95 % joint1 coulomb 1.000 ± 0.024 N m" in text
    assert "mean 0.0" not in text
    assert "#d9701e" not in result._repr_html_()
    fits = {"urdf": Fit({"joint1": 0.1}, {"joint1": 1.0}), "rigid_body": Fit({"joint1": 0.2}, {"joint1": 1.4})}
    worse = replace(result, fits=fits, verdict=verdict_of(fits, ()))
    assert "✗ Worse than the URDF" in words(worse)
    assert "0.200 +100 %" in words(worse)
    assert "#d9701e" in worse._repr_html_()


def test_friction_at_all_joints_is_one_table_and_a_simulation_is_called_one() -> None:
    result = replace(with_friction(diagnosis(JOINTS)), simulated=("sim.csv",))
    text = words(result)
    assert "joint2 (in hold.csv, 4.0 to 7.0 s) torque ripple" in text
    assert "friction ± 95 % viscous friction [N m s/rad] Coulomb friction [N m] joint1 0.50 ± 0.04 99 %" in text
    assert "joint7 0.50 ± 0.04 90 % 0.50 ± 0.04 90 % A torque at joint2 is" in text
    assert "held-out nmse simulation baseline re-fitted extended against the simulation" in text


def test_what_is_likely_but_not_shown_stands_apart_and_many_numbers_are_counted() -> None:
    result = diagnosis(JOINTS[:2])
    (one,) = result.findings
    whole = replace(
        one, effect="base_tilt", joints=(), parameters={f"p{k}": one.parameters["coulomb"] for k in range(9)}
    )
    text = words(replace(result, findings=(whole,), not_confirmed=(one, whole), unexplained=()))
    assert "whole robot (in hold.csv, 4.0 to 7.0 s) tilted base p0 1.000 ± 0.024 N m" in text
    assert "5 more 98 %" in text
    assert "not confirmed by cross-validation: Coulomb friction at joint2; tilted base on the whole robot." in text
    assert "depends" not in text


@pytest.mark.parametrize("result", [diagnosis(JOINTS), with_friction(diagnosis(JOINTS)), identification(JOINTS)])
def test_a_card_is_small_and_needs_nothing_else(result) -> None:
    html = result._repr_html_()
    assert len(html) < 16_000
    assert not re.search(r"https?:|<script|<style|<link|class=|\bid=|src=|url\(", html)
    assert not re.search(r"(?<!-)\bcolor:(?!#fff|#d9701e)|background:(?!#|none)", html)


def test_names_are_escaped() -> None:
    evil = "<b onclick='x'>&\"j"
    result = diagnosis(
        (evil, "joint2"), name="<script>alert(1)</script>", remarks=(Remark("URDF far off", {"joints": [evil]}),)
    )
    (one,) = result.findings
    odd: Finding = replace(one, joints=(evil,), effect="<img>", parameters={"<i>": one.parameters["coulomb"]})
    left = replace(result.unexplained[0], depends_on=(evil,))
    for shown in (
        replace(result, findings=(odd,), unexplained=(left,), not_confirmed=(odd,)),
        with_friction(result),
        replace(result.identification, held_out=evil),
    ):
        html = shown._repr_html_()
        assert not re.search(r"<(script|img|i)\b|<b onclick", html)
        assert evil in words(shown)


def test_printing_takes_a_line() -> None:
    result = diagnosis(JOINTS)
    assert repr(result) == (
        "Diagnosis(robot='arm', verdict='missing_physics', findings=['coulomb_friction at joint2'], unexplained=1)"
    )
    many = repr(with_friction(result))
    assert "'viscous_friction at joint5', '10 more']" in many
    (one,) = result.findings
    assert "['base_tilt at whole robot']" in repr(
        replace(result, findings=(replace(one, effect="base_tilt", joints=()),))
    )
    errors = {name: float(f"{np.mean([*fit.nmse.values()]):.3g}") for name, fit in result.identification.fits.items()}
    assert repr(result.identification) == f"Identification(robot='arm', verdict='identified', mean_nmse={errors})"
