"""Compare models on blocks that they have not seen.

Every model (a set of terms, with the inertial parameters re-fitted beside them) is fitted on all folds but one and
judged on that one. With v the left-out mean squared error of a joint and n its independent samples, one model's gain
over another is

    G = sum_j n_j / 2 log(v_j / v'_j) = sum_b d_b,   d_b = sum_j (e_jb - e'_jb) / (2 m_j),   m = (v - v') / log(v / v')

in log-likelihood units: m, the logarithmic mean, spreads the gain over the blocks b. The scatter of the paired
differences d_b is the honest measure of chance: it holds under correlated noise, where counting samples does not.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.inference.data.block_statistics import BlockStatistics
from torchrbd.inference.data.columns import Candidate
from torchrbd.inference.physical.map_fit import LEAST_NOISE, noise_variance, scaled_equations, solve
from torchrbd.inference.physical.prior import Prior

MOST_BLOCKS = 64


@dataclass(frozen=True)
class Gain:
    """How much better one model predicts unseen blocks than another, in log-likelihood units.

    ``total`` summed over blocks; ``std`` its standard error from the scatter over blocks.
    """

    total: float
    std: float

    @property
    def t(self) -> float:
        """Return the gain in standard errors."""
        return self.total / self.std if self.std > 0 else 0.0


class Comparison:
    """Cross-validated errors of models on one set of blocks.

    Args:
        statistics: the blocks; held-out ones must not be among them.
        prior: prior of the inertial parameters and terms.
        folds: number of folds. Runs of neighbouring blocks stay together.
    """

    def __init__(self, statistics: BlockStatistics, prior: Prior, *, folds: int = 8) -> None:
        self.statistics, self.prior = statistics.coarsened(MOST_BLOCKS), prior
        n_blocks = len(self.statistics)
        self.columns = statistics.columns
        run = max(1, n_blocks // (2 * folds))
        self.fold = (torch.arange(n_blocks) // run) % folds
        self._by_fold = [self.statistics.select(self.fold == f) for f in range(folds) if bool((self.fold == f).any())]
        self.set_noise(())

    def free(self, terms: Collection[Candidate], *, rigid: bool = True) -> Tensor:
        """Return the indices in x that a model fits: the inertial parameters, if ``rigid``, and its terms' columns."""
        columns = torch.tensor(sorted({k for c in terms for k in self.columns.of(c)}), dtype=torch.long)
        return torch.cat((self.prior.inertial, columns)) if rigid else columns

    def set_noise(self, terms: Collection[Candidate]) -> None:
        """Weigh the joints by the noise that one model leaves, for all fits until the next call."""
        weights = 1.0 / noise_variance(self.statistics, self.prior, self.free(terms))
        totals = self.statistics.total()
        self._equations = []
        for part in self._by_fold:
            rest = [all_ - own for all_, own in zip(totals, part.total(), strict=True)]
            self._equations.append(scaled_equations(self.prior, rest, self.columns, weights))
        self._all = scaled_equations(self.prior, totals, self.columns, weights)

    def training_loss(self, terms: Collection[Candidate]) -> float:
        """Return the objective of a model fitted on all blocks, less that of the prior mean: -1/2 h' H^-1 h."""
        free = self.free(terms)
        H = self._all.H[free.unsqueeze(1), free] + torch.eye(len(free), dtype=torch.float64)
        h = self._all.h[free]
        return -0.5 * float(
            torch.linalg.solve_triangular(torch.linalg.cholesky(H), h.unsqueeze(1), upper=False).square().sum()
        )

    def fit(self, terms: Collection[Candidate]) -> Tensor:
        """Return x fitted on all blocks."""
        return solve(self.prior, self._all, self.free(terms))

    def std(self, terms: Collection[Candidate]) -> Tensor:
        """Return the Laplace standard deviation of x (n,), fitted on all blocks; zero where x is not free."""
        free = self.free(terms)
        H = self._all.H[free.unsqueeze(1), free] + torch.eye(len(free), dtype=torch.float64)
        S = self.prior.scale[:, free]
        return ((S @ torch.linalg.inv(H)) * S).sum(1).clamp_min(0.0).sqrt()

    def errors(self, terms: Collection[Candidate], *, rigid: bool = True) -> Tensor:
        """Return the left-out squared errors of a model, (B, n_dof) in the order of folds, [(N m)^2] or [N^2].

        Args:
            terms: its terms.
            rigid: whether its inertial parameters are re-fitted or the URDF's.
        """
        free = self.free(terms, rigid=rigid)
        found = []
        for part, equations in zip(self._by_fold, self._equations, strict=True):
            x = solve(self.prior, equations, free) if len(free) else self.prior.reference
            found.append(part.squared_error(x))
        return torch.cat(found)

    def gain(self, before: Tensor, after: Tensor) -> Gain:
        """Return the gain of left-out errors ``after`` over ``before``, both (B, n_dof)."""
        count = self.statistics.torque[..., 0].sum(0)
        seen = count > 0
        least = (LEAST_NOISE**2 * self.statistics.torque[..., 2].sum(0))[seen]
        old, new = before.sum(0)[seen].clamp_min(least), after.sum(0)[seen].clamp_min(least)
        ratio = torch.log(old / new)
        mean = torch.where(ratio.abs() > 1e-6, (old - new) / ratio, old) / count[seen]
        difference = 0.5 * ((before - after)[:, seen] / mean).sum(1)
        return Gain(float(difference.sum()), float(difference.std() * len(difference) ** 0.5))

    def share_left(self, candidate: Candidate, terms: Collection[Candidate]) -> float:
        """Return which part (0 to 1) of a candidate's torque the rest of the model cannot imitate, however free it is.

        The prior is left out: what an inertial parameter of any size can imitate, the data cannot tell from it.
        """
        own = torch.tensor(self.columns.of(candidate))
        rest = self.free(terms)
        rest = rest[~torch.isin(rest, own)]
        H = self._all.H
        inner = H[rest.unsqueeze(1), rest]
        size = inner.diagonal().clamp_min(1e-300).rsqrt()
        balanced = size.unsqueeze(1) * inner * size
        values, vectors = torch.linalg.eigh(balanced)
        kept = values > 1e-12 * values[-1]
        cross = vectors[:, kept].T @ (size.unsqueeze(1) * H[rest.unsqueeze(1), own])
        explained = (cross**2 / values[kept].unsqueeze(1)).sum(0)
        total = H[own, own]
        return float(((total - explained) / total.clamp_min(1e-300)).max())
