"""What a fitted model still leaves: is it more than noise, and what does it depend on?

Noise depends on nothing. A learner without any physics (gradient-boosted trees on position, velocity and acceleration
of all joints) is trained on the residual of some blocks and judged on the others: what it predicts there is missing
physics, named or not. What it depends on is told by shuffling one signal at a time and seeing the prediction fail.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor

from torchrbd.diagnosis.results import Region, Unexplained, Where
from torchrbd.diagnosis.select import LEAST_GAIN, LEAST_T
from torchrbd.diagnosis.words import joined, number, percent
from torchrbd.inference.results import TorqueSeries

FOLDS, BLOCK_S = 8, 1.0
# Reported if this part of the leftover is predicted, and it is this part of the joint's torque variance.
LEAST_SHARE, LEAST_TORQUE_PART = 0.05, 1e-4
# A signal is named if shuffling it destroys this part of the prediction; at most so many.
LEAST_IMPORTANCE, MOST_SIGNALS = 0.2, 3
_BINS = 12


@dataclass(frozen=True)
class Prediction:
    """The left-out prediction of a residual.

    ``values`` (M,); ``share`` of the residual's power that it predicts; ``gain`` in log-likelihood units and its
    ``t`` over blocks; ``importance`` per signal, the part of the prediction that is lost without it.
    """

    values: np.ndarray
    share: float
    gain: float
    t: float
    importance: np.ndarray


def unexplained(
    series: TorqueSeries, model: str, independent_rate_hz: float, units: Sequence[str], *, seed: int = 0
) -> tuple[Unexplained, ...]:
    """Find what is left at each joint and depends on something.

    Args:
        series: torques of all recordings; held-out samples are not looked at.
        model: whose residual.
        independent_rate_hz: independent samples a second, 2 f_c.
        units: per joint, of its torque.
        seed: of the shuffling.
    """
    signals = [f"{prefix}_{joint}" for prefix in ("q", "qd", "qdd") for joint in series.joints]
    X = np.concatenate((series.q, series.qd, series.qdd), axis=1)
    found = []
    for j, joint in enumerate(series.joints):
        seen = ~series.held_out & np.isfinite(series.measured[:, j])
        if not seen.any():
            continue
        t, recording, r, tau = (
            series.t[seen],
            series.recording[seen],
            series.residual(model)[seen, j],
            series.measured[seen, j],
        )
        n_independent = _independent_samples(t, independent_rate_hz)
        prediction = predict_left_out(X[seen], r, _blocks(t, recording), n_independent, seed)
        power = float(np.mean(r**2))
        told = prediction.gain > LEAST_GAIN and prediction.t > LEAST_T and prediction.share > LEAST_SHARE
        if told and prediction.share * power > LEAST_TORQUE_PART * np.var(tau):
            where = _loud_recordings(series, recording, r)
            found.append(_described(joint, signals, X[seen], prediction, power**0.5, units[j], where))
    return tuple(found)


def predict_left_out(
    X: np.ndarray, r: np.ndarray, block: np.ndarray, n_independent: float, seed: int = 0
) -> Prediction:
    """Predict a residual from signals, each fold of blocks from the others.

    Args:
        X: (M, K) signals.
        r: (M,) residual.
        block: (M,) number of the block that a sample belongs to; runs of two stay together.
        n_independent: independent samples among the M.
        seed: of the shuffling.
    """
    rng = np.random.default_rng(seed)
    fold = (block // 2) % FOLDS
    values, spoiled = np.zeros_like(r), np.zeros((X.shape[1], len(r)))
    for f in np.unique(fold):
        own = fold == f
        learner = HistGradientBoostingRegressor(max_iter=60, learning_rate=0.1, max_leaf_nodes=15, random_state=seed)
        learner.fit(X[~own], r[~own])
        values[own] = learner.predict(X[own])
        for k in range(X.shape[1]):
            shuffled = X[own].copy()
            shuffled[:, k] = rng.permutation(shuffled[:, k])
            spoiled[k, own] = learner.predict(shuffled)
    before, after = r**2, (r - values) ** 2
    old, new = float(before.mean()), float(after.mean())
    gain = 0.5 * n_independent * float(np.log(old / new)) if new > 0 else 0.0
    per_block = np.bincount(block, before - after)
    spread = float(per_block.std(ddof=1)) * len(per_block) ** 0.5
    lost = np.mean((r - spoiled) ** 2, axis=1) - new
    importance = lost / (old - new) if old > new else np.zeros(X.shape[1])
    return Prediction(values, 1.0 - new / old, gain, float(per_block.sum()) / spread if spread else 0.0, importance)


def _independent_samples(t: np.ndarray, rate_hz: float) -> float:
    steps = np.diff(t)
    return rate_hz * len(t) * float(np.median(steps[steps > 0]))


def _blocks(t: np.ndarray, recording: np.ndarray) -> np.ndarray:
    """Number stretches of BLOCK_S of each recording, (M,)."""
    raw = np.stack((recording, np.floor(t / BLOCK_S).astype(recording.dtype)), axis=1)
    return np.unique(raw, axis=0, return_inverse=True)[1].ravel()


def _described(
    joint: str,
    signals: Sequence[str],
    X: np.ndarray,
    prediction: Prediction,
    rms: float,
    unit: str,
    loud: tuple[str, ...] | None,
) -> Unexplained:
    ranked: list[int] = np.argsort(-prediction.importance)[:MOST_SIGNALS].tolist()
    named = [k for k in ranked if prediction.importance[k] > LEAST_IMPORTANCE] or ranked[:1]
    low, high = _strongest_interval(X[:, named[0]], prediction.values)
    depends_on = tuple(signals[k] for k in named)
    statement = (
        f"{joint}: an RMS of {number(rms)} {unit} is left that no known effect explains. "
        f"{percent(prediction.share)} of its power can be predicted, from {joined(depends_on)}, "
        f"most of it where {depends_on[0]} is between {number(low)} and {number(high)}"
    )
    statement += f", in {joined(loud)}." if loud else "."
    where = Where(recordings=loud, region=(Region(depends_on[0], low, high),))
    return Unexplained((joint,), depends_on, where, float(prediction.share), statement)


def _strongest_interval(v: np.ndarray, predicted: np.ndarray) -> tuple[float, float]:
    """Return the interval of v around the strongest prediction, over which its power stays above half of the peak's."""
    edges = np.unique(np.quantile(v, np.linspace(0.0, 1.0, _BINS + 1)))
    inside = np.clip(np.searchsorted(edges, v, side="right") - 1, 0, len(edges) - 2)
    power = np.bincount(inside, predicted**2, len(edges) - 1) / np.maximum(
        np.bincount(inside, minlength=len(edges) - 1), 1
    )
    low = high = int(power.argmax())
    while low > 0 and power[low - 1] > 0.5 * power.max():
        low -= 1
    while high < len(power) - 1 and power[high + 1] > 0.5 * power.max():
        high += 1
    return float(edges[low]), float(edges[high + 1])


def _loud_recordings(series: TorqueSeries, recording: np.ndarray, r: np.ndarray) -> tuple[str, ...] | None:
    """Return the recordings that hold the leftover, or None if it is in all of them alike."""
    present = np.unique(recording)
    power = np.array([np.mean(r[recording == k] ** 2) for k in present])
    loud = power > 0.25 * power.max()
    return (
        None if loud.all() else tuple(series.recordings[k] for k, is_loud in zip(present, loud, strict=True) if is_loud)
    )
