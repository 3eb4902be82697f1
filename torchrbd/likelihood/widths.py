"""The speed over which friction changes its sign: the most probable width."""

from __future__ import annotations

import numpy as np

from torchrbd.likelihood.gaussian import Gaussian, added
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.noise import Noise
from torchrbd.nuisance.directions import STICKS

# Fractions of a joint's RMS speed.
_WIDTHS = tuple(np.geomspace(0.003, 0.45, 18).tolist())


def likeliest_width(machine: Machine, fit: Gaussian, noise: Noise, coulomb: float, joint: int) -> float:
    """Return the most probable width [rad/s] or [m/s] of a joint's dry friction, given the rest of the model.

    Args:
        machine: rigid body and baseline terms.
        fit: the posterior of all its columns.
        noise: that whitens the joint's rows.
        coulomb: approximate dry friction [N m or N].
        joint: its index.
    """
    dropped = [*machine.friction.at(joint)[1:], machine.transition.width(joint), *machine.sticking.at(joint)]
    speed = np.sqrt(np.mean(machine.rows.qd[joint] ** 2))
    rest, found = fit.among(np.setdiff1d(np.arange(len(fit.z)), dropped)), []
    for part in _WIDTHS:
        width = float(np.hypot(part * speed, machine.rows.speed_std[joint]))
        F, held = machine.directions.sign(joint, width), machine.directions.held(joint, width)
        std = np.append(machine.friction.std(joint, F), np.full(len(STICKS), coulomb))
        S, r = rest.precision_and_score({joint: noise.white(np.concatenate((F, held)))})
        found.append((float(added(S, r, std).log_evidence), width))
    return max(found)[1]
