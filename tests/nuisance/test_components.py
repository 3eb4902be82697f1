"""One contract for all components: rigid body, what every machine has, effects and smooth curves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from likelihood.fits import DELAY_S, at_joint, carried, fitted

from torchrbd.diagnosis.curve_hypotheses import curves_at
from torchrbd.diagnosis.hypotheses import hypothesis_of
from torchrbd.effects import Site, effect
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.nuisance.component import Component
from torchrbd.nuisance.rotor import Rotor

JOINTS = range(2)


@lru_cache(maxsize=1)
def fit() -> Likelihood:
    return fitted(at_joint(0, lambda m: 0.3 * m.q[:, 0]), delay_s=DELAY_S)


def spring() -> Component:
    rows = carried(fit())
    found = hypothesis_of(fit(), rows, rows.columns.candidate(effect("joint_spring"), Site(0), {}))
    assert found is not None
    return found.extra(fit(), rows)


def curve() -> Component:
    rows = carried(fit())
    return curves_at(fit(), rows, [1])[0].extra(fit(), rows)


def rotor() -> Rotor:
    """Return the rotors of a robot whose second joint has a drive."""
    machine = fit().machine
    return Rotor(replace(machine.rows, driven=np.array([False, True])), machine.torque_rms)


COMPONENTS: dict[str, Callable[[], Component]] = {
    name: lambda kind=name: next(c for c in fit().machine.components if type(c).__name__ == kind)
    for name in (
        "RigidBody", "JointFriction", "FrictionTransition", "Sticking", "Breakaway", "TorqueQuantisation",
        "StateBandwidth", "Drift", "ClockOffset", "RestHolding",
    )
}  # fmt: skip
COMPONENTS |= {"effect": spring, "curve": curve, "Rotor": rotor}


def test_all_components_of_a_machine_are_tried() -> None:
    assert {type(c).__name__ for c in fit().machine.components} < set(COMPONENTS)


@pytest.mark.parametrize("name", COMPONENTS)
@pytest.mark.parametrize("known", [False, True], ids=["load unknown", "load known"])
def test_columns_have_coefficients_of_their_component(name: str, *, known: bool) -> None:
    one, hyper = COMPONENTS[name](), fit().hyper
    along = fit().machine.along(hyper) if known else None
    for j in JOINTS:
        columns, own = one.columns(j, hyper, along)
        assert columns.shape == (len(own), len(fit().machine.rows.t))
        assert len(set(own.tolist())) == len(own)
        assert set(own.tolist()) <= set(one.at(j).tolist())
        assert set(one.at(j).tolist()) <= set(range(one.first, one.first + one.n))
        assert np.isfinite(columns).all()
        sizes = one.sizes(j, own, hyper)
        assert sizes.shape == own.shape
        assert (sizes >= 0.0).all()
        # The same again: nothing that is asked changes what is asked.
        np.testing.assert_array_equal(one.columns(j, hyper, along)[0], columns)


def test_only_joints_with_a_drive_have_a_rotor() -> None:
    one, machine = rotor(), fit().machine
    assert [len(one.at(j)) for j in JOINTS] == [0, 1]
    column = one.columns(1, fit().hyper, None)[0][0]
    np.testing.assert_allclose(column, one.size(1) * machine.rows.qdd[1])
    assert np.sqrt(np.mean(column**2)) == pytest.approx(machine.torque_rms[1])


@pytest.mark.parametrize("name", COMPONENTS)
def test_local_coefficients_belong_to_one_joint(name: str) -> None:
    one = COMPONENTS[name]()
    first, second = (set(one.at(j).tolist()) for j in JOINTS)
    assert not (one.local and first & second)


@pytest.mark.parametrize("name", COMPONENTS)
def test_what_columns_need_is_of_all_joints(name: str) -> None:
    wanted, along = COMPONENTS[name]().along(), fit().machine.along(fit().hyper)
    for key in wanted:
        assert along[key].shape[-2:] == (len(JOINTS), len(fit().machine.rows.t))


def test_components_fill_the_machine_without_gaps() -> None:
    at = [range(c.first, c.first + c.n) for c in fit().machine.components]
    assert [k for own in at for k in own] == list(range(fit().machine.n))
