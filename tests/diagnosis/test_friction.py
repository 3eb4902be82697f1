"""Ordinary friction as findings: sure where the URDF is wrong, none where it is right, uneven where directions are."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from likelihood.arms import Torque, recorded, rows_of, wrong_robot
from likelihood.fits import COULOMB, OPTIONS, URDF, VISCOUS, WIDTH, at_joint, with_friction
from scipy.stats import multivariate_normal
from simulated import joint_names, record, with_wrong_inertials

import torchrbd
from torchrbd.diagnosis.friction import Friction, ordinary_friction
from torchrbd.diagnosis.hypotheses import rows_with_load
from torchrbd.effects import Site, effect
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine

ALL = ("viscous_friction", "coulomb_friction", "asymmetric_coulomb_friction")
EVEN, UNEVEN = ALL[1:]
PUSH = 0.1


def uneven(m) -> np.ndarray:
    """Return half of the difference of Coulomb friction between both directions of the first joint."""
    return PUSH * np.tanh(m.qd[:, 0] / WIDTH) ** 2


PUSHED = at_joint(0, uneven)


@lru_cache(maxsize=4)
def learnt(torque: Torque | None = None, missing: str = "") -> Likelihood:
    recording = recorded(URDF, 2, with_friction(torque), missing=[missing], **OPTIONS)
    return learn(Machine(rows_of(wrong_robot(URDF, 1), [recording])))


def told(fit: Likelihood, may=ALL, damping=(0.0, 0.0), friction=(0.0, 0.0)) -> dict[tuple[str, int], Friction]:
    """Return friction by effect and joint, the URDF having this much of it."""
    robot = fit.machine.rows.columns.robot
    for values, given in ((robot.damping, damping), (robot.friction, friction)):
        for j, value in enumerate(given):
            values[j] = value
    found = ordinary_friction(fit, fit.machine.rows.columns, may)
    return {(f.candidate.effect.id, f.candidate.joint): f for f in found}


def test_friction_that_the_urdf_lacks_is_sure() -> None:
    found = told(learnt())
    assert set(found) == {(name, j) for name in ALL[:2] for j in (0, 1)}
    for f in found.values():
        assert f.log_evidence > 30
        assert f.probability > 0.99


def test_friction_that_the_urdf_has_is_no_finding() -> None:
    found = told(learnt(), damping=VISCOUS, friction=COULOMB)
    assert len(found) == 4
    for f in found.values():
        assert f.log_evidence < 0.0
        assert f.probability < 0.5


def test_friction_of_which_the_urdf_has_too_much_is_sure() -> None:
    for f in told(learnt(), damping=np.multiply(2, VISCOUS), friction=np.multiply(2, COULOMB)).values():
        assert f.log_evidence > 30


def test_evidence_is_that_of_a_model_whose_friction_is_known() -> None:
    """Leaving out the viscous column of one joint is knowing that it is zero."""
    fit = learnt()
    k = int(fit.machine.friction.at(0)[0])
    g = fit.gaussian.among(np.setdiff1d(np.arange(len(fit.gaussian.z)), [k]))
    expected = fit.gaussian.log_evidence - g.log_evidence
    assert told(fit)["viscous_friction", 0].log_evidence == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("torque", "name"), [(None, EVEN), (PUSHED, UNEVEN)], ids=["even", "uneven"])
def test_directions_are_told_apart_where_they_differ(torque: Torque | None, name: str) -> None:
    found = told(learnt(torque))
    assert {key for key in found if key[1] == 0} == {("viscous_friction", 0), (name, 0)}
    assert {key for key in found if key[1] == 1} == {("viscous_friction", 1), (EVEN, 1)}


@pytest.mark.parametrize("push", [0.0, 0.018, 0.025, 0.035])
def test_how_sure_it_is_that_directions_differ_is_told(push: float) -> None:
    """Two laws, as likely as each other before the data, share what is sure of friction."""

    def slightly(m) -> np.ndarray:
        return push * np.tanh(m.qd[:, 0] / WIDTH) ** 2

    fit = learnt(at_joint(0, slightly))
    (law,) = (f for (name, joint), f in told(fit).items() if joint == 0 and name != "viscous_friction")
    at, size = fit.machine.friction.at(0)[1:], fit.machine.friction.size(0, fit.hyper)[1:]
    a = size * [1.0, -1.0]
    m, v = a @ fit.gaussian.z[at], a @ fit.gaussian.covariance(at) @ a
    odds = multivariate_normal(0.0, a @ a).pdf(0.0) / multivariate_normal(m, v).pdf(0.0)
    differ = odds / (1.0 + odds)
    assert (law.candidate.effect.id == UNEVEN) == (differ > 0.5)
    assert law.law == pytest.approx(max(differ, 1.0 - differ), abs=1e-9)


@pytest.mark.parametrize(
    ("name", "site", "found_as"),
    [
        ("torque_offset", Site(0), EVEN),
        ("joint_spring", Site(0), EVEN),
        ("joint_coupling", Site(0, 1), EVEN),
        ("torque_offset", Site(1), UNEVEN),
        ("torque_offset", Site(0, recordings=("r",)), UNEVEN),
        ("quadratic_drag", Site(0), UNEVEN),
    ],
)
def test_a_joint_with_a_constant_torque_has_even_friction(name: str, site: Site, found_as: str) -> None:
    """Also where it is that of a spring's rest: both are told of what happens within a reversal alone."""
    fit, e = learnt(PUSHED), effect(name)
    rows = rows_with_load(fit)
    law = rows.columns.candidate(e, site, {})
    F = rows.features(law)
    beside = fit.extended((Extra(law.place, F, np.ones(len(F))),))
    found = {
        f.candidate.effect.id for f in ordinary_friction(beside, rows.columns, ALL, [law]) if f.candidate.joint == 0
    }
    assert found == {"viscous_friction", found_as}


