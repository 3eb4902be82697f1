"""How large what was not found could be: against models that have it, and against the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from likelihood.fits import COULOMB, URDF, at_joint, carried, fitted
from simulated import joint_names

from torchrbd.diagnosis.detection_limits import detection_limits
from torchrbd.diagnosis.explain import likeliest_left
from torchrbd.diagnosis.hypotheses import Hypothesis, hypothesis_of
from torchrbd.diagnosis.outcome import SearchOutcome
from torchrbd.diagnosis.results import DetectionLimit
from torchrbd.diagnosis.search import search_effects
from torchrbd.effects import Site, effect

EFFECTS = (
    "rotor_inertia",
    "joint_spring",
    "quadratic_drag",
    "torque_scale",
    "joint_coupling",
    "stribeck_friction",
    "payload",
)
FIRST, SECOND = joint_names(URDF)
ROTOR = at_joint(1, lambda m: 0.05 * m.qdd[:, 1])
Found = dict[tuple[str, tuple[str, ...]], DetectionLimit]


def by_place(found: SearchOutcome) -> Found:
    return {(x.effect, x.joints): x for x in detection_limits(found)}


@pytest.fixture(scope="module")
def explanation() -> SearchOutcome:
    """Return what is found where a rotor is missing at the second joint."""
    return search_effects(fitted(ROTOR), [effect(name) for name in EFFECTS], lambda *_: None)


@pytest.fixture(scope="module")
def found(explanation: SearchOutcome) -> Found:
    return by_place(explanation)


def test_what_is_in_the_model_or_acts_for_a_time_has_no_limit(explanation: SearchOutcome, found: Found) -> None:
    assert [t.own.name for t in explanation.terms] == [("rotor_inertia", Site(1))]
    assert ("rotor_inertia", (SECOND,)) not in found
    assert {name for name, _ in found} <= set(EFFECTS) - {"payload"}
    for name in ("joint_spring", "quadratic_drag"):
        assert {(name, (FIRST,)), (name, (SECOND,))} <= found.keys()
    assert len(found) == len(detection_limits(explanation))


@pytest.mark.parametrize(("name", "joint"), [("joint_spring", 1), ("quadratic_drag", 0)])
def test_value_and_std_are_those_of_a_model_that_has_the_effect(
    explanation: SearchOutcome, name: str, joint: int
) -> None:
    fit, rows = explanation.fit, explanation.rows
    h = hypothesis_of(fit, rows, rows.columns.candidate(effect(name), Site(joint), {}))
    assert h is not None
    (limit,) = detection_limits(replace(explanation, last=[h]))
    whole = fit.extended((*fit.extra, h.extra(fit, rows)))
    k = len(fit.extra)
    assert limit.value == pytest.approx(whole.coefficients(k)[0], rel=1e-3)
    variance = whole.gaussian.covariance([len(whole.gaussian.z) - len(h.std)])[0, 0]
    assert limit.std == pytest.approx(whole.extra[k].std[0] * variance**0.5, rel=1e-3)


def test_the_truth_is_within_the_std(found: Found) -> None:
    off = [(x.value - x.none) / x.std for x in found.values()]
    assert len(off) >= 8
    assert max(map(abs, off)) < 4.5


def test_none_is_what_the_parameter_is_without_the_effect(found: Found) -> None:
    for joint, coulomb in zip((FIRST, SECOND), COULOMB, strict=True):
        assert found["torque_scale", (joint,)].none == 1.0
        assert found["joint_spring", (joint,)].none == 0.0
        limit = found["stribeck_friction", (joint,)]
        assert limit.parameter == "static"
        assert limit.none == pytest.approx(coulomb, rel=0.1)


def test_what_the_prior_says_is_no_limit(explanation: SearchOutcome, found: Found) -> None:
    """Were the data to leave half of the prior's variance, they would not tell."""
    h = next(h for h in explanation.last if h.name == ("joint_spring", Site(0)))
    std = h.extra(explanation.fit, explanation.rows).std / h.scale
    vague, sharp = (replace(explanation, last=[replace(h, std=part * std)]) for part in (0.7, 0.3))
    assert detection_limits(vague) == ()
    assert len(detection_limits(sharp)) == 1


def test_a_curve_has_no_limit(explanation: SearchOutcome) -> None:
    rows = explanation.rows
    curve = rows.columns.candidate(effect("smooth_torque_over_q"), Site(0), {"low": -1.0, "high": 1.0})
    h = Hypothesis(curve, 1.0, np.zeros(21), np.full(21, 1e-6), 1.0, 1)
    assert detection_limits(replace(explanation, last=[h])) == ()


def test_a_spring_of_twelve_std_stands_out(found: Found) -> None:
    """The std says how much data with this noise can hide."""
    size = 12.0 * found["joint_spring", (FIRST,)].std
    fit = fitted(at_joint(0, lambda m: size * m.q[:, 0]))
    rows = carried(fit)
    h = hypothesis_of(fit, rows, rows.columns.candidate(effect("joint_spring"), Site(0), {}))
    assert h is not None
    assert h.coefficients[0] == pytest.approx(size, abs=4.0 * h.std[0])
    assert h.coefficients[0] > 6.0 * h.std[0]


def test_another_effect_is_next_only_where_the_search_ended_before(explanation: SearchOutcome) -> None:
    ended_before = replace(explanation, terms=(), last=explanation.first, complete=False)
    found = likeliest_left(ended_before)
    assert found is not None
    assert (found.terms, found.effect) == (0, explanation.first[0].candidate.effect.id)
    assert likeliest_left(replace(ended_before, complete=True)) is None
    assert explanation.complete
