"""What a leftover may depend on: smooth functions of one signal each, weighed by their evidence.

A function g(v) phi, piecewise linear in a signal v with weights w ~ N(0, theta), has on the whitened leftover, with
g_i and V the eigenvalues and vectors of its Gram matrix and z = V'u,

    log evidence = 1/2 sum_i [theta z_i^2 / (1 + theta g_i) - log(1 + theta g_i)],   the largest over theta

It counts its own freedom: with nothing to find, theta and the evidence go to zero.
Source: MacKay, "Bayesian interpolation", Neural Computation 1992.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from torchrbd.diagnosis.locate.residual import Leftover
from torchrbd.diagnosis.locate.rows import Rows

# A direction of which less than this is left beside the fit is the fit's.
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

    def columns(self, rows: Rows, joint: int) -> np.ndarray:
        """Return the basis of g(v) phi, (M, K)."""
        B = waves(rows, self.v) if self.name == "t" else hats(self.v, self.knots)
        phi = form_columns(rows, joint, self.form)
        return (B[:, :, None] * phi[:, None, :]).reshape(len(B), -1)


@dataclass(frozen=True)
class Smooth:
    """The best smooth function of a signal: ``gain`` is its log evidence; (v, mean, std) is the function at its knots.

    ``columns`` (M, K) are the directions of it that the data tells.
    """

    signal: Signal
    gain: float
    columns: np.ndarray
    knots: np.ndarray
    mean: np.ndarray
    std: np.ndarray


def hats(v: np.ndarray, knots: int) -> np.ndarray:
    """Return piecewise linear functions with as many samples between two knots as between others, (M, K)."""
    at = knots_of(v, knots)
    i = np.clip(np.searchsorted(at, v, side="right") - 1, 0, max(len(at) - 2, 0))
    B = np.zeros((len(v), len(at)))
    if len(at) > 1:
        part = (v - at[i]) / (at[i + 1] - at[i])
        B[np.arange(len(v)), i], B[np.arange(len(v)), i + 1] = 1 - part, part
    return B


def knots_of(v: np.ndarray, knots: int) -> np.ndarray:
    """Return the knots of ``hats``."""
    return np.unique(np.quantile(v, np.linspace(0, 1, knots)))


def waves(rows: Rows, t: np.ndarray) -> np.ndarray:
    """Return slow cosines of time, those of each recording apart, (M, K)."""
    parts, present = [], np.unique(rows.recording)
    count = max(1, min(WAVES, MOST_WAVES // len(present)))
    for k in present:
        here = rows.recording == k
        length = max(np.ptp(t[here]), 1e-9)
        phase = np.pi * (t - t[here].min())[:, None] / length * np.arange(1, count + 1)
        parts.append(np.cos(phase) * here[:, None])
    return np.concatenate(parts, axis=1)


def form_columns(rows: Rows, joint: int, form: str) -> np.ndarray:
    """Return what multiplies a function of a signal, (M, K)."""
    if form == "level":
        return np.ones((len(rows.t), 1))
    if form == "friction":
        return rows.direction[:, [joint]]
    held = rows.held[joint, :, rows.last_body(joint), :, 2]
    return held[:, np.abs(held).max(0) > 0]


def signals(rows: Rows, joint: int) -> Iterator[Signal]:
    """Yield what the leftover of a joint may depend on."""
    names, j = rows.robot.joint_names, joint
    for form in ("level", "friction"):
        yield Signal(f"q_{names[j]}", form, rows.q[:, j])
        yield Signal(f"load_{names[j]}", form, rows.load[:, j])
        for i, name in enumerate(names):
            if i != j:
                yield Signal(f"q_{name}", form, rows.q[:, i])
                if form == "level":
                    yield Signal(f"q_{name}", form, rows.q[:, i], FEW_KNOTS)
                if form == "level":
                    yield Signal(f"qd_{name}", form, rows.qd[:, i])
        yield Signal("t", form, rows.t)
    yield Signal(f"q_{names[j]}", "level", rows.q[:, j], FINE_KNOTS)
    yield Signal(f"q_{names[j]}", "level", rows.q[:, j], FEW_KNOTS)
    yield Signal(f"qd_{names[j]}", "level", rows.qd[:, j])
    yield Signal(f"qdd_{names[j]}", "level", rows.qdd[:, j])
    yield Signal(f"load_rate_{names[j]}", "level", rows.load_rate[:, j], 2)
    if form_columns(rows, joint, "load").shape[1]:
        yield Signal("t", "load", rows.t)


def smooth(leftover: Leftover, joint: int, signal: Signal) -> Smooth:
    """Fit the function of a signal that has the largest evidence."""
    B = signal.columns(leftover.rows, joint)
    G, alone, u = leftover.equations({joint: leftover.white(joint, B)})
    size = np.sqrt(np.maximum(alone.diagonal(), 1e-300))
    g, V = np.linalg.eigh(G / size / size[:, None])
    free = g > LEAST_SHARE
    g, V = g[free], V[:, free]
    z = V.T @ (u / size)
    theta = _THETA[:, None]
    evidence = 0.5 * (theta * z**2 / (1 + theta * g) - np.log1p(theta * g)).sum(1)
    best = int(evidence.argmax())
    told = _THETA[best] * g > 1.0
    prior = _THETA[best] / (1 + _THETA[best] * g)
    T = V / size[:, None]
    w, std = T @ (prior * z), np.sqrt((T**2 * prior).sum(1))
    return Smooth(signal, max(0.0, float(evidence[best])), B @ T[:, told], knots_of(signal.v, signal.knots), w, std)