def test_uneven_friction_is_told_of_a_urdf_that_has_the_mean() -> None:
    f = told(learnt(PUSHED), damping=VISCOUS, friction=COULOMB)[UNEVEN, 0]
    assert f.log_evidence > 10
    assert f.probability > 0.99


@pytest.mark.parametrize(
    ("may", "names"),
    [
        ((), set()),
        (ALL[:1], {"viscous_friction"}),
        ((EVEN,), {EVEN}),
        ((UNEVEN,), {UNEVEN}),
        (("joint_spring",), set()),
    ],
)
def test_what_may_not_be_there_is_not(may: tuple[str, ...], names: set[str]) -> None:
    found = told(learnt(PUSHED), may)
    assert {name for name, _ in found} == names
    assert len(found) == 2 * len(names)


def test_a_joint_without_torque_has_no_friction() -> None:
    found = told(learnt(None, joint_names(URDF)[0]))
    assert {joint for _, joint in found} == {1}


def wandering(m) -> np.ndarray:
    """Return an offset of the first joint that is no larger than its drift, at 0.05 Hz."""
    return 0.5 + 0.5 * np.sin(0.1 * np.pi * m.t)


def test_each_joint_has_an_offset_that_is_no_finding() -> None:
    found = told(learnt(at_joint(0, wandering)), (*ALL, "torque_offset"))
    for j in (0, 1):
        assert found["torque_offset", j].probability == 0.0


@pytest.mark.parametrize(("name", "site"), [("torque_offset", Site(0)), ("joint_spring", Site(0)), ("", Site(0))])
def test_one_constant_torque_is_enough(name: str, site: Site) -> None:
    """That of a law, or friction that differs by direction, takes its place."""
    fit = learnt(PUSHED)
    rows = rows_with_load(fit)
    laws = [rows.columns.candidate(effect(name), site, {})] if name else []
    fit = fit.extended([Extra(c.place, F, np.ones(len(F))) for c in laws if len(F := rows.features(c))])
    every = ordinary_friction(fit, rows.columns, (*ALL, "torque_offset"), laws)
    found = {f.candidate.effect.id for f in every if f.candidate.joint == 0}
    assert "torque_offset" not in found
    assert (UNEVEN in found) == (not name)


def test_a_diagnosis_predicts_offsets_as_an_identification_does() -> None:
    """Drift explains an offset of its own size, so that the search finds none; held-out data has it nevertheless."""
    options = {**OPTIONS, "extra": with_friction(at_joint(0, wandering))}
    one, other = record(URDF, 2, **options), record(URDF, 3, name="other", **options)
    identified = torchrbd.identify(URDF, one, holdout=other)
    diagnosed = torchrbd.diagnose(URDF, one, holdout=other, effects=["torque_offset", *ALL])
    assert "torque_offset" not in {f.effect for f in diagnosed.findings}
    joint = joint_names(URDF)[0]
    before, after = (each.fits["extended"].nmse[joint] for each in (identified, diagnosed.identification))
    assert after < 1.02 * before


def test_an_offset_costs_nothing_where_there_is_none() -> None:
    """It has the prior of the drift's level, so that it does not absorb gravity."""
    options = {**OPTIONS, "duration_s": 12.0, "extra": with_friction()}
    wrong, one = with_wrong_inertials(URDF, 3), record(URDF, 2, **options)
    other = record(URDF, 3, name="other", **options)
    with_it, without = (
        torchrbd.diagnose(wrong, one, holdout=other, effects=effects).identification.fits["extended"]
        for effects in ([*ALL, "torque_offset"], ALL)
    )
    assert with_it.mean_nmse < 1.02 * without.mean_nmse
