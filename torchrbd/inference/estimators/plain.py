"""Plain regressions on a robot: its moments as those of one regression with unit noise, and back.

    (tau_j - Y_j x0) / s_j = (Y_b,j / s_j) beta + unit noise

The rows of all joints form one regression; s_j is the residual's standard deviation by weighted least squares. Columns
have unit mean square, so that methods that depend on scale treat all alike; 0 is the URDF. Blocks of time are the folds
of cross-validation.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchrbd.display import Remark
from torchrbd.inference.estimators.problem import LinearProblem
from torchrbd.regression.base import Regression
from torchrbd.regression.moments import Moments

_MOST_FOLDS = 10


def regress(problem: LinearProblem, regression: Callable[[], Regression]) -> tuple[Tensor, Remark | None]:
    """Fit beta by a regression; return x (n,), and what a user should know."""
    _, variance = problem.weighted()
    return _fit(problem, robot_moments(problem, 1.0 / variance), regression())


def regress_on_noisy_inputs(
    problem: LinearProblem, regression: Callable[[Tensor], Regression]
) -> tuple[Tensor, Remark | None]:
    """Fit beta by a regression that knows how noisy its inputs are.

    Position noise makes noise dY of the columns, as ``input_noise`` found by sending it through the chain. dY is in
    tau - Y x0 too: their moment is off by -E[dY'W dY] x0, which is taken out first, as errors-in-variables regressions
    expect.

    Args:
        problem: the data.
        regression: makes the regression from the noise covariance (d, d) of its inputs, in columns of unit mean square.

    Returns:
        x (n,), and what a user should know.
    """
    _, variance = problem.weighted()
    moments = robot_moments(problem, 1.0 / variance)
    noise = _noise(problem, 1.0 / variance) / moments.n
    blocks = moments.blocks.clone()
    blocks[:, :-1, -1] -= moments.count.unsqueeze(1) * noise[:-1, -1]
    blocks[:, -1, :-1] -= moments.count.unsqueeze(1) * noise[:-1, -1]
    scale = moments.xx.diagonal().sqrt()
    inputs = noise[:-1, :-1] / (scale.unsqueeze(1) * scale)
    return _fit(problem, Moments(blocks, moments.count), regression(inputs))


def robot_moments(problem: LinearProblem, weights: Tensor) -> Moments:
    """Return the moments of [Y_b, tau - Y x0] with the rows of joint j weighted by ``weights`` (n_dof,), 1 / s_j^2."""
    statistics, d = problem.training.coarsened(_MOST_FOLDS), len(problem.chosen)
    blocks = torch.zeros(len(statistics), d + 1, d + 1, dtype=torch.float64)
    for own, moments, weight in zip(statistics.columns.of_joint, statistics.moments, weights, strict=True):
        T = torch.cat((_deviations(problem, own), torch.zeros(1, d + 1, dtype=torch.float64)))
        T[-1, -1] = 1.0
        blocks += weight * (T.T @ moments @ T)
    return Moments(blocks, (statistics.torque[..., 0] * (weights > 0.0)).sum(1))


def _fit(problem: LinearProblem, moments: Moments, regression: Regression) -> tuple[Tensor, Remark | None]:
    scale = moments.xx.diagonal().sqrt()
    b = regression.fit(moments.transform(torch.diag(scale.reciprocal()))).coefficients.detach()
    zeros = int((b == 0.0).sum())
    remark = Remark("combinations of the URDF", {"kept": zeros, "of": len(b)}) if zeros else None
    return problem.reference + problem.lift @ (b / scale), remark


def _noise(problem: LinearProblem, weights: Tensor) -> Tensor:
    """Return what noise in the states adds to the moments of [Y_b, tau - Y x0]: (d + 1, d + 1)."""
    own_columns, gram = problem.training.columns.of_joint, problem.prepared.input_noise.columns_gram
    parts = (_deviations(problem, own) for own in own_columns)
    return torch.stack([w * (T.T @ G @ T) for w, T, G in zip(weights, parts, gram, strict=True)]).sum(0)


def _deviations(problem: LinearProblem, own: Tensor) -> Tensor:
    """Return T (p_j, d + 1) with [Y_b, -Y x0] = Y_j T, for columns ``own`` (p_j,) of x."""
    T = (own.unsqueeze(1) == problem.chosen).double()
    return torch.cat((T, -problem.reference[own].unsqueeze(1)), 1)
