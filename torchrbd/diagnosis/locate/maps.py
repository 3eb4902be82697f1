"""Maps of a residual: its RMS over the noise, joint by joint, over time, position and velocity."""

from __future__ import annotations

import numpy as np

from torchrbd.diagnosis.locate.scene import Scene
from torchrbd.diagnosis.results import ResidualMap

BINS, LEAST_SAMPLES = 48, 2


def residual_maps(scene: Scene, left: np.ndarray, noise_std: np.ndarray, model: str) -> tuple[ResidualMap, ...]:
    """Return maps over the time of each recording, and over position and velocity.

    Args:
        scene: the samples.
        left: (n, M) residual of the model, NaN where nothing is measured.
        noise_std: (n,) standard deviation of the residual when all that was located is removed.
        model: its name.
    """
    samples = scene.samples
    level = (left / np.maximum(noise_std, 1e-300)[:, None]) ** 2
    maps = []
    for k in np.unique(samples.recording):
        here = samples.recording == k
        t = np.broadcast_to(samples.t[here], level[:, here].shape)
        maps.append(_map(model, "t", samples.recordings[k], t, level[:, here], scene.dt))
    maps.append(_map(model, "q", "", samples.q, level, 0.0))
    maps.append(_map(model, "qd", "", samples.qd, level, 0.0))
    return tuple(maps)


def _map(model: str, signal: str, recording: str, v: np.ndarray, power: np.ndarray, pad: float) -> ResidualMap:
    edges, levels = [], []
    bins = int(np.clip(v.shape[1] // 6, 4, BINS))
    for x, y in zip(v, power, strict=True):
        low, high = x.min() - pad / 2, x.max() + pad / 2
        edge = np.linspace(low, max(high, low + 1e-9), bins + 1)
        which = np.clip(np.searchsorted(edge, x, side="right") - 1, 0, bins - 1)
        seen = np.isfinite(y)
        count = np.bincount(which[seen], minlength=bins)
        total = np.bincount(which[seen], y[seen], bins)
        mean = np.where(count >= LEAST_SAMPLES, total / np.maximum(count, 1), np.nan)
        edges.append(tuple(edge.tolist()))
        levels.append(tuple(np.sqrt(mean).tolist()))
    return ResidualMap(model, signal, recording, tuple(edges), tuple(levels))
