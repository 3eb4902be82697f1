"""What a fitted model still leaves: is it more than noise, and what does it depend on?

The residual of each joint is regressed on smooth functions of one variable after another (position, velocity, acceleration of
any joint) and judged on blocks left out. Noise depends on nothing; what predicts unseen residual is missing physics, named or not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchrbd.diagnosis.compare import Gain
from torchrbd.diagnosis.results import Region, Unexplained, Where
from torchrbd.inference.results import TorqueSeries

KNOTS, FOLDS, BLOCK_S = 10, 8, 1.0
LEAST_GAIN, LEAST_T = 12.5, 2.5
# Reported if this part of the leftover is predicted, and it is this part of the joint's torque variance.
LEAST_SHARE, LEAST_TORQUE_PART = 0.05, 1e-4
MOST_VARIABLES = 3


@dataclass(frozen=True)
class Dependence:
    """The residual's smooth dependence on one variable: knots (K,), curve there (K,), and the left-out gain."""

    signal: str
    knots: np.ndarray
    curve: np.ndarray
    gain: Gain


def hat_functions(v: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return piecewise linear basis functions (M, K), one at each knot; they sum to one, and are constant outside."""
    return np.stack([np.interp(v, knots, row) for row in np.eye(len(knots))], axis=1)


def unexplained(series: TorqueSeries, model: str, independent_rate_hz: float, units: Sequence[str]) -> tuple[Unexplained, ...]:
    """Find what is left at each joint and depends on something.

    Args:
        series: torques of all recordings; held-out samples are not looked at.
        model: whose residual.
        independent_rate_hz: independent samples a second, 2 f_c.
        units: per joint, of its torque.
    """
    seen = ~series.held_out
    t, recording = series.t[seen], series.recording[seen]
    variables = _variables(series, seen)
    block = _blocks(t, recording)
    steps = np.diff(t)
    weight = independent_rate_hz * float(np.median(steps[steps > 0]))
    found = []
    for j, joint in enumerate(series.joints):
        r, tau = series.residual(model)[seen, j], series.measured[seen, j]
        if np.isnan(r).any():
            continue
        chosen = _dependences(r, variables, block, weight)
        if not chosen:
            continue
        predicted = _left_out_prediction(r, [variables[d.signal] for d in chosen], block)
        share = 1.0 - np.mean((r - predicted) ** 2) / np.mean(r**2)
        if share < LEAST_SHARE or share * np.mean(r**2) < LEAST_TORQUE_PART * np.var(tau):
            continue
        found.append(_described(series, joint, chosen, share, float(np.sqrt(np.mean(r**2))), units[j], recording, r))
    return tuple(found)


def _variables(series: TorqueSeries, seen: np.ndarray) -> dict[str, np.ndarray]:
    found = {}
    for prefix, values in (("q", series.q), ("qd", series.qd), ("qdd", series.qdd)):
        for k, joint in enumerate(series.joints):
            found[f"{prefix}_{joint}"] = values[seen, k]
    return found


def _blocks(t: np.ndarray, recording: np.ndarray) -> np.ndarray:
    """Number stretches of BLOCK_S of each recording, (M,)."""
    raw = recording.astype(np.int64) * 10_000_000 + np.floor(t / BLOCK_S).astype(np.int64)
    return np.unique(raw, return_inverse=True)[1]


def _knots(v: np.ndarray) -> np.ndarray:
    return np.unique(np.quantile(v, np.linspace(0.01, 0.99, KNOTS)))


def _left_out_prediction(r: np.ndarray, variables: Sequence[np.ndarray], block: np.ndarray) -> np.ndarray:
    """Predict the residual (M,) by an additive smooth model, each fold from the others."""
    X = np.concatenate([hat_functions(v, _knots(v)) for v in variables], axis=1)
    fold = (block // 2) % FOLDS
    ridge = 1e-3 * len(r) / X.shape[1] * np.eye(X.shape[1])
    G, g = X.T @ X, X.T @ r
    predicted = np.zeros_like(r)
    for f in np.unique(fold):
        own = fold == f
        w = np.linalg.solve(G - X[own].T @ X[own] + ridge, g - X[own].T @ r[own])
        predicted[own] = X[own] @ w
    return predicted


def _dependences(r: np.ndarray, variables: dict[str, np.ndarray], block: np.ndarray, weight: float) -> list[Dependence]:
    """Choose variables one after another while each predicts left-out blocks better."""
    chosen: list[Dependence] = []
    moving = {name: v for name, v in variables.items() if len(_knots(v)) > 3}
    current = np.zeros_like(r)
    while len(chosen) < MOST_VARIABLES:
        variance = np.mean((r - current) ** 2)
        options = []
        for name in moving.keys() - {d.signal for d in chosen}:
            predicted = _left_out_prediction(r, [moving[d.signal] for d in chosen] + [moving[name]], block)
            difference = 0.5 * weight / variance * ((r - current) ** 2 - (r - predicted) ** 2)
            per_block = np.bincount(block, difference)
            gained = Gain(float(per_block.sum()), float(per_block.std(ddof=1) * len(per_block) ** 0.5))
            options.append((gained.total, name, gained, predicted))
        if not options:
            break
        _, name, gained, predicted = max(options, key=lambda option: option[:2])
        if gained.total < LEAST_GAIN or gained.t < LEAST_T:
            break
        knots = _knots(moving[name])
        X = hat_functions(moving[name], knots)
        curve = np.linalg.lstsq(X, r - current, rcond=None)[0]
        chosen.append(Dependence(name, knots, curve, gained))
        current = predicted
    return chosen


def _described(
    series: TorqueSeries, joint: str, chosen: list[Dependence], share: float, rms: float, unit: str, recording: np.ndarray, r: np.ndarray
) -> Unexplained:  # fmt: skip
    first = chosen[0]
    low, high = _strongest_interval(first)
    loud = _loud_recordings(series, recording, r)
    names = ", ".join(d.signal for d in chosen)
    prefix = first.signal.split("_")[0]
    words = {"q": "position", "qd": "velocity", "qdd": "acceleration"}[prefix]
    statement = (
        f"At joint {joint} an RMS of {rms:.3g} {unit} is left that none of the known effects explains; {100 * share:.0f} % of its power "
        f"depends on {names}, most for a {words} {first.signal} between {low:.3g} and {high:.3g}."
    )
    where = Where(recordings=loud, region=(Region(first.signal, low, high),))
    return Unexplained((joint,), tuple(d.signal for d in chosen), where, float(share), statement)


def _strongest_interval(d: Dependence) -> tuple[float, float]:
    """Return the interval around the curve's largest value in which it stays above half of it."""
    size = np.abs(d.curve - np.median(d.curve))
    peak = int(size.argmax())
    low = high = peak
    while low > 0 and size[low - 1] > 0.5 * size[peak]:
        low -= 1
    while high < len(size) - 1 and size[high + 1] > 0.5 * size[peak]:
        high += 1
    # A single knot stands for the ground up to its neighbours.
    return float(d.knots[max(low - (low == high), 0)]), float(d.knots[min(high + (low == high), len(size) - 1)])


def _loud_recordings(series: TorqueSeries, recording: np.ndarray, r: np.ndarray) -> tuple[str, ...] | None:
    """Return the recordings that hold the leftover, or None if it is in all of them alike."""
    present = np.unique(recording)
    power = np.array([np.mean(r[recording == k] ** 2) for k in present])
    loud = power > 0.25 * power.max()
    return None if loud.all() else tuple(series.recordings[k] for k, is_loud in zip(present, loud, strict=True) if is_loud)
