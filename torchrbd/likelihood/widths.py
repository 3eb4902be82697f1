"""The speed over which friction changes its sign: the most probable width."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from torchrbd.dataset.rows import Rows
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.gaussian import Gaussian, added
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.noise import Noise
from torchrbd.nuisance.directions import STICKS

# Fractions of a joint's RMS speed.
_WIDTHS = np.geomspace(0.003, 0.45, 18)


def trial_widths(rows: Rows) -> np.ndarray:
    """Return widths (K, n) that are compared, from small to large; none is below the error of the velocity."""
    speed = np.sqrt(np.mean(rows.qd**2, axis=1))
    return np.hypot(np.multiply.outer(_WIDTHS, speed), rows.speed_std)


DryFriction = Callable[[np.ndarray], Mapping[int, Extra]]
"""Additional friction, by its number in the model, if it changes its sign over some speeds (n,)."""


def likeliest_widths(
    machine: Machine,
    fit: Gaussian,
    noise: Sequence[Noise],
    coulomb: np.ndarray,
    joints: Collection[int],
    also: DryFriction,
    at: Callable[[int], np.ndarray],
) -> dict[int, float]:
    """Return the most probable width [rad/s] or [m/s] of the dry friction of some joints, given the rest of the model.

    Args:
        machine: rigid body and baseline terms.
        fit: the posterior of all columns.
        noise: that whitens the rows of each joint.
        coulomb: (n,) approximate dry friction [N m or N].
        joints: their indices.
        also: additional friction.
        at: returns the coefficients of additional columns, by their number.
    """
    first = {k: e.place for k, e in also(machine.rows.speed_std).items()}
    rest = {j: fit.among(_others(machine, fit, j, [at(k) for k, place in first.items() if place == j])) for j in joints}
    found = {j: list[tuple[float, float]]() for j in joints}
    for widths in trial_widths(machine.rows):
        curves = also(widths).values()
        for j, width in zip(joints, widths[list(joints)].tolist(), strict=True):
            F, held = machine.directions.sign(j, width), machine.directions.held(j, width)
            own = [e for e in curves if e.place == j]
            std = [machine.friction.std(j, F), np.full(len(STICKS), coulomb[j]), *(e.std for e in own)]
            columns = noise[j].white(np.concatenate((F, held, *(e.features for e in own))))
            S, r = rest[j].precision_and_score({j: columns})
            found[j].append((float(added(S, r, np.concatenate(std)).log_evidence), width))
    return {j: max(each)[1] for j, each in found.items()}


def _others(machine: Machine, fit: Gaussian, joint: int, also: Sequence[np.ndarray]) -> np.ndarray:
    """Return the coefficients of all columns that do not depend on the width of a joint's friction."""
    dropped = [machine.friction.at(joint)[1:], [machine.transition.width(joint)], machine.sticking.at(joint), *also]
    return np.setdiff1d(np.arange(len(fit.z)), np.concatenate(dropped))
