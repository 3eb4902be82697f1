"""Fits without some blocks of time, in closed form: what cross-validation takes.

A fold f of the blocks adds H_f = A_f'W A_f to the precision of a fit, C^-1, and the score g_f = A_f'W (tau_f - A_f x)
to a gradient that is zero in total. Without the fold, the fit is about one Newton step away:

    x_f = x - (C^-1 - H_f)^-1 g_f = x - (1 - C H_f)^-1 C g_f

C^-1 includes the curvature of the prior and of the inertias' barrier. The objective is quadratic except for that
barrier and for coefficients that cannot be negative. The fit is repeated without the fold where a step makes one of
these negative, or changes a body too much: |J^-1/2 dJ J^-1/2| > 1/2 for the pseudo-inertia J of a body.

Source: Cook, Weisberg, "Residuals and Influence in Regression" (1982), ch. 2; Beirami, Razaviyayn, Shahrampour, Tarokh,
    "On Optimal Generalizability in Parametric Learning", NeurIPS 2017, for penalties that are not quadratic.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics, assemble
from torchrbd.dataset.resting import without_columns_at_rest
from torchrbd.inference.physical.fitting import FittedModel, fit_model, not_negative, positive_columns
from torchrbd.inference.preparation import Prepared
from torchrbd.parameters import PARAMETERS_PER_BODY
from torchrbd.robot import pseudo_inertia

FOLDS = 8
# Longest step of a body that is short against the barrier.
_SHORT = 0.5


def left_out_fits(model: FittedModel, prepared: Prepared, fold: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield the blocks of each fold, (B,) bool, and the coefficients (n,) of the fit without them.

    Args:
        model: fitted to all blocks.
        prepared: the data.
        fold: (B,) number of each fitted block's fold; a block below zero is never left out.
    """
    training, noise = prepared.training, model.noise_variance
    for f in fold[fold >= 0].unique():
        x = _without(model, training, fold == f)
        if not (_has_signs(x, model) and _is_near(x, model)):
            x = fit_model(training.select(fold != f), prepared.prior, model.terms, noise, prepared.states).x
        yield fold == f, x


def _without(model: FittedModel, training: BlockStatistics, gone: Tensor) -> Tensor:
    """Return the coefficients (n,) without some blocks, gone (B,) bool, one Newton step from the fit."""
    columns, at, C = training.columns, model.free, model.laplace
    H, h = assemble(columns, without_columns_at_rest(training.select(gone)).total(), 1.0 / model.noise_variance)
    score, ones = (h - H @ model.x)[at], torch.eye(len(at), dtype=torch.float64)
    return model.x.index_add(0, at, -torch.linalg.solve(ones - C @ H[at.unsqueeze(1), at], C @ score))


def _has_signs(x: Tensor, model: FittedModel) -> bool:
    """Return whether all sign-constrained coefficients of x (n,) are zero or more."""
    signs = not_negative(model.columns, model.terms)
    return bool((signs @ x >= 0.0).all()) and bool((x[positive_columns(model.columns, model.terms)] >= 0.0).all())


def _is_near(x: Tensor, model: FittedModel) -> bool:
    """Say whether no body of x (n,) is so far from the fit's that the barrier is not quadratic."""
    n = model.columns.robot.n_params
    J, after = (pseudo_inertia(pi[:n].reshape(-1, PARAMETERS_PER_BODY)) for pi in (model.x, x))
    moved = (after != J).any((-2, -1))
    relative = torch.linalg.solve(J[moved], (after - J)[moved])
    return bool(((relative @ relative).diagonal(dim1=-2, dim2=-1).sum(-1) < _SHORT**2).all())


def contiguous_folds(n: int, most: int) -> Tensor:
    """Return numbers (n,) of at most ``most`` folds of neighbouring blocks of about equal size."""
    return torch.arange(n) * min(most, n) // max(n, 1)
