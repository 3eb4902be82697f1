"""Fits without some blocks, one Newton step away, are the fits that are repeated without them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from inference.problems import columns_of, prior_of, recorded, statistics_of
from simulated import Motion
from torch import Tensor

from torchrbd.inference.physical import leave_out
from torchrbd.inference.physical.fitting import FittedModel, fit_model, term_candidates
from torchrbd.inference.physical.leave_out import contiguous_folds, left_out_fits

FRICTION = ("viscous_friction", "coulomb_friction")


def rubbed(m: Motion) -> np.ndarray:
    return 0.6 * m.qd + 1.0 * np.tanh(m.qd / 0.05)


def problem(seed: int, terms: tuple[str, ...], **options: Any) -> tuple[FittedModel, Any]:
    robot, recording = recorded(seed, **{"extra": rubbed if terms else None, **options})
    columns = columns_of(robot)
    prepared = SimpleNamespace(training=statistics_of(columns, recording), prior=prior_of(columns), states=None)
    return fit_model(prepared.training, prepared.prior, term_candidates(columns, terms)), prepared


def repeated(model: FittedModel, prepared: Any, kept: Tensor) -> Tensor:
    """Return the coefficients (n,) of a fit to the blocks that are kept."""
    training = prepared.training.select(kept)
    return fit_model(training, prepared.prior, model.terms, model.noise_variance).x


@pytest.mark.parametrize("terms", [(), FRICTION], ids=["bodies", "friction"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_step_away_is_the_fit_without_the_fold(seed: int, terms: tuple[str, ...]) -> None:
    model, prepared = problem(seed, terms)
    training, fold = prepared.training, contiguous_folds(len(prepared.training), 4)
    found = list(left_out_fits(model, prepared, fold))
    assert len(found) == 4
    for f, (out, x) in enumerate(found):
        assert torch.equal(out, fold == f)
        expected = training.select(out).squared_error(repeated(model, prepared, ~out)).sum(0)
        told = training.select(out).squared_error(x).sum(0)
        torch.testing.assert_close(told, expected, rtol=1e-3, atol=0)
        # Leaving the fold out matters: a hundred times more than the step is off.
        before = training.select(out).squared_error(model.x).sum(0)
        weighed = 1.0 / model.noise_variance
        assert abs((told - expected) @ weighed) < 0.01 * (expected - before) @ weighed


def test_a_body_that_moves_too_far_is_fitted_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three blocks of four are most of what is known."""
    model, prepared = problem(1, FRICTION, duration_s=6.0)
    fold = torch.tensor([0, 0, 0, -1])
    ((out, x),) = left_out_fits(model, prepared, fold)
    error = prepared.training.select(out).squared_error
    expected = repeated(model, prepared, ~out)
    torch.testing.assert_close(x, expected, rtol=1e-9, atol=1e-12)
    monkeypatch.setattr(leave_out, "_is_near", lambda *_: True)
    ((_, step),) = left_out_fits(model, prepared, fold)
    assert ((error(step).sum(0) / error(expected).sum(0) - 1.0).abs() > 0.1).any()


def test_a_coefficient_that_would_be_negative_is_fitted_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no friction, half of the steps make it negative."""
    model, prepared = problem(1, FRICTION, extra=None)
    fold, friction = contiguous_folds(len(prepared.training), 4), slice(model.columns.robot.n_params, None)
    found = [x for _, x in left_out_fits(model, prepared, fold)]
    monkeypatch.setattr(leave_out, "_has_signs", lambda *_: True)
    steps = [x for _, x in left_out_fits(model, prepared, fold)]
    negative = [bool((x[friction] < 0).any()) for x in steps]
    assert any(negative)
    for f, (x, step) in enumerate(zip(found, steps, strict=True)):
        assert (x[friction] >= 0).all()
        expected = repeated(model, prepared, fold != f) if negative[f] else step
        torch.testing.assert_close(x, expected, rtol=1e-9, atol=1e-12)


def test_blocks_below_zero_are_never_left_out() -> None:
    model, prepared = problem(1, FRICTION)
    n = len(prepared.training)
    fold = torch.full((n,), -1)
    fold[2:6] = torch.tensor([0, 0, 5, 5])
    found = list(left_out_fits(model, prepared, fold))
    assert [torch.nonzero(out)[:, 0].tolist() for out, _ in found] == [[2, 3], [4, 5]]
    for out, x in found:
        error = prepared.training.select(out).squared_error
        expected = error(repeated(model, prepared, ~out))
        torch.testing.assert_close(error(x), expected, rtol=1e-3, atol=0)
    assert list(left_out_fits(model, prepared, torch.full((n,), -1))) == []


@pytest.mark.parametrize(("n", "most", "folds"), [(16, 8, 8), (21, 8, 8), (5, 8, 5), (8, 8, 8), (1, 8, 1), (0, 8, 0)])
def test_folds_are_neighbours_and_alike_in_size(n: int, most: int, folds: int) -> None:
    found = contiguous_folds(n, most)
    assert len(found) == n
    assert found.unique().tolist() == list(range(folds))
    assert (found.diff() >= 0).all()
    sizes = found.unique(return_counts=True)[1]
    assert not n or int(sizes.max() - sizes.min()) <= 1
