"""Edges: the rows at which something begins or ends, and how the innovations jump there.

What begins at once is a step, low-passed and whitened like all rows. A step is unlike coloured noise: the innovations
jump at its edges and are small in between. Features change slowly in comparison. The rows around an edge are therefore
those of a low-passed step times the features:

    G_e = white(F s_e),   s_e = 1 before the edge e, 0 behind it, low-passed between

Source: Tsay, "Outliers, Level Shifts, and Variance Changes in Time Series", Journal of Forecasting 1988 (level shifts
    as innovations see them).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import convolution_matrix

from torchrbd.dataset.rows import Rows
from torchrbd.likelihood.likelihood import Likelihood

# Least number of rows between two edges; less than this of a step is rounding.
_APART, _ROUNDING = 3, 1e-9


@dataclass(frozen=True)
class Edges:
    """Edges of one recording.

    Attributes:
        fit: whose noise whitens.
        rows: of all recordings.
        recording: its name.
    """

    fit: Likelihood
    rows: Rows
    recording: str

    @cached_property
    def inside(self) -> np.ndarray:
        """Which rows are those of the recording, (M,) bool."""
        return self.rows.recording == self.rows.recordings.index(self.recording)

    @cached_property
    def step(self) -> np.ndarray:
        """What a low-passed step has left (2 H + 1,) of one, from H rows before its edge to H rows behind."""
        own = (tile.states for tile in self.rows.tiles if tile.states.recording == self.recording)
        states = max(own, key=lambda one: len(one.t_out))
        k = len(states.t_out) // 2
        passed = states.decimate((states.t < states.t_out[k]).to(states.q)).numpy()
        between = np.flatnonzero(np.abs(passed - (np.arange(len(passed)) < k)) > _ROUNDING)
        reach = 1 + min(np.abs(between - k).max(initial=0), k - 1, len(passed) - k - 2)
        return passed[k - reach : k + reach + 1]

    @property
    def reach(self) -> int:
        """H, rows by which a low-passed step reaches beyond its edge."""
        return len(self.step) // 2

    def at(self, times: np.ndarray) -> np.ndarray:
        """Return the first rows that are not before times [s], of which -inf is before all and inf behind."""
        inside = np.flatnonzero(self.inside)
        return inside[0] + np.searchsorted(self.rows.t[inside], times)

    def apart(self, times: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Return those pairs (N, 2) of times (B,) [s] that no row feels both of."""
        felt = 2 * self.reach + max(len(noise.predictor) for noise in self.fit.hyper.noise)
        return pairs[np.diff(self.at(times)[pairs], axis=1)[:, 0] >= felt]

    def jumps(self, count: int) -> np.ndarray:
        """Return the rows, at most so many, in their order, at which the innovations of all joints jump most.

        z^2 = sum_j (d_j'n_j)^2 / d_j'd_j, with d_j what a step of a constant torque is to the noise of joint j. However
        heavy its tails: what leaps may be a row that errs, or an edge.
        """
        z2 = np.zeros(len(self.rows.t))
        for j, noise in enumerate(self.fit.hyper.noise):
            around = np.pad(self.step, (len(noise.predictor), 0), constant_values=1.0)
            d = np.convolve(around, np.append(1.0, -noise.predictor))[len(noise.predictor) :]
            n, power = np.zeros((2, len(z2)))
            usual = noise.sigma * noise.spread[noise.index]
            n[noise.index], power[noise.index] = self.fit.gaussian.left(j) * noise.size / usual**2, usual**-2.0
            ends = self.reach, len(d) - self.reach - 1
            found, most = (np.correlate(np.pad(x, ends), y) for x, y in ((n, d), (power, d**2)))
            z2 += np.divide(found**2, most, out=np.zeros_like(z2), where=most > 0)
        z2[~self.inside], kept = 0.0, []
        for _ in range(count):
            k = int(z2.argmax())
            if z2[k] <= 0.0:
                break
            kept.append(k)
            z2[max(k - _APART, 0) : k + _APART + 1] = 0.0
        return np.sort(np.array(kept, dtype=int))

    def leap(self, joint: int, F: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the whitened rows around edges of features that end there, and of those that go on.

        Args:
            joint: whose noise whitens.
            F: (K, M) features.
            at: (E,) rows of the edges.

        Returns:
            both (E, K, L), and the numbers (E, L) of the whitened rows; rows that do not count are zero.
        """
        noise = self.fit.hyper.noise[joint]
        order, last = len(noise.predictor), len(self.rows.t) - 1
        # Takes rows, and those before them, to what they cannot predict.
        whitening = convolution_matrix(np.append(1.0, -noise.predictor), 2 * (self.reach + order), mode="valid").T
        step = np.concatenate((np.ones(order), self.step, np.zeros(order)))[: len(whitening)]
        rows = at[:, None] + np.arange(len(step)) - self.reach - order
        here = F[:, np.clip(rows, 0, last)].swapaxes(0, 1)
        number = np.full(last + 1, -1)
        number[noise.index] = np.where(self.inside[noise.index], np.arange(len(noise.index)), -1)
        known = (rows >= 0) & (rows <= last)
        row = np.where(known, number[np.clip(rows, 0, last)], -1)[:, order:]
        precise = np.where(row >= 0, 1.0 / noise.size[row], 0.0)[:, None]
        return (here * step) @ whitening * precise, here @ whitening * precise, np.maximum(row, 0)
