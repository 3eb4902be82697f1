"""The linear problem that every estimator solves: identifiable combinations of coefficients, and their lift.

    tau - Y x0 = Y_b beta + noise,   beta = K dx,   x = x0 + dx

with x0 the URDF's coefficients and Y_b independent columns of the regressor: Y = Y_b K. A fit finds beta; dx is then
the least change of the URDF, in the metric of the prior, that has these beta.

Source: Gautier, "Numerical calculation of the base inertial parameters of robots", ICRA 1990; Swevers, Verdonck, De
Schutter, "Dynamic model identification for industrial robots", IEEE Control Systems 2007, for the weights.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics, assemble
from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.resting import without_columns_at_rest
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.shapes.grid import columns_of
from torchrbd.likelihood.equations import first_noise_variance, with_noise
from torchrbd.likelihood.gaussian import Posterior
from torchrbd.recordings import States

# Of a column's square. Right angles written as 1.5708 make columns that depend on each other up to 4e-6 differ.
_DEPENDENT = 1e-10
# Of the largest: what is below it is rounding.
_EFFECT = 1e-12
_MOST_ROUNDS, _SETTLED = 10, 1e-6


@dataclass(frozen=True)
class LinearProblem:
    """The fitted blocks as one linear problem.

    Attributes:
        prepared: the data.
        training: blocks to fit.
        terms: the free terms besides the rigid body.
        free: indices in x of the fitted columns.
        chosen: (d,) indices in x of the independent ones among them, Y_b.
        lift: (n, d) with dx = lift beta.
        condition: singular values of the joint-weighted Y_b with columns of unit length, largest over smallest.
    """

    prepared: Prepared
    training: BlockStatistics
    terms: tuple[Candidate, ...]
    free: Tensor
    chosen: Tensor
    lift: Tensor
    condition: float

    @property
    def reference(self) -> Tensor:
        """The URDF's x0 (n,), unphysical bodies replaced by near physical ones."""
        return self.prepared.prior.mean

    @property
    def free_terms(self) -> Tensor:
        """Those of ``free`` that belong to terms."""
        return self.free[self.free >= self.prepared.robot.n_params]

    def least_squares(self, weights: Tensor, totals: Sequence[Tensor] | None = None) -> tuple[Tensor, Tensor]:
        """Return x (n,) and its covariance (n, n) for joints weighted by ``weights`` (n_dof,), 1 / variance.

        Args:
            weights: of the joints.
            totals: per joint, moments (p_j + 1, p_j + 1); those of the fitted blocks if not given.
        """
        totals = self.training.total() if totals is None else totals
        H, h = assemble(self.training.columns, totals, weights)
        b = self.chosen
        found = Posterior(H[b][:, b].numpy(), (h - H @ self.reference)[b].numpy())
        half = torch.from_numpy(found.half(self.lift.T.numpy()))
        return self.reference + self.lift @ torch.from_numpy(found.z), half.T @ half

    def weighted(self) -> tuple[Tensor, Tensor]:
        """Return x (n,) of weighted least squares and the joints' residual variances (n_dof,) that weigh it."""

        def fit(variance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            x, covariance = self.least_squares(1.0 / variance)
            return x, x, covariance

        return with_noise(self.training, fit, rounds=_MOST_ROUNDS, tolerance=_SETTLED)

    def information(self) -> Tensor:
        """Return the information of the fitted blocks on x, by the weights of weighted least squares, (n, n)."""
        _, variance = self.weighted()
        return assemble(self.training.columns, self.training.total(), 1.0 / variance)[0]

    def samples(self) -> Iterator[tuple[States, Tensor, Tensor]]:
        """Stream tiles of the fitted recordings: states, which outputs (M,) are fitted, which joints (n_dof,) count."""
        prepared = self.prepared
        for k, recording in enumerate(prepared.recordings):
            spans = [(b.start_s, b.end_s) for b in self.training.blocks if b.recording == recording.name]
            if not spans:
                continue
            start, end = torch.tensor(spans, dtype=torch.float64).T
            for states in prepared.tiles(k):
                t = states.t_out.unsqueeze(1)
                yield states, ((t >= start) & (t <= end)).any(1), prepared.measured(k)


def linear_problem(prepared: Prepared, terms: Sequence[Candidate] = ()) -> LinearProblem:
    """Return the linear problem of a robot's inertial parameters and terms.

    Args:
        prepared: the data.
        terms: effects that are fitted with the inertial parameters.
    """
    columns, prior, training = prepared.columns, prepared.prior, without_columns_at_rest(prepared.training)
    free = columns_of(prepared, terms)
    H, _ = assemble(columns, training.total(), 1.0 / first_noise_variance(training))
    H = H[free][:, free]
    # Information of a column in units of the prior: that of a parameter without effect is rounding, not exactly zero.
    seen = H.diagonal() * prior.scale[free].square().sum(1)
    length = torch.where(seen > _EFFECT * seen.max(), H.diagonal(), torch.inf).sqrt()
    G = H / (length.unsqueeze(1) * length)
    (pivoted_cholesky,) = scipy.linalg.get_lapack_funcs(("pstrf",), (G.numpy(),))
    _, pivots, rank, _ = pivoted_cholesky(G.numpy(), tol=_DEPENDENT)
    picked = torch.from_numpy(np.sort(pivots[:rank] - 1)).long()
    G_b = G[picked][:, picked]
    # An infinite length marks a column without effect: it has no part in any beta.
    K = torch.linalg.solve(G_b, G[picked]) * length[picked].reciprocal().unsqueeze(1)
    K = torch.where(length.isinf(), 0.0, K * length)
    # The shortest z with K S z = beta, by QR of (K S)': R'Q'z = beta.
    Q, R = torch.linalg.qr((K @ prior.scale[free][:, free]).T)
    lift = prior.scale[:, free] @ torch.linalg.solve_triangular(R.T, Q, upper=False, left=False)
    stiffness = torch.linalg.eigvalsh(G_b)
    condition = float((stiffness[-1] / stiffness[0].clamp_min(1e-300)).sqrt())
    return LinearProblem(prepared, training, tuple(terms), free, free[picked], lift, condition)
