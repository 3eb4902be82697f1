"""The physically valid fit: convex in pi, with the entropic prior as its barrier.

    minimise  1/2 x'Hx - h'x + kappa sum_bodies [tr(J0^-1 J) - logdet J]

In prior coordinates, with Newton's method. The path starts at the URDF, the minimiser for infinite kappa, and follows
kappa downwards, so that every Newton step is short; the objective is self-concordant, so that damped steps stay inside.

Source: Lee, Wensing, Park (T-RO 2020), eq. (31); Boyd, Vandenberghe, "Convex Optimization", sections 9.6 and 11.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.inference.map_fit import Scaled
from torchrbd.inference.prior import Prior, divergence_hessian
from torchrbd.parameters import BASIS, PARAMETERS_PER_BODY
from torchrbd.robot import pseudo_inertia

_PATH_FACTOR, _DECREMENT, _MOST_STEPS, _CONVERGED = 10.0, 1e-9, 100, 1e-3


@dataclass(frozen=True)
class PhysicalFit:
    """Coefficients with a positive definite pseudo-inertia for every fitted body, and the precision of z there.

    ``x`` (n,); ``precision`` (n_free, n_free) is the Hessian of the objective in prior coordinates; ``steps`` Newton
    steps taken; ``converged`` says whether the last one was short.
    """

    x: Tensor
    free: Tensor
    precision: Tensor
    steps: int
    converged: bool


def physical_fit(prior: Prior, equations: Scaled, terms: Tensor) -> PhysicalFit:
    """Fit inertial parameters and terms.

    Args:
        prior: prior; its kappa is the weight of the divergence.
        equations: normal equations in prior coordinates.
        terms: indices of the columns of the free terms.
    """
    free = torch.cat((prior.inertial, terms))
    H, h = equations.H[free.unsqueeze(1), free], equations.h[free]
    n_inertial = len(prior.inertial)
    S = prior.scale[prior.inertial][:, prior.inertial]
    z = torch.zeros(len(free), dtype=torch.float64)
    # Terms have no barrier: only their weak Gaussian prior holds them.
    ridge = torch.diag(torch.cat((z.new_zeros(n_inertial), z.new_ones(len(terms)))))
    largest = float(H.diagonal().max()) if len(free) else 0.0
    kappa = max(prior.kappa, largest, float(h.norm()) * prior.kappa**0.5)
    steps = 0
    while True:
        for _ in range(_MOST_STEPS):
            gradient, hessian = _barrier(prior, S, z[:n_inertial], kappa)
            total = H + ridge
            total[:n_inertial, :n_inertial] += hessian
            slope = (H + ridge) @ z - h
            slope[:n_inertial] += gradient
            step = -torch.cholesky_solve(slope.unsqueeze(1), _factor(total)).squeeze(1)
            decrement_sq = float(-(slope @ step)) / kappa
            steps += 1
            if decrement_sq < _DECREMENT:
                break
            # 1 / (1 + lambda) keeps a self-concordant function inside its domain.
            damping = 1.0 if decrement_sq < 1e-2 else 1.0 / (1.0 + decrement_sq**0.5)
            z = z + damping * step
        if kappa == prior.kappa:
            break
        kappa = max(kappa / _PATH_FACTOR, prior.kappa)
    return PhysicalFit(
        prior.mean + prior.scale[:, free] @ z, free, 0.5 * (total + total.T), steps, decrement_sq < _CONVERGED
    )


def _factor(A: Tensor) -> Tensor:
    """Return the Cholesky factor of A, its diagonal raised by as little as rounding makes necessary."""
    A, jitter = 0.5 * (A + A.T), 0.0
    while True:
        factor, info = torch.linalg.cholesky_ex(A + jitter * torch.diag(A.diagonal()))
        if int(info) == 0 or jitter > 1.0:
            return factor
        jitter = max(10.0 * jitter, 1e-15)


def _barrier(prior: Prior, S: Tensor, z: Tensor, kappa: float) -> tuple[Tensor, Tensor]:
    """Return gradient and Hessian in z of kappa sum [tr(J0^-1 J) - logdet J]."""
    pi = (prior.mean[prior.inertial] + S @ z).reshape(-1, PARAMETERS_PER_BODY)
    inverse = torch.linalg.inv(pseudo_inertia(pi))
    gradient = torch.einsum("bij,kji->bk", prior.inverse_inertia - inverse, BASIS).flatten()
    hessian = torch.block_diag(*divergence_hessian(inverse)) if len(inverse) else z.new_zeros(0, 0)
    return kappa * (S.T @ gradient), kappa * (S.T @ hessian @ S)
