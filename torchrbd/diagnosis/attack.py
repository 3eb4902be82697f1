"""Where on a link a force attacks, and how large it is.

A force f at the point c of a link takes the torque -J' f, which is linear in f and in c f': twelve coefficients
w = -(f, c_i f_k), of which only six are free. With G and u the precision and score of the twelve,

    f, c = argmin 1/2 w' G w - u' w

The curvature there gives the standard deviations of force and point. A payload is the same with its mass in place of f:
the coefficients are mass and first moments. Its moments of inertia are left out, so that the point is a first guess.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.results import Attack
from torchrbd.likelihood.likelihood import Likelihood

# Prior widths: a point lies within so many metres of the link's frame, forces below so many newtons, masses kilograms.
_REACH, _FORCE = 1.0, 1e4
# The first columns of a payload are of its mass and first moments; directions of the equations below this part of the
# largest are rounding.
_MASS_AND_MOMENTS, _RANK, _SOLVED = 4, 1e-9, 1e-6


def attack(fit: Likelihood, rows: Rows, candidate: Candidate, *, payload: bool) -> Attack:
    """Return force and point of attack.

    Args:
        fit: without what acts on the link.
        rows: of the fit.
        candidate: what acts there: a payload, or a force at a point.
        payload: which of both.
    """
    gravity, sizes = rows.columns.robot.gravity.numpy(), 1 if payload else 3
    features = rows.features(candidate)[: _MASS_AND_MOMENTS if payload else None]
    G, u = fit.precision_and_score(None, features)
    values, vectors = np.linalg.eigh(G)
    kept = values > _RANK * values[-1]
    R = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    target = (vectors[:, kept].T @ u) / np.sqrt(values[kept])

    def misfit(x: np.ndarray) -> np.ndarray:
        w = np.concatenate((x[:sizes], np.outer(x[sizes:], x[:sizes]).ravel()))
        return np.concatenate((R @ w - target, x[:sizes] / _FORCE, x[sizes:] / _REACH))

    linear = np.linalg.lstsq(R, target, rcond=_SOLVED)[0]
    first = linear[:sizes]
    point = linear[sizes:].reshape(3, sizes) @ first / max(float(first @ first), 1e-12)
    found = least_squares(misfit, np.concatenate((first, np.clip(point, -_REACH, _REACH))), x_scale="jac")
    std = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    force, force_std = -found.x[:sizes], std[:sizes]
    if payload:
        force, force_std = found.x[0] * gravity, std[0] * np.abs(gravity)
    return Attack(*(tuple(map(float, x)) for x in (force, force_std, found.x[sizes:], std[sizes:])))  # type: ignore[arg-type]
