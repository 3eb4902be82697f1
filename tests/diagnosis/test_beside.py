"""Plain friction beside findings: what is too little to be found does not go into what was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from robot.random_robots import random_urdf
from simulated import Motion, record, with_wrong_inertials

from torchrbd.diagnosis import beside
from torchrbd.diagnosis.refuting import refuted
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.physical.terms import significance, term_parameters
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.shapes.refine import fit_with_shapes
from torchrbd.inference.shapes.reread import reread
from torchrbd.likelihood.columns import Candidate, Columns
from torchrbd.physics import Site, effect
from torchrbd.robot import RobotModel

JOINT = 1
DRAG, VISCOUS, OFFSET = "quadratic_drag", "viscous_friction", "torque_offset"


def term(columns: Columns, name: str, shape: dict[str, float] | None = None) -> Candidate:
    return columns.candidate(effect(name), Site(JOINT), shape or {})


def arm(viscous: float, *names: str) -> tuple[Prepared, list[Candidate]]:
    """Return a recording of an arm with drag of 3 N m s^2/rad^2 and viscous friction at a joint, and some terms."""
    urdf = random_urdf(23, 3, kinds=("revolute",), branching=0.0, massless=0.0)

    def extra(motion: Motion) -> np.ndarray:
        tau, qd = np.zeros_like(motion.q), motion.qd[:, JOINT]
        tau[:, JOINT] = 3.0 * qd * np.abs(qd) + viscous * qd
        return tau

    given = RobotModel.from_urdf(with_wrong_inertials(urdf, 23))
    prepared = prepare(given, [record(urdf, 23, extra=extra, duration_s=30.0)], Settings(), ())
    terms = [term(prepared.columns, name) for name in names]
    return reread(prepared, prepared.columns.of_candidates(terms, None), lambda *_: None), terms


def drag(model: FittedModel) -> tuple[float, float]:
    return term_parameters(model, model.proper_terms[0])["drag"]


def test_viscous_friction_that_is_not_found_does_not_go_into_drag() -> None:
    prepared, (found, *plain) = arm(0.5, DRAG, VISCOUS, OFFSET)
    alone, std_alone = drag(beside.fit_beside(prepared, [found], []))
    value, std = drag(beside.fit_beside(prepared, [found], plain))
    assert abs(alone - 3.0) > 5.0 * std_alone
    assert abs(value - 3.0) < 3.0 * std
    assert std < 0.1 * value


def test_friction_that_would_drive_by_chance_is_none_but_stays_in_the_interval() -> None:
    prepared, (found, *plain) = arm(0.0, DRAG, VISCOUS, OFFSET)
    free = fit_with_shapes(prepared, (found, *plain))
    assert term_parameters(free, plain[0])["viscous"][0] < 0.0
    model, without = beside.fit_beside(prepared, [found], plain), beside.fit_beside(prepared, [found], plain[1:])
    assert term_parameters(model, plain[0])["viscous"][0] == 0.0
    assert VISCOUS not in {t.effect.id for t in model.module().terms}
    value, std = drag(model)
    fitted, narrow = drag(without)
    assert value == pytest.approx(fitted, rel=1e-6)
    assert std > 1.5 * narrow
    assert abs(value - 3.0) < 2.0 * std


def test_friction_that_would_drive_clearly_is_something_else() -> None:
    prepared, (found, *plain) = arm(-0.5, DRAG, VISCOUS, OFFSET)
    model, without = beside.fit_beside(prepared, [found], plain), beside.fit_beside(prepared, [found], plain[1:])
    assert plain[0] not in model.proper_terms
    assert drag(model) == pytest.approx(drag(without), rel=1e-9)


@pytest.mark.parametrize(
    ("plain", "found", "contained"),
    [
        ("torque_offset", ("asymmetric_coulomb_friction",), True),
        ("coulomb_friction", ("asymmetric_coulomb_friction",), True),
        ("viscous_friction", ("asymmetric_coulomb_friction",), False),
        ("torque_offset", ("coulomb_friction", "quadratic_drag"), False),
        ("coulomb_friction", ("torque_offset",), False),
        ("coulomb_friction", (), False),
    ],
)
def test_plain_friction_among_other_terms_is_not_fitted_twice(
    plain: str, found: tuple[str, ...], contained: bool
) -> None:
    prepared, _ = arm(0.0, DRAG)
    columns = prepared.columns
    terms = [term(columns, name) for name in found]
    assert beside._contained(term(columns, plain), terms) is contained
    elsewhere = [replace(c, site=Site(2)) for c in terms]
    assert beside._contained(term(columns, plain), elsewhere) is False


def test_constants_are_as_uncertain_as_friction_is_uneven_elsewhere() -> None:
    prepared, _ = arm(0.0, DRAG)
    bare = prepared.columns
    spring = bare.candidate(effect("joint_spring"), Site(JOINT), {})
    friction = bare.candidate(effect("coulomb_friction"), Site(JOINT), {})
    uneven = bare.candidate(effect("asymmetric_coulomb_friction"), Site(0), {})
    terms = [spring, friction, uneven]
    prepared = reread(prepared, bare.of_candidates(terms, None), lambda *_: None)
    model = prepared.fit(terms)
    columns, x = model.columns, model.x.clone()
    x[columns.of(uneven)] = torch.tensor([1.2, 0.8], dtype=torch.float64)
    x[columns.of(friction)] = 3.0
    model = replace(model, x=x)
    wider = beside._uneven(model)
    k = int((model.free == columns.of(spring)[1]).nonzero())
    # Offset 0.2 beside 1.0 at the other joint: 0.2 of 3.0 here.
    assert float(wider.covariance[k, k] - model.covariance[k, k]) == pytest.approx(0.6**2)
    change = wider.covariance - model.covariance
    change[k, k] = 0.0
    assert not change.any()


def test_the_term_that_is_within_chance_of_zero_does_not_stand() -> None:
    """A spring that is not there, beside drag that is."""
    prepared, terms = arm(0.5, DRAG, VISCOUS, OFFSET, "joint_spring")
    model = beside.fit_beside(prepared, terms, [])
    assert significance(model, terms[0]) > 10.0
    assert refuted(model, [terms[0], terms[3]]) == [terms[3]]
    assert refuted(model, terms[:1]) == []
    assert refuted(model, terms[:3]) == [terms[2]]


def test_a_term_whose_parameters_contradict_each_other_does_not_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    prepared, terms = arm(0.5, DRAG, VISCOUS)
    model = beside.fit_beside(prepared, terms, [])
    monkeypatch.setattr(type(terms[0].effect), "contradicted", lambda self, found: True)
    assert refuted(model, terms) == [terms[0]]
