"""Baseline friction and offset of every joint, rotor inertia of drives: how they differ from the URDF's.

Coefficients are estimated in every model. Their evidence is the ratio of densities at the URDF's value, prior over
posterior (Savage and Dickey). That Coulomb friction differs by direction has prior odds of one: every model has both
directions, so that nothing is searched. Where a law that was found has the same column, each may absorb a part of the
other. Both the coefficients alone and the sums then have to differ from the URDF.

The likelihood has a level of the torque, too: the slowest part of its drift. A model that leaves it out predicts worse
than least squares with an offset. The level is therefore a torque offset of the model, and no finding: only the search
finds offsets, which are larger.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.posterior import probability_of
from torchrbd.effects import Effect, Site, effect
from torchrbd.effects.base import LEVEL, SPEED
from torchrbd.effects.registry import OF_DRIVES
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.robot import RobotModel

VISCOUS, COULOMB, UNEVEN, OFFSET = map(
    effect, ("viscous_friction", "coulomb_friction", "asymmetric_coulomb_friction", "torque_offset")
)
ROTOR = effect(OF_DRIVES)


@dataclass(frozen=True)
class Friction:
    """A term of baseline friction, or an offset, in a model.

    Attributes:
        candidate: the term.
        log_evidence: against what the URDF says.
        probability: that the URDF is wrong there; 0 of an offset, which the search judges.
        law: probability that directions differ, or do not, as the term has it.
    """

    candidate: Candidate
    log_evidence: float
    probability: float
    law: float = 1.0


def ordinary_friction(
    fit: Likelihood,
    columns: Columns,
    may: Sequence[str],
    laws: Sequence[Candidate] = (),
) -> tuple[Friction, ...]:
    """Return the friction of every joint with a torque, as far as it is among the effects that may be there.

    A constant torque, that of a spring's rest among them, and friction that differs by direction are one but for what
    happens within a reversal: a joint has one of both.

    Args:
        fit: the likelihood, with all that was found.
        columns: of the model that the terms are for.
        may: ids of effects.
        laws: what was found, as the likelihood has it.
    """
    found, shifted = [], {c.place for c in laws if LEVEL in c.labels}
    for j in range(columns.robot.n_dof):
        if not fit.machine.rows.seen[j]:
            continue
        found_as = dict[Effect, float]({VISCOUS: 1.0} if VISCOUS.id in may else {})
        differ = float(UNEVEN.id in may and j not in shifted)
        if differ and COULOMB.id in may:
            differ = float(expit(_uneven(fit, j)))
        if differ > DECISIONS.likely:
            found_as[UNEVEN] = differ
        elif COULOMB.id in may:
            found_as[COULOMB] = 1.0 - differ
        if OFFSET.id in may and UNEVEN not in found_as and j not in shifted:
            found_as[OFFSET] = 1.0
        if ROTOR.id in may and fit.machine.rows.driven[j]:
            found_as[ROTOR] = 1.0
        for e, law in found_as.items():
            candidate = columns.candidate(e, Site(j), {})
            found.append(weighed_given(Friction(candidate, -math.inf, 0.0, law), fit, columns.robot, laws))
    return tuple(found)


def weighed_given(one: Friction, fit: Likelihood, robot: RobotModel, laws: Sequence[Candidate]) -> Friction:
    """Return the same friction with its evidence in another likelihood and given other laws."""
    c = one.candidate
    assert c.joint is not None
    if LEVEL in c.labels:
        return one
    evidence = _evidence(fit, robot, c, laws)
    return replace(one, log_evidence=evidence, probability=probability_of(evidence))


def _evidence(fit: Likelihood, robot: RobotModel, c: Candidate, laws: Sequence[Candidate]) -> float:
    joint, (label, *_) = c.joint, c.labels
    own = slice(0, 1) if label == SPEED else slice(1, None)
    at, size = fit.machine.friction.at(joint)[own], fit.machine.friction.size(joint, fit.hyper)[own]
    urdf = robot.damping[joint] if label == SPEED else robot.friction[joint]
    if c.effect is ROTOR:
        # The robot's own rotors are known torque.
        at, size, urdf = fit.machine.rotors.at(joint), np.array([fit.machine.rotors.size(joint)]), 0.0
    value = np.divide(float(urdf), size, out=np.zeros_like(size), where=size > 0)
    evidence = fit.gaussian.against(at, value)
    also = [(k, c.labels.index(label)) for k, c in enumerate(laws) if c.place == joint and label in c.labels]
    if also:
        index = np.concatenate((at, [fit.further(k)[i] for k, i in also]))
        sums = np.column_stack((np.diag(size), *(np.full(len(size), fit.extra[k].std[i]) for k, i in also)))
        evidence = min(evidence, fit.gaussian.against(index, float(urdf), sums))
    return evidence


def _uneven(fit: Likelihood, joint: int) -> float:
    """Return the log evidence against Coulomb friction that is the same in both directions."""
    at, size = fit.machine.friction.at(joint)[1:], fit.machine.friction.size(joint, fit.hyper)[1:]
    a = size * [1.0, -1.0] / max(float(np.linalg.norm(size)), 1e-300)
    m, v = float(a @ fit.gaussian.z[at]), float(a @ fit.gaussian.covariance(at) @ a)
    return 0.5 * (np.log(v) + m**2 / v) if v > 0 else 0.0
