"""How fast a joint is before its friction has changed its sign: the width of the greatest evidence."""

from __future__ import annotations

import numpy as np

from torchrbd.likelihood.gaussian import Gaussian, added
from torchrbd.likelihood.machine import STICKS, Machine
from torchrbd.likelihood.noise import Noise

# Parts of a joint's RMS speed.
_WIDTHS = tuple(np.geomspace(0.003, 0.45, 18).tolist())


def likeliest_width(machine: Machine, fit: Gaussian, noise: Noise, coulomb: float, joint: int) -> float:
    """Return the width [rad/s] or [m/s] at which a joint's dry friction has the greatest evidence beside all else.

    Args:
        machine: rigid body and ordinary physics.
        fit: the posterior of all its columns.
        noise: by which the joint's rows are whitened.
        coulomb: its dry friction, about [N m or N].
        joint: which.
    """
    dropped = [*machine.ordinary(joint)[1:], machine.bend(joint), *machine.sticks(joint)]
    rest, found = fit.among(np.setdiff1d(np.arange(len(fit.z)), dropped)), []
    for part in _WIDTHS:
        width = float(np.hypot(part * machine.speed_rms[joint], machine.rows.speed_std[joint]))
        F = machine.sign(joint, width)
        std = np.append(machine.friction_std(joint, F), np.full(len(STICKS), coulomb))
        S, r = rest.precision_and_score({joint: noise.white(np.concatenate((F, machine.held(joint, width))))})
        found.append((float(added(S, r, std).log_evidence), width))
    return max(found)[1]
