"""The samples as rows of one regression, whitened: joint after joint, in coordinates in which the prior is N(0, 1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_toeplitz

from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis.rows.samples import Samples
from torchrbd.likelihood.noise import Noise
from torchrbd.likelihood.urdf_prior import TERM_WIDTH, Prior, in_proportion

# Coefficients that predict a sample's noise from those before.
ORDER = 4
# A sample of torque is believed to this part of the joint's RMS at best: what is smaller does not matter, and simulated
# torques without noise would make it significant.
LEAST_NOISE = 2e-3
# White floor of the spectrum: what whitening amplifies at most.
_FLOOR = 0.02
MOST_BLOCKS = 64
# No peak of a term's torque is believed beyond so many times the root mean square of its joint's.
PEAK_WIDTH = 3.0

Place = tuple[int | None, str]
"""A column besides the rigid body's: the joint that has it (None: all joints share it), and its label."""

Colour = tuple[np.ndarray, np.ndarray]
"""Noise of joints whatever their samples count: predictors (n, ORDER) and what they leave (n,), [N m] or [N]."""


class Rows:
    """The samples, whitened by a noise model, joint after joint.

    Args:
        samples: the data.
        prior: of the inertial parameters.
        noise: its colour.

    Attributes:
        noises: per joint, the noise of its samples.
        X: (N, P) rigid body, in prior coordinates.
        y: (N,) torque less that of the prior's mean.
        parts: per joint, its slice of the N rows.
        block: (N,) number of the block, of at most MOST_BLOCKS.
        joint: (N,).
        counts: (n,) rows of each joint, by what they count.
    """

    def __init__(self, samples: Samples, prior: Prior, noise: Colour) -> None:
        self.samples, self.prior, self.noise = samples, prior, noise
        n = len(samples.tau)
        self.index = [_with_predecessors(samples, j) for j in range(n)]
        ends = np.cumsum([0, *(len(i) for i in self.index)])
        self.parts = [slice(a, b) for a, b in pairwise(ends.tolist())]
        self.joint = np.repeat(np.arange(n), np.diff(ends))
        self.noises = [joint_noise(*one) for one in zip(self.index, *noise, samples.weight, strict=True)]
        inertial = prior.inertial.numpy()
        self._scale = prior.scale.numpy()[np.ix_(inertial, inertial)]
        self._inertial, mean = inertial, prior.mean.numpy()[: samples.rigid.shape[2]]
        self.X = np.concatenate([self.white(samples.rigid[j][:, inertial].T, j) for j in range(n)], axis=1).T
        self.X = self.X @ self._scale
        self.y = np.concatenate([self.white(samples.tau[j] - samples.rigid[j] @ mean, j) for j in range(n)])
        blocks = _coarse(samples.block)
        self.block = np.concatenate([blocks[i] for i in self.index])
        self._rms = np.sqrt(np.mean(samples.tau**2, axis=1))
        self.counts = np.array([float((samples.weight[j, i] ** 2).sum()) for j, i in enumerate(self.index)])
        self._known: dict[Place, np.ndarray] = {}

    def white(self, x: np.ndarray, joint: int) -> np.ndarray:
        """Return signals (..., M) of a joint as its whitened rows see them, (..., m_j)."""
        return self.noises[joint].white(x * self.samples.weight[joint])

    def white_part(self, x: np.ndarray, joint: int, begin: int) -> tuple[slice, np.ndarray]:
        """Return which of a joint's whitened rows see signals (..., L), zero but at samples from ``begin`` on, and how.

        Those rows are (..., their number).
        """
        noise, end = self.noises[joint], begin + x.shape[-1] + ORDER
        first, last = map(int, np.searchsorted(noise.index, (begin, end)))
        part = replace(noise, index=noise.index[first:last] - begin, spread=noise.spread[begin:end])
        longer = np.zeros((*x.shape[:-1], len(part.spread)))
        longer[..., : x.shape[-1]] = x * self.samples.weight[joint, begin : begin + x.shape[-1]]
        return slice(first, last), part.white(longer)

    def columns(self, candidate: Candidate) -> tuple[list[Place], np.ndarray]:
        """Return places and whitened columns (N, K) of a candidate, in prior coordinates."""
        places: list[Place] = [(candidate.place, label) for label in candidate.labels]
        if not all(p in self._known for p in places):
            features = self.samples.features(candidate)
            found = self.widened(candidate.place, features, candidate.effect.prior.proportions)
            self._known |= dict(zip(places, found.T, strict=True))
        return places, np.stack([self._known[p] for p in places], axis=1)

    def widened(self, place: int | None, features: np.ndarray, std: Sequence[float] = ()) -> np.ndarray:
        """Return features (K, M) of a joint, or (K, n, M) of all, as whitened columns (N, K) in prior coordinates."""
        C = np.zeros((len(self.y), len(features)))
        for j in range(len(self.parts)) if place is None else (place,):
            C[self.parts[j]] = self.white(features[:, j] if place is None else features, j).T
        return C * self.widths(place, features, std)

    def widths_of(self, candidate: Candidate) -> np.ndarray:
        """Return the prior standard deviations of a candidate's coefficients (K,)."""
        return self.widths(candidate.place, self.samples.features(candidate), candidate.effect.prior.proportions)

    def widths(self, place: int | None, features: np.ndarray, std: Sequence[float] = ()) -> np.ndarray:
        """Return the prior standard deviations of the coefficients (K,) of features of a joint, or of all.

        No torque is believed to have a root mean square, or a peak, beyond so many times the root mean square of its
        joint's: what few samples see is bounded by the latter. Coefficients of several units (a mass and its moments)
        keep the proportions ``std`` where given.
        """
        rms = self._rms if place is None else self._rms[place]
        joints = rms > 0
        size = np.maximum(np.sqrt(np.mean(features**2, axis=-1)) / TERM_WIDTH, np.abs(features).max(-1) / PEAK_WIDTH)
        ratio = (size / np.where(joints, rms, 1.0) * joints).reshape(len(features), -1).max(1)
        widths = np.where(ratio > 0, 1.0 / np.maximum(ratio, 1e-300), 0.0)
        return in_proportion(widths, std) if std else widths

    def pi(self, z: np.ndarray) -> np.ndarray:
        """Return the inertial parameters (n_params,) of prior coordinates."""
        pi = self.prior.mean.numpy()[: self.samples.rigid.shape[2]].copy()
        pi[self._inertial] += self._scale @ z
        return pi


