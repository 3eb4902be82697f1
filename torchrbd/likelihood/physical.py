"""The prior of inertial parameters: entropic around the URDF, so always physical; expanded to second order.

    p(J) ~ exp(-kappa [tr(J0^-1 J) - logdet(J0^-1 J)])

It is a Wishart distribution of pseudo-inertias with 2 kappa + 5 degrees of freedom and the URDF's J0 as its mode. In
coordinates z, J = F (1 + sum_k z_k B_k / sqrt(kappa)) F' with J0 = F F' and B orthonormal, its curvature at z = 0 is
one. Around any other point z* it is, to second order, Gaussian. The exact normaliser is

    Z = 2^(nu p / 2) |1 / (2 kappa)|^(nu / 2) Gamma_p(nu / 2),   nu = 2 kappa + 5, p = 4

Source: Lee, Wensing, Park (T-RO 2020) eq. (25), (31); Muirhead, "Aspects of Multivariate Statistical Theory" (1982),
theorem 3.2.1.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache

import numpy as np
from scipy.special import multigammaln  # type: ignore[attr-defined]

from torchrbd.likelihood.central_path import Problem, follow_path
from torchrbd.likelihood.gaussian import Quadratic
from torchrbd.parameters import ORTHONORMAL, PARAMETERS_PER_BODY

_B = ORTHONORMAL.numpy()
_SIZE = 4


def expanded(z: np.ndarray, kappa: float) -> Quadratic:
    """Return the log prior density of z (10 b,) to second order around a point, minus that of N(0, 1) without its 2 pi.

    Args:
        z: the point, physical.
        kappa: weight of the divergence.
    """
    return _expanded(z.tobytes(), kappa)


# Models that differ in their noise are expanded around the same point, one after the other: cache.
@lru_cache(maxsize=16)
def _expanded(at: bytes, kappa: float) -> Quadratic:
    z = np.frombuffer(at)
    n = len(z)
    G = np.eye(_SIZE) + np.einsum("bk,kij->bij", z.reshape(-1, PARAMETERS_PER_BODY), _B) / math.sqrt(kappa)
    inverse = np.linalg.inv(G)
    WB = inverse[:, None] @ _B
    shape = len(G), PARAMETERS_PER_BODY, _SIZE**2
    curvature = WB.reshape(shape) @ WB.swapaxes(2, 3).reshape(shape).swapaxes(1, 2)
    slope = math.sqrt(kappa) * (np.einsum("kii->k", _B) - np.einsum("bkii->bk", WB)).ravel()
    P = np.zeros((n, n))
    for b, own in enumerate(curvature):
        here = slice(PARAMETERS_PER_BODY * b, PARAMETERS_PER_BODY * (b + 1))
        P[here, here] = own
    value = kappa * float(np.sum(np.trace(G, axis1=1, axis2=2) - np.linalg.slogdet(G)[1]))
    constant = -value + float(slope @ z) - 0.5 * float(z @ P @ z) - len(G) * _log_normaliser(kappa)
    return Quadratic(P, P @ z - slope, constant)


@cache
def _log_normaliser(kappa: float) -> float:
    """Return log integral of exp(-kappa [tr G - logdet G]) over z, minus 5 log 2 pi.

    Muirhead's measure is that of the entries of G on and above the diagonal; the off-diagonal ones are coefficients of
    B divided by root 2.
    """
    nu = 2.0 * kappa + _SIZE + 1
    entries = 0.5 * nu * _SIZE * (math.log(2.0) - math.log(2.0 * kappa)) + float(multigammaln(0.5 * nu, _SIZE))
    off_diagonal = _SIZE * (_SIZE - 1) // 2
    per_z = 0.5 * PARAMETERS_PER_BODY * math.log(kappa) + 0.5 * off_diagonal * math.log(2.0)
    return entries + per_z - 0.5 * PARAMETERS_PER_BODY * math.log(2.0 * math.pi)


def most_probable(A: np.ndarray, h: np.ndarray, kappa: float) -> np.ndarray:
    """Return the physical z (10 b,) that maximises -1/2 z'A z + h'z + the log prior."""
    z, *_ = follow_path(Problem(A, h, kappa, len(h) // PARAMETERS_PER_BODY))
    return z
