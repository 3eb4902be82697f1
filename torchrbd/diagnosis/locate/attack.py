"""Where on a link a force attacks, and how large it is.

A force f at the point c of a link takes the torque -J' f, which is linear in f and in c f': twelve coefficients
w = -(f, c_i f_k), of which only six are free. With G and u the normal equations of the twelve,

    f, c = argmin 1/2 w' G w - u' w

The curvature there gives the standard deviations of force and point.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from torchrbd.diagnosis.results import Attack
from torchrbd.diagnosis.rows.regression import Fit

# Prior widths: a point lies within so many metres of the link's frame, forces below so many newtons.
_REACH, _FORCE = 1.0, 1e4


def attack(fit: Fit, columns: dict[int, np.ndarray], form: str, gravity: np.ndarray) -> Attack:
    """Return force and point of attack.

    Args:
        fit: without the part.
        columns: its columns by joint, (4, M) of a payload (mass, first moments) or (12, M) of a force.
        form: "payload" or "force".
        gravity: (3,) [m/s^2].
    """
    G, _, u = fit.equations(columns)
    values, vectors = np.linalg.eigh(G)
    kept = values > 1e-9 * values[-1]
    R = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    target = (vectors[:, kept].T @ u) / np.sqrt(values[kept])
    payload = form == "payload"
    sizes = 1 if payload else 3

    def misfit(x: np.ndarray) -> np.ndarray:
        w = np.concatenate((x[:sizes], np.outer(x[sizes:], x[:sizes]).ravel()))
        return np.concatenate((R @ w - target, x[:sizes] / _FORCE, x[sizes:] / _REACH))

    linear = np.linalg.lstsq(R, target, rcond=1e-6)[0]
    first = linear[:sizes]
    point = linear[sizes:].reshape(3, sizes) @ first / max(float(first @ first), 1e-12)
    found = least_squares(misfit, np.concatenate((first, np.clip(point, -_REACH, _REACH))), x_scale="jac")
    std = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    force, force_std = -found.x[:sizes], std[:sizes]
    if payload:
        force, force_std = found.x[0] * gravity, std[0] * np.abs(gravity)
    return Attack(*(tuple(map(float, x)) for x in (force, force_std, found.x[sizes:], std[sizes:])))  # type: ignore[arg-type]
