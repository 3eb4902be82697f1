"""How far single blocks move a fit: the delete-one-block jackknife, for intervals that hold under coloured noise too.

    d_b = (P - H_b)^-1 s_b,   s_b = sum_j A_jb (tau - x) / sigma_j^2,   P = sum_b H_b + prior curvature
    v = (B - 1)/B sum_b (g'd_b - mean)^2 + g'P^-1 (P - sum_b H_b) P^-1 g

-d_b is the step from the fit to all blocks to the fit to all but b. A block that alone identifies a parameter pulls the
fit to itself, so that its own error s_b is too small; leaving out H_b corrects that. The steps estimate the variance of
g'x as well as nu blocks of equal weight would, 1/nu = sum_b p_b^2 with p_b the part of the information on g'x that
block b has. Few blocks estimate it badly, so that what the fit assumed, u, counts as two more:

    var(g'x) = (2 u + (nu - 1) v) / (nu + 1)

and the interval is Student's with nu + 1 degrees of freedom, given here as the variance of a normal one as wide.

Sources: MacKinnon, White, "Some heteroskedasticity-consistent covariance matrix estimators with improved finite sample
properties", J. Econometrics 1985 (the jackknife); Bell, McCaffrey, "Bias reduction in standard errors for linear
regression with multi-stage samples", Survey Methodology 2002 (degrees of freedom); Smyth, "Linear models and empirical
Bayes methods for assessing differential expression", 2004, sect. 3 (the moderated t; prior freedom fixed here).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from scipy.stats import norm, t
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics, assemble

_INTERVAL = 0.975
_ASSUMED_BLOCKS = 2.0


@dataclass(frozen=True)
class Scatter:
    """The blocks' pulls on F fitted coefficients.

    Attributes:
        statistics: the B blocks.
        weights: (n_dof,) inverse noise variances.
        free: (F,) indices of the coefficients in x.
        laplace: P^-1 (F, F).
        information: sum_b H_b (F, F).
        steps: d_b (B, F), their mean taken off.
    """

    statistics: BlockStatistics
    weights: Tensor
    free: Tensor
    laplace: Tensor
    information: Tensor
    steps: Tensor

    def variance(self, g: Tensor, assumed: float) -> float:
        """Return the variance of g'x, for a normal interval as wide as Student's.

        Args:
            g: (F,).
            assumed: u, what the fit takes it for.
        """
        n_blocks, a = len(self.steps), self.laplace @ g
        scattered = (n_blocks - 1) / n_blocks * float((self.steps @ g).square().sum())
        believed = max(float(g @ a - a @ self.information @ a), 0.0)
        blocks = self.effective_blocks(g)
        freedom = _ASSUMED_BLOCKS + blocks - 1.0
        pooled = (_ASSUMED_BLOCKS * assumed + (blocks - 1.0) * (scattered + believed)) / freedom
        return pooled * float(t.ppf(_INTERVAL, freedom) / norm.ppf(_INTERVAL)) ** 2

    def with_coefficients(self, index: Tensor, covariance: Tensor) -> Scatter:
        """Return the same with coefficients fitted to what these leave, whose own scatter is not known.

        Args:
            index: (K,) where they stand in x.
            covariance: (K, K) of them.
        """
        nothing = torch.zeros_like(covariance)
        return replace(
            self,
            free=torch.cat((self.free, index)),
            laplace=torch.block_diag(self.laplace, covariance),
            information=torch.block_diag(self.information, nothing),
            steps=torch.cat((self.steps, self.steps.new_zeros(len(self.steps), len(index))), 1),
        )

    def effective_blocks(self, g: Tensor) -> float:
        """Return nu: the number of blocks of equal weight with as even an information on g'x."""
        at = torch.nonzero(g).flatten()
        variances = (self._block_covariances[:, at][:, :, at] @ g[at]) @ g[at]
        power = float(variances.square().sum())
        return float(variances.sum()) ** 2 / power if power > 0.0 else 1.0

    @cached_property
    def _block_covariances(self) -> Tensor:
        """P^-1 H_b P^-1, (B, F, F)."""
        found = self.laplace.new_zeros(len(self.statistics), *self.laplace.shape)
        for b, own in enumerate(_information(self.statistics, self.weights, self.free)):
            torch.matmul(self.laplace @ own, self.laplace, out=found[b])
        return found


def _information(statistics: BlockStatistics, weights: Tensor, free: Tensor) -> Iterator[Tensor]:
    """Yield the information of each block on some coefficients (F,), H_b (F, F)."""
    for b in range(len(statistics)):
        H, _ = assemble(statistics.columns, [m[b] for m in statistics.moments], weights)
        yield H[free.unsqueeze(1), free]


def block_scatter(
    statistics: BlockStatistics, x: Tensor, free: Tensor, laplace: Tensor, noise_variance: Tensor
) -> Scatter:
    """Return what each block does to a fit.

    Args:
        statistics: the blocks that were fitted.
        x: (n,) fitted coefficients.
        free: (F,) indices of those that were free.
        laplace: (F, F) their covariance by the curvature, P^-1.
        noise_variance: (n_dof,) of the torques.
    """
    weights = 1.0 / noise_variance
    # In units of the standard deviations, since coefficients differ by orders of magnitude.
    # One that moves no joint has none.
    size = laplace.diagonal().sqrt()
    size = torch.where(size > 0, size, torch.ones_like(size))
    correlation = laplace / size / size.unsqueeze(1)
    information, steps = torch.zeros_like(laplace), []
    pulls = statistics.scores(x, weights)[:, free] * size
    for own, pull in zip(_information(statistics, weights, free), pulls, strict=True):
        information += own
        left = torch.eye(len(free), dtype=torch.float64) - (own * size * size.unsqueeze(1)) @ correlation
        steps.append(size * (correlation @ torch.linalg.solve(left, pull)))
    found = torch.stack(steps) if steps else torch.zeros(0, len(free), dtype=torch.float64)
    return Scatter(statistics, weights, free, laplace, information, found - found.mean(0))
