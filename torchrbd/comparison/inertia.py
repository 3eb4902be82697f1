"""What changed in the rigid body: combinations of inertial parameters that both data sets identify, and a load.

With d the difference of the base parameters beta = K pi and C the sum of their covariances, a mass m at c on body b is

    d = K_b p(m, c) + noise,   p = m [1, c, |c|^2 1 - c c']

Every body is tried. The load that explains d best is reported, if it explains d.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from torchrbd.comparison.reading import Inertia
from torchrbd.comparison.results import NEGLIGIBLE_INERTIA, Difference, Load, difference
from torchrbd.diagnosis.results import Quantity
from torchrbd.parameters import PARAMETERS_PER_BODY

# Above this share of information from the prior, a combination is not identified by the data.
MOST_OF_URDF = 0.2
# A load explains a change if no more than this part of it is left; links that leave so little more are as good.
LEFT, CLEARER = 0.2, 10.0
# Standard deviations from zero that its mass has to be.
SURE = 3.0


def inertial_differences(one: Inertia | None, other: Inertia | None) -> dict[str, Difference] | None:
    """Return the combinations that both identify; None where they cannot be compared."""
    if one is None or other is None or not one.alike(other):
        return None
    informed = _informed_by_data(one, other)
    # A combination that happens to be small is as large as what it is made of.
    size, found = np.abs(one.K) @ np.maximum(np.abs(one.pi), np.abs(other.pi)), {}
    for k in informed:
        quantities = [Quantity(float(i.beta[k]), float(i.covariance[k, k]) ** 0.5, i.units[k]) for i in (one, other)]
        found[one.expressions[k]] = difference(
            quantities[0], quantities[1], float(size[k]), negligible=NEGLIGIBLE_INERTIA, among=len(informed)
        )
    return found


def load_like(one: Inertia | None, other: Inertia | None, bodies: Sequence[str]) -> Load | None:
    """Return the load that explains the change of the inertial parameters; None if none does.

    Args:
        one, other: before and after.
        bodies: (n_params,) owners of their columns.
    """
    if one is None or other is None or not one.alike(other):
        return None
    informed = _informed_by_data(one, other)
    if not informed:
        return None
    C = (one.covariance + other.covariance)[np.ix_(informed, informed)]
    size = np.sqrt(C.diagonal())
    root = np.linalg.cholesky(C / np.outer(size, size) + 1e-9 * np.eye(len(informed)))
    d, K = (
        solve_triangular(root, x, lower=True)
        for x in ((other.beta - one.beta)[informed] / size, one.K[informed] / size[:, None])
    )
    found = [
        (*_load(d, K[:, first : first + PARAMETERS_PER_BODY]), bodies[first])
        for first in range(0, K.shape[1], PARAMETERS_PER_BODY)
    ]
    best = min(found, key=lambda one: one[0])
    if best[0] > LEFT * float(d @ d) or abs(best[1]) < SURE * best[2]:
        return None
    links = [link for left, _, _, link in found if left < best[0] + CLEARER]
    return Load(tuple(links), best[1], best[2])


def _informed_by_data(one: Inertia, other: Inertia) -> list[int]:
    """Return the rows that both data sets identify."""
    return np.flatnonzero(np.maximum(one.share, other.share) < MOST_OF_URDF).tolist()


def _load(d: np.ndarray, K: np.ndarray) -> tuple[float, float, float]:
    """Return what a mass on a body leaves of d, the mass and its std; d and K (n, 10) are whitened."""

    def left(x: np.ndarray) -> np.ndarray:
        return d - K @ _point(x)

    mass, moment = np.split(np.linalg.lstsq(K[:, :4], d, rcond=None)[0], [1])
    start = np.array([mass[0], *(moment / mass[0] if abs(mass[0]) > 1e-6 else moment)])
    fit = least_squares(left, start, method="trf")
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac)
    return 2.0 * float(fit.cost), float(fit.x[0]), float(covariance[0, 0]) ** 0.5


def _point(x: np.ndarray) -> np.ndarray:
    """Return the inertial parameters (10,) of a mass x[0] at x[1:]."""
    m, c = x[0], x[1:]
    inertia = m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([m, *(m * c), *(inertia[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))])
