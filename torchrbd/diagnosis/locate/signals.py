"""What a residual may depend on: smooth functions of one signal each, weighed by their evidence.

A function g(v) phi, piecewise linear in a signal v with weights w ~ N(0, theta), has on the whitened residual, with
g_i and V the eigenvalues and vectors of its Gram matrix and z = V'u,

    log evidence = 1/2 sum_i [theta z_i^2 / (1 + theta g_i) - log(1 + theta g_i)],   the largest over theta

It counts its own freedom: with nothing to find, theta and the evidence go to zero.
Source: MacKay, "Bayesian interpolation", Neural Computation 1992.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from torchrbd.diagnosis.locate.scene import Scene
from torchrbd.diagnosis.rows.regression import Fit

# A direction of which less than this is left given the fit belongs to the fit.
LEAST_SHARE = 1e-4
KNOTS, FINE_KNOTS, FEW_KNOTS, WAVES, MOST_WAVES = 12, 40, 3, 8, 32
_THETA = np.geomspace(1e-4, 1e6, 41)


@dataclass(frozen=True)
class Signal:
    """A signal at a joint.

    Attributes:
        name: e.g. "q_joint2", "t".
        form: what g(v) multiplies: "level" (one), "friction" (sign(qd)), "load" (what a load on the last link takes).
        v: (M,).
        knots: of g; cosines instead for time.
    """

    name: str
    form: str
    v: np.ndarray
    knots: int = KNOTS

    def columns(self, scene: Scene, joint: int) -> np.ndarray:
        """Return the basis of g(v) phi, (K, M)."""
        B = waves(scene) if self.name == "t" else hats(self.v, self.knots)
        return (B[:, None] * form_columns(scene, joint, self.form)).reshape(-1, len(self.v))


@dataclass(frozen=True)
class Smooth:
    """The best smooth function of a signal: ``gain`` is its log evidence; (v, mean, std) is the function at its knots.

    ``columns`` (K, M) are its directions that the data identifies.
    """

    signal: Signal
    gain: float
    columns: np.ndarray
    knots: np.ndarray
    mean: np.ndarray
    std: np.ndarray


def hats(v: np.ndarray, knots: int) -> np.ndarray:
    """Return piecewise linear functions with as many samples between two knots as between others, (K, M)."""
    at = knots_of(v, knots)
    return np.stack([np.interp(v, at, one) for one in np.eye(len(at))])


def knots_of(v: np.ndarray, knots: int) -> np.ndarray:
    """Return the knots of ``hats``."""
    return np.unique(np.quantile(v, np.linspace(0, 1, knots)))


def waves(scene: Scene) -> np.ndarray:
    """Return slow cosines of time, those of each recording apart, (K, M)."""
    t, recording = scene.samples.t, scene.samples.recording
    parts, present = [], np.unique(recording)
    count = max(1, min(WAVES, MOST_WAVES // len(present)))
    for k in present:
        here = recording == k
        length = max(np.ptp(t[here]), 1e-9)
        phase = np.pi * (t - t[here].min()) / length * np.arange(1, count + 1)[:, None]
        parts.append(np.cos(phase) * here)
    return np.concatenate(parts)


def form_columns(scene: Scene, joint: int, form: str) -> np.ndarray:
    """Return what multiplies a function of a signal, (K, M)."""
    if form == "level":
        return np.ones((1, len(scene.samples.t)))
    if form == "friction":
        return scene.samples.direction[[joint]]
    held = scene.held[scene.last_body(joint), joint, :, 2]
    return held[np.abs(held).max(1) > 0]


def signals(scene: Scene, joint: int) -> Iterator[Signal]:
    """Yield signals and bases on which the residual of a joint may depend."""
    names, j, samples = scene.robot.joint_names, joint, scene.samples
    for form in ("level", "friction"):
        yield Signal(f"q_{names[j]}", form, samples.q[j])
        yield Signal(f"tau_{names[j]}", form, scene.load[j])
        for i, name in enumerate(names):
            if i != j:
                yield Signal(f"q_{name}", form, samples.q[i])
                if form == "level":
                    yield Signal(f"q_{name}", form, samples.q[i], FEW_KNOTS)
                    yield Signal(f"qd_{name}", form, samples.qd[i])
        yield Signal("t", form, samples.t)
    yield Signal(f"q_{names[j]}", "level", samples.q[j], FINE_KNOTS)
    yield Signal(f"q_{names[j]}", "level", samples.q[j], FEW_KNOTS)
    yield Signal(f"qd_{names[j]}", "level", samples.qd[j])
    # Both ways alike.
    yield Signal(f"qd_{names[j]}", "friction", np.abs(samples.qd[j]), FEW_KNOTS + 1)
    yield Signal(f"qdd_{names[j]}", "level", samples.qdd[j])
    yield Signal(f"tau_rate_{names[j]}", "level", scene.load_rate[j], 2)
    if form_columns(scene, joint, "load").shape[0]:
        yield Signal("t", "load", samples.t)


class Bases:
    """The bases of all signals that a joint's residual may depend on, stacked, so that one product serves them all.

    Args:
        scene: the samples.
        joint: the joint.
    """

    def __init__(self, scene: Scene, joint: int) -> None:
        self.joint, self.signals = joint, tuple(signals(scene, joint))
        parts = [s.columns(scene, joint) for s in self.signals]
        ends = np.cumsum([0, *map(len, parts)])
        self._slices = [slice(a, b) for a, b in pairwise(ends.tolist())]
        self._features = np.concatenate(parts)

    def smooths(self, fit: Fit) -> Iterator[Smooth]:
        """Yield the best function of each signal."""
        G, alone, u = fit.equations({self.joint: self._features})
        for signal, at in zip(self.signals, self._slices, strict=True):
            yield _smooth(signal, self._features[at], G[at, at], alone.diagonal()[at], u[at])


def smooth(fit: Fit, scene: Scene, joint: int, signal: Signal) -> Smooth:
    """Fit the function of a signal that has the largest evidence."""
    B = signal.columns(scene, joint)
    G, alone, u = fit.equations({joint: B})
    return _smooth(signal, B, G, alone.diagonal(), u)


def _smooth(signal: Signal, B: np.ndarray, G: np.ndarray, alone: np.ndarray, u: np.ndarray) -> Smooth:
    size = np.sqrt(np.maximum(alone, 1e-300))
    g, V = np.linalg.eigh(G / size / size[:, None])
    free = g > LEAST_SHARE
    g, V = g[free], V[:, free]
    z = V.T @ (u / size)
    theta = _THETA[:, None]
    evidence = 0.5 * (theta * z**2 / (1 + theta * g) - np.log1p(theta * g)).sum(1)
    best = int(evidence.argmax())
    significant = _THETA[best] * g > 1.0
    prior = _THETA[best] / (1 + _THETA[best] * g)
    T = V / size[:, None]
    w, std = T @ (prior * z), np.sqrt((T**2 * prior).sum(1))
    gain = max(0.0, float(evidence[best]))
    return Smooth(signal, gain, T[:, significant].T @ B, knots_of(signal.v, signal.knots), w, std)
