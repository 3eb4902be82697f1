"""What held-out time does not need is set apart, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from diagnosis.test_unexplained import FIRST, MAY, SECOND, diagnosed
from likelihood.fits import at_joint
from report.test_text import finding

from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis import explain as explaining
from torchrbd.diagnosis.explain import explain
from torchrbd.diagnosis.negligible import contradicted, is_negligible, split_negligible
from torchrbd.diagnosis.results import Where
from torchrbd.effects import Site


def of_joints(*names: str) -> Any:
    """Return what a finding is judged beside: joints whose torque is 1 N m RMS."""
    torque = torch.tensor([[100.0, 0.0, 100.0]], dtype=torch.float64).expand(1, len(names), 3)
    prepared = SimpleNamespace(training=SimpleNamespace(torque=torque), robot=SimpleNamespace(joint_names=names))
    return SimpleNamespace(prepared=prepared)


@pytest.mark.parametrize(
    ("recordings", "after", "negligible"),
    [
        (None, 0.05, False),
        (None, 0.1, True),
        (None, 0.11, True),
        (("a",), 0.05, False),
        (("a",), 0.1, False),
        (("a",), 0.11, True),
    ],
)
def test_held_out_time_that_contradicts_a_finding_sets_it_apart(
    recordings: tuple[str, ...] | None, after: float, negligible: bool
) -> None:
    """Of what acts for a time it may see nothing; worse it must not become."""
    one = replace(
        finding("payload", "hinge"),
        where=Where(recordings),
        nmse_before={"hinge": 0.1},
        nmse_after={"hinge": after},
        torque_rms={"hinge": 1.0},
    )
    assert is_negligible(one, of_joints("hinge")) is negligible
    assert contradicted(one) is (after > 0.1), "and it leaves the model, whenever it acts"


@pytest.mark.parametrize("recordings", [None, ("a",)])
@pytest.mark.parametrize(("other", "negligible"), [(0.34, False), (0.4, True)])
def test_what_acts_on_several_joints_is_judged_by_all_of_them(
    recordings: tuple[str, ...] | None, other: float, negligible: bool
) -> None:
    """A force that one joint's held-out time seems to show, and the other's contradicts by less, or by more."""
    one = replace(
        finding("external_wrench", "hinge"),
        joints=(),
        where=Where(recordings),
        nmse_before={"hinge": 0.1, "slide": 0.3},
        nmse_after={"hinge": 0.05, "slide": other},
        torque_rms={"hinge": 1.0, "slide": 1.0},
    )
    assert is_negligible(one, of_joints("hinge", "slide")) is negligible
    assert one.share_of_all == pytest.approx(1.0 - (0.05 + other) / 0.4)


@pytest.mark.parametrize(("joints", "negligible"), [(("hinge",), True), (("slide",), False), ((), False)])
def test_what_carries_little_of_its_own_joints_torque_is_negligible(joints: tuple[str, ...], negligible: bool) -> None:
    """What it moves at others is no matter; what sits at no joint acts on all."""
    one = replace(
        finding("joint_elasticity", "hinge"),
        joints=joints,
        nmse_before={"hinge": 0.1, "slide": 0.1},
        nmse_after={"hinge": 0.1, "slide": 0.095},
        torque_rms={"hinge": 0.005, "slide": 0.02},
    )
    assert is_negligible(one, of_joints("hinge", "slide")) is negligible


def test_of_findings_that_stand_in_for_each_other_one_is_told() -> None:
    """Each alone may go; both may not. What nothing needs goes with the less likely one."""
    gains = {"viscous_friction": 90.0, "power_law_friction": 60.0, "torque_ripple": 20.0, "joint_spring": 10.0}
    terms = {name: SimpleNamespace(place=0, name=name) for name in gains}
    told = [(terms[k], replace(finding(k, "hinge"), log_evidence_gain=gain)) for k, gain in gains.items()]

    def error_without(gone: Sequence[SimpleNamespace]) -> dict[str, float]:
        names = {one.name for one in gone}
        friction = 0.5 * ({"viscous_friction", "power_law_friction"} <= names)
        return {"hinge": 0.01 + friction + 0.2 * ("joint_spring" in names), "other": 0.1}

    kept, apart = split_negligible(told, error_without, lambda _, one: one.share < 0.02)  # type: ignore[arg-type]
    assert [one.effect for _, one in kept] == ["viscous_friction", "joint_spring"]
    assert [one.effect for _, one in apart] == ["torque_ripple", "power_law_friction"]
    assert kept[0][1].nmse_before == {"hinge": 0.51}
    assert {one.nmse_after["hinge"] for _, one in (*kept, *apart)} == {0.01}


def test_what_is_set_apart_is_negligible_all_together() -> None:
    """Each of three is worth 15 of a thousand parts, two of them more than 20."""
    terms = {name: SimpleNamespace(place=0, name=name) for name in ("torque_ripple", "joint_spring", "backlash")}
    told = [(one, replace(finding(k, "hinge"), log_evidence_gain=20.0)) for k, one in terms.items()]

    def error_without(gone: Sequence[SimpleNamespace]) -> dict[str, float]:
        return {"hinge": 0.01 / (1.0 - 0.015 * len(gone))}

    kept, apart = split_negligible(told, error_without, lambda _, one: one.share < 0.02)  # type: ignore[arg-type]
    assert (len(kept), len(apart)) == (2, 1)


def test_what_is_worse_than_nothing_without_what_is_set_apart_goes_too() -> None:
    """A spring makes up for a ripple that nothing needs; alone it doubles the error."""
    terms = {name: SimpleNamespace(place=0, name=name) for name in ("torque_ripple", "joint_spring", "backlash")}
    told = [(one, replace(finding(k, "hinge"), log_evidence_gain=20.0)) for k, one in terms.items()]
    errors = {(): 0.1, ("torque_ripple",): 0.1, ("joint_spring",): 0.2, ("joint_spring", "torque_ripple"): 0.05}

    def error_without(gone: Sequence[SimpleNamespace]) -> dict[str, float]:
        names = {one.name for one in gone}
        return {"hinge": errors[tuple(sorted(names - {"backlash"}))] + 0.3 * ("backlash" in names)}

    kept, apart = split_negligible(told, error_without, lambda _, one: one.share < 0.02)  # type: ignore[arg-type]
    assert [one.effect for _, one in kept] == ["backlash"]
    assert [one.effect for _, one in apart] == ["torque_ripple", "joint_spring"]
    assert kept[0][1].nmse_after == {"hinge": 0.05}


def test_what_other_joints_need_is_not_negligible() -> None:
    """Friction that does nothing for its own joint keeps the bodies right that two others need; a ripple nothing."""
    terms = {name: SimpleNamespace(place=0, name=name) for name in ("coulomb_friction", "torque_ripple")}
    told = [(one, replace(finding(k, "hinge"), log_evidence_gain=20.0)) for k, one in terms.items()]

    def error_without(gone: Sequence[SimpleNamespace]) -> dict[str, float]:
        friction = "coulomb_friction" in {one.name for one in gone}
        return {"hinge": 0.012 - 0.004 * friction, "slide": 0.01 + 0.01 * friction, "wrist": 0.01 + 0.01 * friction}

    kept, apart = split_negligible(told, error_without, lambda _, one: one.share < 0.02)  # type: ignore[arg-type]
    assert [one.effect for _, one in kept] == ["coulomb_friction"]
    assert [one.effect for _, one in apart] == ["torque_ripple"]


DRAG = "quadratic_drag"


@pytest.mark.parametrize(("own", "told"), [(0.25, True), (0.05, False)], ids=["shown", "contradicted"])
def test_what_stands_in_for_something_else_is_no_finding_and_stays(
    own: float, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drag without which another joint is told worse, whether its own joint's held-out time shows it or not."""
    model = diagnosed(at_joint(0, lambda m: 2.0 * m.qd[:, 0] * np.abs(m.qd[:, 0])), may=MAY)
    (drag,) = model.terms
    assert (drag.effect.id, drag.site) == (DRAG, Site(0))

    def error_without(_: object, gone: Sequence[Candidate]) -> dict[str, float]:
        return {FIRST: own if drag in gone else 0.1, SECOND: 0.4 if drag in gone else 0.1}

    monkeypatch.setattr(explaining.RefittedModels, "error_without", error_without)
    found = explain(model)
    assert (DRAG in {f.effect for f in found.findings}) is told
    assert (DRAG in {f.effect for f in found.not_confirmed}) is not told
    assert found.model.terms == (drag,)
