"""Maps of a leftover: how loud it is where, joint by joint, over the noise."""

from __future__ import annotations

import numpy as np

from torchrbd.diagnosis.locate.residual import Leftover
from torchrbd.diagnosis.results import LeftoverMap

BINS, LEAST_SAMPLES = 48, 2


def leftover_maps(leftover: Leftover, noise: Leftover, model: str) -> tuple[LeftoverMap, ...]:
    """Return maps over the time of each recording, and over position and velocity.

    Args:
        leftover: what the model leaves.
        noise: what is left of that when all that was located is taken away.
        model: its name.
    """
    rows = leftover.rows
    level = (leftover.raw / np.maximum(noise.raw_std, 1e-300)) ** 2
    maps = []
    for k in np.unique(rows.recording):
        here = rows.recording == k
        t = np.repeat(rows.t[here, None], rows.q.shape[1], axis=1)
        maps.append(_map(model, "t", rows.recordings[k], t, level[here], rows.dt))
    maps.append(_map(model, "q", "", rows.q, level, 0.0))
    maps.append(_map(model, "qd", "", rows.qd, level, 0.0))
    return tuple(maps)


def _map(model: str, signal: str, recording: str, v: np.ndarray, power: np.ndarray, pad: float) -> LeftoverMap:
    edges, levels = [], []
    bins = int(np.clip(len(v) // 6, 4, BINS))
    for x, y in zip(v.T, power.T, strict=True):
        low, high = x.min() - pad / 2, x.max() + pad / 2
        edge = np.linspace(low, max(high, low + 1e-9), bins + 1)
        which = np.clip(np.searchsorted(edge, x, side="right") - 1, 0, bins - 1)
        seen = np.isfinite(y)
        count = np.bincount(which[seen], minlength=bins)
        total = np.bincount(which[seen], y[seen], bins)
        mean = np.where(count >= LEAST_SAMPLES, total / np.maximum(count, 1), np.nan)
        edges.append(tuple(edge.tolist()))
        levels.append(tuple(np.sqrt(mean).tolist()))
    return LeftoverMap(model, signal, recording, tuple(edges), tuple(levels))
