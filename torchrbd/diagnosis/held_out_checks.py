"""What an extended model is worth on torque that no fit has seen, and what memory its errors keep.

Blocks of time are drawn again (a paired bootstrap): neighbouring samples err alike, blocks hardly do. White noise below
a cut-off f forgets itself within 1 / (2 f), unexplained physics does not.

Source: Efron, Tibshirani, "An Introduction to the Bootstrap", 1993, ch. 8 (blocks), ch. 13 (percentiles); Sokal, "Monte
    Carlo Methods in Statistical Mechanics", 1997, eq. 2.16 for the integrated autocorrelation time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from scipy.stats import bootstrap
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.results import HeldOutCheck, Ratio
from torchrbd.inference.physical.fitting import FittedModel, nmse_weights
from torchrbd.inference.results import TorqueSeries

EXTENDED = "extended"
BLOCK_S, LEAST_BLOCKS, _RESAMPLES, _LONGEST_S = 1.0, 4, 2000, 2.0
# Standard deviations of an interval of 95 %.
_CERTAIN = 1.96


def held_out_checks(series: TorqueSeries, cutoff_hz: float, seed: int = 0) -> tuple[HeldOutCheck, ...]:
    """Return for each joint with held-out torque what the extended model is worth there.

    Args:
        series: with the predictions of "extended" and of the models to compare it with.
        cutoff_hz: of the torques.
        seed: of the bootstrap.
    """
    found = []
    for j, joint in enumerate(series.joints):
        kept = series.held_out & np.isfinite(series.measured[:, j])
        if not kept.any():
            continue
        block = np.stack((series.recording[kept], np.floor(series.t[kept] / BLOCK_S)), 1)
        number = np.unique(block, axis=0, return_inverse=True)[1].ravel()
        errors = {m: series.residual(m)[kept, j] for m in series.predicted}
        sums = {m: np.bincount(number, e**2) for m, e in errors.items()}
        if len(sums[EXTENDED]) < LEAST_BLOCKS:
            continue
        memory = {m: _memory(series, kept, e) for m, e in errors.items()}
        over = {m: over_blocks(sums[EXTENDED], s, seed) for m, s in sums.items() if m != EXTENDED}
        found.append(HeldOutCheck(joint, over, memory, 0.5 / cutoff_hz))
    return tuple(found)


def held_out_ratio(
    judging: BlockStatistics, model: FittedModel, without: Tensor, joints: Sequence[int] | None = None
) -> Ratio | None:
    """Return the part of the torque that a model adds to another one that held-out blocks show: a calibration slope.

        slope = sum_b r_b'd_b / sum_b d_b'd_b

    with d what it adds, and r what the other leaves of the measured torque. It is one where that is as it was found,
    zero where nothing of it is there; below a half, predictions without it are better. Its interval is that of a
    bootstrap over blocks, and of how sure the fit is: d = A (x - x'), so that the slope errs by d'A (x - x*) / d'd.

    Source: Mincer and Zarnowitz, "The Evaluation of Economic Forecasts", NBER 1969 (regression of outcomes on
        forecasts); Cox, "Two Further Applications of a Model for Binary Regression", Biometrika 1958.

    Args:
        judging: blocks that no fit has seen.
        model: what is judged.
        without: coefficients (n,) of the other.
        joints: whose torque counts, in parts of its variance; all if not given.

    Returns:
        None where blocks are few, or hold too little of it.
    """
    weights, x = nmse_weights(judging, joints), model.x
    left, added = ((each @ weights).numpy() for each in judging.added(x, without))
    error = float((judging.squared_error(x) @ weights).sum())
    if len(added) < LEAST_BLOCKS or not added.sum() > DECISIONS.no_change * error:
        return None
    slope, pull = over_blocks(left, added), torch.zeros_like(x)
    for own, moments, weight in zip(judging.columns.of_joint, judging.total(), weights, strict=True):
        pull[own] += weight * moments[:-1, :-1] @ (x - without)[own]
    fit = float((pull[model.free] @ model.covariance @ pull[model.free]).clamp_min(0.0).sqrt()) / float(added.sum())
    down, up = (math.hypot(end - slope.value, _CERTAIN * fit) for end in (slope.low, slope.high))
    return Ratio(slope.value, slope.value - down, slope.value + up)


def over_blocks(after: np.ndarray, before: np.ndarray, seed: int = 0) -> Ratio:
    """Return sum(after) / sum(before) over blocks (B,), with its interval of 95 %, without end where there are few."""
    if len(after) < LEAST_BLOCKS:
        return Ratio(float(after.sum() / max(before.sum(), 1e-300)), 0.0, np.inf)

    def ratio(a: np.ndarray, b: np.ndarray, axis: int = -1) -> np.ndarray:
        return a.sum(axis) / np.maximum(b.sum(axis), 1e-300)

    drawn = bootstrap(
        (after, before), ratio, paired=True, vectorized=True, n_resamples=_RESAMPLES, method="percentile", rng=seed
    ).confidence_interval
    return Ratio(float(ratio(after, before)), float(drawn.low), float(drawn.high))


def _memory(series: TorqueSeries, kept: np.ndarray, e: np.ndarray) -> float:
    """Return the integrated autocorrelation time [s] of errors at the samples kept, up to where they are unlike."""
    runs = list(_runs(series, np.flatnonzero(kept), e - e.mean()))
    step = float(np.median(np.concatenate([np.diff(t) for t, _ in runs]))) if runs else 0.0
    power = sum(float(x @ x) for _, x in runs)
    total = 0.5
    for lag in range(1, int(_LONGEST_S / step) if step > 0 else 1):
        rho = sum(float(x[lag:] @ x[:-lag]) for _, x in runs if len(x) > lag) / max(power, 1e-300)
        if rho <= 0:
            break
        total += rho
    return 2.0 * total * step


def _runs(series: TorqueSeries, index: np.ndarray, e: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield times and errors of uninterrupted runs of samples."""
    t, recording = series.t[index], series.recording[index]
    step = np.diff(t)
    usual = np.median(step[step > 0]) if (step > 0).any() else 0.0
    ends = np.flatnonzero((np.diff(recording) != 0) | (step > 1.5 * usual) | (step <= 0)) + 1
    for times, values in zip(np.split(t, ends), np.split(e, ends), strict=True):
        if len(times) > 1:
            yield times, values
