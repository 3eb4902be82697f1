"""The physically valid fit: convex in pi, with the entropic prior as its barrier.

    minimise  1/2 x'Hx - h'x + kappa sum_bodies [tr(J0^-1 J) - logdet J]

It is solved along the central path, see ``central_path.py``.

Source: Lee, Wensing, Park (T-RO 2020), eq. (31).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import nnls
from torch import Tensor

from torchrbd.likelihood.central_path import Problem, follow_path, in_blocks
from torchrbd.likelihood.equations import Equations
from torchrbd.likelihood.urdf_prior import Prior, orthonormal_steps
from torchrbd.parameters import PARAMETERS_PER_BODY, is_physical
from torchrbd.robot import from_pseudo_inertia

# Moments are exact to about 1e-16 of the largest: in stiffer equations, rounding would dominate the weak directions.
_STIFFEST = 1e13
# Largest number of rounds of multipliers; change of a sum at convergence, in standard deviations; jitter, since sums of
# the same column depend on each other.
_MOST_PULLS, _SETTLED, _JITTER = 8, 1e-6, 1e-12


@dataclass(frozen=True)
class PhysicalFit:
    """Coefficients with a positive definite pseudo-inertia for every fitted body, and the precision of z there.

    ``x`` (n,); ``free`` indices of the fitted ones; ``precision`` (n_free, n_free) is the Hessian of the objective in
    prior coordinates; ``steps`` is the number of Newton steps; ``converged`` is whether the last one was short.
    """

    x: Tensor
    free: Tensor
    precision: Tensor
    steps: int
    converged: bool


def physical_fit(prior: Prior, equations: Equations, terms: Tensor) -> PhysicalFit:
    """Fit inertial parameters and terms.

    Equations stiffer than 1e13 prior precisions are reduced to that.

    Args:
        prior: prior; its kappa is the weight of the divergence.
        equations: normal equations in prior coordinates.
        terms: indices of the columns of the free terms.
    """
    free = torch.cat((prior.inertial, terms))
    L0 = torch.linalg.cholesky(torch.linalg.inv(prior.inverse_inertia))
    turn = _turn(prior, L0)
    A = _turned(turn, equations.H[free.unsqueeze(1), free].numpy())
    trust = min(1.0, _STIFFEST / max(float(A.diagonal().max()), 1.0)) if len(free) else 1.0
    A, h = trust * A, trust * in_blocks(turn.swapaxes(1, 2), equations.h[free, None].numpy())[:, 0]
    terms_alone = np.arange(len(prior.inertial), len(A))
    A[terms_alone, terms_alone] += 1.0
    problem = Problem(A, h, prior.kappa, len(prior.bodies))
    z, L, steps, converged = follow_path(problem)
    K = problem.columns(L)
    N, *_ = problem.step(K, L, z, np.broadcast_to(np.eye(4), L.shape), np.zeros(1))
    N[np.diag_indices(problem.n_inertial)] += prior.kappa - 1.0
    precision = torch.from_numpy(_turned(np.linalg.inv(turn @ K), N))
    x = prior.mean + prior.scale[:, free] @ torch.from_numpy(in_blocks(turn, z[:, None])[:, 0])
    factor = L0 @ torch.from_numpy(L)
    x[prior.inertial] = _representable(x[prior.inertial].reshape(-1, PARAMETERS_PER_BODY), factor, L0).flatten()
    return PhysicalFit(x, free, 0.5 * (precision + precision.T), steps, converged)


def fit_with_signs(prior: Prior, equations: Equations, terms: Tensor, signs: Tensor) -> PhysicalFit:
    """Fit inertial parameters and terms, with some sums of coefficients kept non-negative.

        minimise  f(x)  subject to  W x >= 0:   grad f(x) = W'l,  l >= 0,  l'W x = 0

    f is as in ``physical_fit``. The multipliers l are those of f to second order around the last fit. f is nearly
    quadratic in the terms, so a few rounds suffice. The precision is that of f.

    Args:
        prior, equations, terms: as for ``physical_fit``.
        signs: W (K, n), rows of columns of terms.

    Source: Nocedal, Wright, "Numerical Optimization" (2006), ch. 18 (sequential quadratic programming).
    """
    fit = physical_fit(prior, equations, terms)
    if bool((signs @ fit.x >= 0.0).all()):
        return fit
    G = (signs @ prior.scale)[:, fit.free]
    pull = torch.zeros(len(signs), dtype=torch.float64)
    for _ in range(_MOST_PULLS):
        C = G @ torch.linalg.solve(fit.precision, G.T)
        before, pull = pull, _multipliers(signs @ fit.x - C @ pull, C)
        if bool(((pull - before).abs() * C.diagonal().sqrt() < _SETTLED).all()):
            break
        pulled = equations.h + prior.scaled((signs.T @ pull).unsqueeze(1), back=True)[:, 0]
        fit = physical_fit(prior, Equations(equations.H, pulled), terms)
    # These sums, and those with the wrong sign, are zero up to rounding.
    none = signs[(pull > 0.0) | (signs @ fit.x < 0.0)]
    return replace(fit, x=fit.x - torch.linalg.pinv(none) @ (none @ fit.x))


def _multipliers(y: Tensor, C: Tensor) -> Tensor:
    """Return l (K,) with y + C l >= 0, l >= 0 and l'(y + C l) = 0, for sums y (K,) with covariance C (K, K)."""
    free = C.diagonal() > 0.0
    size = C.diagonal()[free].rsqrt()
    L = torch.linalg.cholesky(size[:, None] * C[free][:, free] * size + _JITTER * torch.eye(int(free.sum())))
    wanted = -torch.linalg.solve_triangular(L, (size * y[free]).unsqueeze(1), upper=False)[:, 0]
    found, _ = nnls(L.T.numpy(), wanted.numpy())
    pull = torch.zeros_like(y)
    pull[free] = size * torch.from_numpy(found)
    return pull


def _turn(prior: Prior, L0: Tensor) -> np.ndarray:
    """Return the blocks Q (n_bodies, 10, 10) from z of ``Problem`` to the prior's; terms do not change.

    They are orthogonal if both have the same kappa.
    """
    return torch.linalg.solve(prior.blocks, orthonormal_steps(L0) / prior.kappa**0.5).numpy()


def _turned(blocks: np.ndarray, A: np.ndarray) -> np.ndarray:
    """Return diag(Q, 1)' A diag(Q, 1) for a symmetric A (n, n)."""
    back = blocks.swapaxes(1, 2)
    return in_blocks(back, in_blocks(back, A).T)


def _representable(pi: Tensor, factor: Tensor, factor0: Tensor) -> Tensor:
    """Return bodies (n, 10) that are physical in floating point too.

    Close to the boundary, rounding can change the sign of an eigenvalue; there, the least necessary part of the prior's
    body is added.

    Args:
        pi: (n, 10), physical up to rounding.
        factor, factor0: (n, 4, 4) factors of J and J0.
    """
    J, J0 = factor @ factor.mT, factor0 @ factor0.mT
    share, good = 1e-14, is_physical(pi)
    size = torch.linalg.solve(factor0, factor).square().sum((-2, -1))
    while share < 1.0 and not bool(good.all()):
        raised = from_pseudo_inertia(J + (share * size)[:, None, None] * J0)
        pi = torch.where(good.unsqueeze(-1), pi, raised)
        share, good = 10.0 * share, is_physical(pi)
    return pi