def joint_noise(index: np.ndarray, predictor: np.ndarray, sigma: float, weight: np.ndarray) -> Noise:
    """Return the noise of a joint's samples, times their weights w (M,), 0 to 1.

    A sample of weight w is noise and something unknown, 1/w^2 - 1 times the variance c_0 of the noise. So the variance
    of a whitened row of weighted samples, in units of that of an unweighted row, is

        v(k) = sum_il b_i b_l w(k - i) w(k - l) c_|i-l| + c_0 sum_i b_i^2 (1 - w(k - i)^2),   b = (1, -a)

    Where a predecessor counts little, the noise is not predicted, and v > 1.
    """
    noise = Noise(index, predictor, sigma, np.ones_like(weight))
    b, c, lags = np.concatenate(([1.0], -predictor)), noise.correlation, np.arange(len(predictor) + 1)
    w = np.stack([weight[index - i] for i in lags])
    bw = b[:, None] * w
    v = ((c[np.abs(lags[:, None] - lags)] @ bw) * bw).sum(0) + c[0] * b**2 @ (1.0 - w**2)
    noise.spread[index] = np.sqrt(np.maximum(v, 1.0))
    return noise


def predictor(r: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return the predictor (ORDER,) of a residual (M,) from its predecessors, by Yule and Walker's equations."""
    c = np.array([np.mean(r[index] * r[index - i]) for i in range(ORDER + 1)])
    c[0] = (1 + _FLOOR) * max(c[0], np.mean(r[index - ORDER] ** 2), 1e-300)
    return solve_toeplitz(c[:-1], c[1:])


def _with_predecessors(samples: Samples, joint: int) -> np.ndarray:
    k = np.arange(ORDER, len(samples.run))
    seen = samples.measured[joint]
    return k[(samples.run[k] == samples.run[k - ORDER]) & seen[k] & seen[k - ORDER]]


def _coarse(block: np.ndarray) -> np.ndarray:
    """Number blocks anew, neighbours merged so that there are at most MOST_BLOCKS."""
    number = np.unique(block, return_inverse=True)[1]
    return number // int(np.ceil((number.max() + 1) / MOST_BLOCKS))
