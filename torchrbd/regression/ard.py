"""Automatic relevance determination on second moments: every coefficient has a prior width of its own."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_MOST_ITERATIONS, _CONVERGED = 1000, 1e-5
# A prior this much narrower than what the data says leaves less than 1e-4 of a coefficient's least-squares value.
_DEAD = 1e4


@dataclass(frozen=True)
class ARDFit:
    """Posterior of b: ``mean`` (d,) and ``covariance`` (d, d), zero for pruned columns; ``noise`` is var(y | x)."""

    mean: Tensor
    covariance: Tensor
    noise: float
    iterations: int


def ard(G: Tensor, g: Tensor, yy: float, n: float) -> ARDFit:
    """Maximise the evidence of b_i ~ N(0, 1 / alpha_i), y = x'b + N(0, s2) by MacKay's updates.

        cov = (diag(alpha) + N G / s2)^-1,   m = cov N g / s2,   gamma_i = 1 - alpha_i cov_ii
        alpha_i = gamma_i / m_i^2,   s2 = N (y'y - 2 m'g + m'G m) / (N - sum gamma)

    A column whose prior has become ten thousand times as narrow as its data is removed, so that later iterations
    are cheaper. A stationary point of the evidence is reached, not always its maximum.

    Args:
        G: (d, d) second moments of the inputs, X'X / N.
        g: (d,) X'y / N.
        yy: y'y / N.
        n: number of rows N.

    Source: MacKay, "Bayesian interpolation" (1992), eqs. (4.6) and (4.7), one alpha for each coefficient.
    """
    d = len(g)
    if d == 0:
        return ARDFit(g, G, yy, 0)
    scale = G.diagonal().clamp_min(0.0).sqrt()
    live = torch.nonzero(scale > 1e-7 * scale.max().clamp_min(1e-300)).squeeze(1)
    scale = torch.where(scale > 0.0, scale, 1.0)
    H, h = n * G / (scale.unsqueeze(1) * scale), n * g / scale
    s2 = 0.1 * yy
    alpha = torch.full((len(live),), 1.0 / max(yy, 1e-300), dtype=torch.float64)
    mean, iterations = h.new_zeros(d), 0
    covariance = h.new_zeros(d, d)
    for iterations in range(1, _MOST_ITERATIONS + 1):  # noqa: B007
        inner = H[live.unsqueeze(1), live]
        cov = torch.cholesky_inverse(torch.linalg.cholesky(torch.diag(alpha) + inner / s2))
        m = cov @ (h[live] / s2)
        gamma = (1.0 - alpha * cov.diagonal()).clamp(1e-12, 1.0)
        before = mean
        mean = h.new_zeros(d).index_copy(0, live, m)
        covariance = h.new_zeros(d, d)
        covariance[live.unsqueeze(1), live] = cov
        misfit = yy - float(2.0 * (m @ h[live]) - m @ inner @ m) / n
        s2 = max(misfit * n / max(n - float(gamma.sum()), 1.0), 1e-14 * yy)
        if float((mean - before).norm()) <= _CONVERGED * float(mean.norm()):
            break
        alpha = gamma / m.square().clamp_min(1e-300)
        keep = alpha < _DEAD * inner.diagonal() / s2
        live, alpha = live[keep], alpha[keep]
    return ARDFit(mean / scale, covariance / (scale.unsqueeze(1) * scale), s2, iterations)
