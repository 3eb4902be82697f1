"""Iteratively reweighted least squares: samples that do not fit count less (Huber's M-estimator)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import assemble, filtered_rows
from torchrbd.display import Remark
from torchrbd.inference.estimators.problem import LinearProblem
from torchrbd.likelihood.equations import bounded

_HUBER, _NORMAL_MAD = 1.345, 0.6745
_MOST_PASSES, _SETTLED = 20, 0.1


def iteratively_reweighted(problem: LinearProblem) -> tuple[Tensor, Remark | None]:
    """Fit by weights that fall with a sample's residual r = tau - Y x.

        w = min(1, 1.345 s_j / |r|) / s_j^2,   s_j = median |r| / 0.6745 of joint j

    Each round streams the recordings once: weights belong to samples, and blocks hold sums. It starts at weighted least
    squares and ends when the fit moves by less than a tenth of a standard deviation.

    Returns:
        x (n,), and what a user should know.

    Source: Huber, "Robust estimation of a location parameter" (1964); Holland, Welsch, "Robust regression using
    iteratively reweighted least-squares" (1977), with the constant of 95 % efficiency.
    """
    x, variance = problem.weighted()
    for passes in range(1, _MOST_PASSES + 1):
        totals, found = _reweighted_pass(problem, x, variance)
        H, _ = assemble(problem.training.columns, totals, 1.0 / variance)
        before, (x, _) = x, problem.least_squares(1.0 / variance, totals)
        moved = float(((x - before) @ H @ (x - before)).clamp_min(0.0).sqrt())
        if passes > 1 and moved < _SETTLED:
            return x, Remark("passes", {"passes": passes, "settled": True})
        variance = found
    return x, Remark("passes", {"passes": _MOST_PASSES, "settled": False})


def _reweighted_pass(problem: LinearProblem, x: Tensor, variance: Tensor) -> tuple[list[Tensor], Tensor]:
    """Return per joint the moments of samples weighted by their residuals at x, and the residuals' variances (n_dof,).

    Args:
        problem: the data.
        x: (n,) coefficients.
        variance: (n_dof,) s_j^2 of the weights.
    """
    columns = problem.training.columns
    sizes = [len(own) + 1 for own in columns.of_joint]
    totals = [torch.zeros(p, p, dtype=torch.float64) for p in sizes]
    sizes_of_residuals: list[list[Tensor]] = [[] for _ in sizes]
    for states, fitted, measured in problem.samples():
        rows, _ = filtered_rows(columns, states)
        weight = problem.prepared.filtering.effective_rate * states.dt_out
        for joint in torch.nonzero(measured).flatten().tolist():
            a = rows[joint][:, fitted]
            size = (a[-1] - x[columns.of_joint[joint]] @ a[:-1]).abs()
            w = weight * (_HUBER * variance[joint].sqrt() / size.clamp_min(1e-300)).clamp_max(1.0)
            totals[joint] += (a * w) @ a.T
            sizes_of_residuals[joint].append(size)
    found = [
        torch.cat(parts).median().div(_NORMAL_MAD).square() if parts else torch.tensor(torch.inf, dtype=torch.float64)
        for parts in sizes_of_residuals
    ]
    return totals, bounded(problem.training, torch.stack(found))
