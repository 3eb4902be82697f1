"""The physically valid fit: convex in pi, with the entropic prior as its barrier.

    minimise  1/2 x'Hx - h'x + kappa sum_bodies [tr(J0^-1 J) - logdet J]

An interior-point method. Beside every pseudo-inertia J there is a dual matrix Z, and at the solution J Z = kappa 1. The
Newton steps are taken in the coordinates R in which both are the same diagonal matrix, J = R s R', Z = R^-T s R^-1
(Nesterov and Todd's scaling): there the barrier's curvature is 1 wherever the path is, so that steps remain long near
the boundary. The factors of J and Z are updated by products, so that no nearly singular matrix is ever factorised.

Source: Lee, Wensing, Park (T-RO 2020), eq. (31); Todd, Toh, Tutuncu, "On the Nesterov-Todd direction in semidefinite
programming", SIAM J. Optimization 1998; Mehrotra, SIAM J. Optimization 1992 (the choice of mu, without the corrector).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.likelihood.equations import Equations
from torchrbd.likelihood.urdf_prior import Prior, orthonormal_steps
from torchrbd.parameters import ORTHONORMAL, PARAMETERS_PER_BODY, is_physical
from torchrbd.robot import from_pseudo_inertia

_MOST_STEPS, _INTERIOR, _SHORT, _EXACT, _NO_PROGRESS = 100, 0.9, 1e-2, 1e-12, 0.25
# Moments are exact to about 1e-16 of the largest: of anything stiffer, rounding would decide the weak directions.
_STIFFEST = 1e13
_ONE = torch.eye(4, dtype=torch.float64)


@dataclass(frozen=True)
class PhysicalFit:
    """Coefficients with a positive definite pseudo-inertia for every fitted body, and the precision of z there.

    ``x`` (n,); ``free`` indices of the fitted ones; ``precision`` (n_free, n_free) is the Hessian of the objective in
    prior coordinates; ``steps`` Newton steps taken; ``converged`` says whether the last one was short.
    """

    x: Tensor
    free: Tensor
    precision: Tensor
    steps: int
    converged: bool


@dataclass(frozen=True)
class Problem:
    """The objective 1/2 z'Az - h'z + kappa sum [tr G - logdet G], G = 1 + sum_k z_k B_k / sqrt(kappa), J = L0 G L0'.

    Terms follow the bodies in z; their prior is part of A.
    """

    A: Tensor
    h: Tensor
    kappa: float
    n_bodies: int

    @property
    def n_inertial(self) -> int:
        return PARAMETERS_PER_BODY * self.n_bodies

    def columns(self, R: Tensor) -> Tensor:
        """Return the blocks K (n_bodies, 10, 10) of P = diag(K, 1) with dz = P y for dG = R (sum_k y_k B_k) R'."""
        moved = torch.einsum("bik,qkl,bjl->bqij", R, ORTHONORMAL, R)
        return self.kappa**0.5 * torch.einsum("pij,bqij->bpq", ORTHONORMAL, moved)

    def times(self, K: Tensor, X: Tensor) -> Tensor:
        """Return diag(K, 1) X for X (n, k)."""
        bodies = X[: self.n_inertial].unflatten(0, (self.n_bodies, PARAMETERS_PER_BODY))
        return torch.cat(((K @ bodies).flatten(0, 1), X[self.n_inertial :]))

    def step(self, K: Tensor, R: Tensor, z: Tensor, inverse: Tensor, mu: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the Newton matrix N, for each mu (k,) the negative gradient (n, k), and the step y (n, k).

        The gradient is that of the objective with the barrier -mu logdet G; ``inverse`` = R' G^-1 R (n_bodies, 4, 4).
        """
        down = -self.times(K.mT, (self.A @ z - self.h).unsqueeze(1)).squeeze(1)
        down[: self.n_inertial] -= self.kappa * torch.einsum("bki,bkj,qij->bq", R, R, ORTHONORMAL).flatten()
        centre = torch.zeros_like(down)
        centre[: self.n_inertial] = torch.einsum("bij,qij->bq", inverse, ORTHONORMAL).flatten()
        N = self.times(K.mT, self.times(K.mT, self.A).T)
        N = 0.5 * (N + N.T)
        N.diagonal()[: self.n_inertial] += 1.0
        down = down.unsqueeze(1) + centre.unsqueeze(1) * mu
        return N, down, torch.cholesky_solve(down, _factor(N))

    def symmetric(self, y: Tensor) -> Tensor:
        """Return sum_k y_k B_k (n_bodies, 4, 4)."""
        return torch.einsum("bk,kij->bij", y[: self.n_inertial].reshape(-1, PARAMETERS_PER_BODY), ORTHONORMAL)


def physical_fit(prior: Prior, equations: Equations, terms: Tensor) -> PhysicalFit:
    """Fit inertial parameters and terms.

    Equations stiffer than 1e13 prior precisions are weakened to that.

    Args:
        prior: prior; its kappa is the weight of the divergence.
        equations: normal equations in prior coordinates.
        terms: indices of the columns of the free terms.
    """
    free = torch.cat((prior.inertial, terms))
    L0 = torch.linalg.cholesky(torch.linalg.inv(prior.inverse_inertia))
    turn = _turn(prior, L0, len(terms))
    A = turn.T @ equations.H[free.unsqueeze(1), free] @ turn
    trust = min(1.0, _STIFFEST / max(float(A.diagonal().max()), 1.0)) if len(free) else 1.0
    A, h = trust * A, trust * (turn.T @ equations.h[free])
    A.diagonal()[len(prior.inertial) :] += 1.0
    problem = Problem(A, h, prior.kappa, len(prior.bodies))
    z, L, steps, converged = follow_path(problem)
    K = problem.columns(L)
    N, *_ = problem.step(K, L, z, _ONE.expand_as(L), torch.zeros(1, dtype=torch.float64))
    N.diagonal()[: problem.n_inertial] += prior.kappa - 1.0
    into = problem.times(torch.linalg.inv(K), torch.linalg.inv(turn))
    precision = into.T @ N @ into
    x = prior.mean + prior.scale[:, free] @ (turn @ z)
    x[prior.inertial] = _representable(x[prior.inertial].reshape(-1, PARAMETERS_PER_BODY), L0 @ L, L0).flatten()
    return PhysicalFit(x, free, 0.5 * (precision + precision.T), steps, converged)


def _turn(prior: Prior, L0: Tensor, n_terms: int) -> Tensor:
    """Return Q (n_free, n_free) from z of ``Problem`` to the prior's; orthogonal if both mean the same kappa."""
    S = prior.scale[prior.inertial][:, prior.inertial]
    own = orthonormal_steps(L0) / prior.kappa**0.5
    return torch.block_diag(torch.linalg.solve(S, own), torch.eye(n_terms, dtype=S.dtype))


def follow_path(problem: Problem) -> tuple[Tensor, Tensor, int, bool]:
    """Return z, the factor L of G = L L', the steps taken, and whether the last one was short."""
    kappa, z = problem.kappa, torch.zeros_like(problem.h)
    L = _ONE.expand(problem.n_bodies, 4, 4).clone()
    M = max(kappa, kappa**0.5 * float(problem.h.abs().max()) if len(z) else 0.0) ** 0.5 * L
    before = math.inf
    for steps in range(1, _MOST_STEPS + 1):
        U, s, Vh = torch.linalg.svd(M.mT @ L)
        R, dual = L @ Vh.mT / s.sqrt().unsqueeze(-2), M @ U / s.sqrt().unsqueeze(-2)
        K, diagonal = problem.columns(R), torch.diag_embed(s)
        # Aim at mu = 0 first: how far that gets says how far down mu may go.
        _, down, y = problem.step(K, R, z, torch.diag_embed(1.0 / s), torch.tensor([0.0, 1.0], dtype=torch.float64))
        dX = problem.symmetric(y[:, 0])
        reach = min(1.0, _room(s, dX), _room(s, -diagonal - dX))
        mu = max(kappa, (1.0 - reach) ** 3 * float(s.square().mean())) if len(s) else kappa
        y, down = y[:, 0] + mu * (y[:, 1] - y[:, 0]), down[:, 0] + mu * (down[:, 1] - down[:, 0])
        dX = problem.symmetric(y)
        dZ = torch.diag_embed(mu / s - s) - dX
        length = min(1.0, _INTERIOR * _room(s, dX), _INTERIOR * _room(s, dZ))
        decrement = float(down @ y) / kappa
        if not math.isfinite(decrement) or not length > 0.0:
            return z, L, steps, False
        if mu == kappa and length == 1.0 and (decrement < _EXACT or _NO_PROGRESS * before < decrement < _SHORT):
            return z, L, steps, True
        before = decrement
        z = z + length * problem.times(K, y.unsqueeze(1)).squeeze(1)
        L, M = R @ torch.linalg.cholesky(diagonal + length * dX), dual @ torch.linalg.cholesky(diagonal + length * dZ)
    return z, L, _MOST_STEPS, False


def _room(s: Tensor, step: Tensor) -> float:
    """Return how many of a step (n_bodies, 4, 4) keep diag(s) + step positive semidefinite; NaN if it is not finite."""
    if not bool(torch.isfinite(step).all()):
        return math.nan
    w = s.rsqrt()
    least = torch.linalg.eigvalsh(w.unsqueeze(-1) * step * w.unsqueeze(-2))[..., 0]
    return -1.0 / float(least.min()) if bool((least < 0).any()) else math.inf


def _factor(N: Tensor) -> Tensor:
    """Return the Cholesky factor of N, its diagonal raised by as little as rounding makes necessary."""
    jitter, d = 0.0, N.diagonal().sqrt()
    N, one = N / d / d.unsqueeze(1), torch.eye(len(N), dtype=N.dtype)
    while True:
        factor, info = torch.linalg.cholesky_ex(N + jitter * one)
        if int(info) == 0 or jitter > 1.0:
            return d.unsqueeze(1) * factor
        jitter = max(10.0 * jitter, 1e-15)


def _representable(pi: Tensor, factor: Tensor, factor0: Tensor) -> Tensor:
    """Return bodies (n, 10) that are physical in floating point too.

    Close to the boundary the sign of an eigenvalue is lost to rounding; there, as little as possible of the prior's
    body is added.

    Args:
        pi: (n, 10), physical but for rounding.
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
