"""Estimate spectra of motion and noise in one pass, and choose the cut-off from them."""

from __future__ import annotations

import math

import numpy as np

from torchrbd.recordings.blocks import Block

LOWEST_HZ = 0.5
HIGHEST_SHARE = 0.2
_WINDOW_S = 4.0
_LONGEST_WINDOW = 32768
_SHORTEST_WINDOW = 16
_VELOCITY_LAG_S = 0.05
_NOISE_BAND, _SMOOTHED_BAND = (0.3, 0.45), (0.03, 0.1)
_BANDS = 80
_VALLEY_RISE = 1.4
_HARMONICS = 10.0
_NOISE_PART = 1e-4
_REACHES = 12.8
_LAG_TOLERANCE = 0.005
_QUIETER = 0.25
# Safety factor on the noise, which is known only to some tenths.
_NOISE_MARGIN = 1.2
# Power below this part of the largest is rounding. Torques were filtered if that begins below this part of the band.
_SILENT, _SILENT_FROM = 1e-8, 0.5
# Noise within the motion's band is estimated just above it, below this frequency [Hz], for any clock.
_NOISE_BELOW_HZ = 56.25


class Spectrum:
    """Accumulate averaged spectra (Welch: Hann windows of 4 s, half overlapping) while samples stream by.

    The spectra are those of the second difference of q: this keeps leakage of the slow motion out of the noise.

    Attributes:
        frequency: (F,) [Hz].
        acceleration: (n, F) one-sided power density of the second difference / dt^2.
        measured, derived, cross: (n, F) densities of the measured velocity, of the central difference of q, and of
            their product (complex); zero if velocities are not measured.
        torque: (n, F) one-sided power density of the torque.
        velocity_square, velocity_max: (n,) of differences over 50 ms.
    """

    def __init__(self, dt: float, n: int, has_velocity: bool):
        self.dt, self._n, self._has_velocity = dt, n, has_velocity
        self._size = int(min(max(_WINDOW_S / dt, _SHORTEST_WINDOW), _LONGEST_WINDOW))
        self._lag = max(1, round(_VELOCITY_LAG_S / dt))
        self.frequency = np.fft.rfftfreq(self._size, dt)
        shape = (n, len(self.frequency))
        self.acceleration, self.measured, self.derived, self.torque = np.zeros((4, *shape))
        self.cross = np.zeros(shape, dtype=complex)
        self.velocity_max = np.zeros(n)
        self._velocity_square, self._weight, self._count = np.zeros(n), 0.0, 0
        self._segment, self._x = -1, np.empty((0, 0))

    def add(self, block: Block) -> None:
        """Add the next samples."""
        if block.segment != self._segment:
            self._finish_segment()
            self._segment, self._x = block.segment, block.x
        else:
            self._x = np.concatenate([self._x, block.x], axis=1)
        need = self._size + 2
        while self._x.shape[1] >= need + self._size // 2:
            self._window(self._x[:, :need])
            self._x = self._x[:, self._size // 2 :]

    def close(self) -> None:
        """Add the remaining samples, and turn sums into averages."""
        self._finish_segment()
        weight = max(self._weight, 1e-300)
        for sums in (self.acceleration, self.measured, self.derived, self.cross, self.torque):
            sums /= weight

    def _finish_segment(self) -> None:
        x, need = self._x, self._size + 2
        if x.shape[1] > need:
            self._window(x[:, :need])
        if x.shape[1] >= _SHORTEST_WINDOW:  # the last window ends with the segment
            self._window(x[:, -need:])
        self._x = np.empty((0, 0))

    def _window(self, x: np.ndarray) -> None:
        n, dt = self._n, self.dt
        q = x[:n]
        length = q.shape[1] - 2
        hann = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(length) + 0.5) / length)
        scale = 2 * dt / np.sum(hann**2)

        def transform(signal: np.ndarray) -> np.ndarray:
            return np.fft.rfft((signal - signal.mean(axis=1, keepdims=True)) * hann, self._size)

        # a short window holds less information, so its weight is smaller
        weight = length / self._size
        self._weight += weight
        self.acceleration += weight * scale * np.abs(transform(np.diff(q, 2, axis=1) / dt**2)) ** 2
        self.torque += weight * scale * np.abs(transform(np.nan_to_num(x[n : 2 * n, 1:-1]))) ** 2
        if self._has_velocity:
            derived, measured = transform((q[:, 2:] - q[:, :-2]) / (2 * dt)), transform(x[2 * n :, 1:-1])
            self.derived += weight * scale * np.abs(derived) ** 2
            self.measured += weight * scale * np.abs(measured) ** 2
            self.cross += weight * scale * derived * measured.conj()
        lag = min(self._lag, q.shape[1] - 1)
        velocity = (q[:, lag:] - q[:, :-lag]) / (lag * dt)
        self.velocity_max = np.maximum(self.velocity_max, np.abs(velocity).max(axis=1))
        self._velocity_square += np.sum(velocity**2, axis=1)
        self._count += velocity.shape[1]

    @property
    def torque_ends_hz(self) -> float:
        """Return the frequency above which no torque has any power but rounding [Hz], NaN if one has.

        A sensor has noise at all frequencies. Less than its noise is left by a filter that the torques passed later.
        """
        seen = self.torque[self.torque.any(axis=1)]
        if not len(seen):
            return math.nan
        alive = seen > _SILENT * seen.max(axis=1, keepdims=True)
        last = int(np.flatnonzero(alive.any(axis=0))[-1])
        return float(self.frequency[last]) if last < _SILENT_FROM * len(self.frequency) else math.nan

    @property
    def velocity_rms(self) -> np.ndarray:
        """Return the root mean square velocity (n,)."""
        return np.sqrt(self._velocity_square / max(1, self._count))

    @property
    def velocity_ratio(self) -> np.ndarray:
        """Return the ratio of the measured velocity to the differentiated position (n,), 1 if none is measured."""
        power = self.derived.sum(axis=1)
        ratio = np.real(self.cross).sum(axis=1) / np.where(power > 0, power, 1.0)
        return np.where((power > 0) & self._has_velocity, ratio, 1.0)

    @property
    def difference_gain(self) -> np.ndarray:
        """Return `(2 sin(w dt / 2) / dt)^2` (F,), the power gain of a first difference."""
        return (2 * np.sin(np.pi * self.frequency * self.dt) / self.dt) ** 2

    def q_noise_density(self, *, regular: bool = True, below_hz: float = math.inf) -> np.ndarray:
        """Return the one-sided power density (n,) of white position noise, from that near the Nyquist frequency.

        Interpolation from an irregular clock weakens it there: lower frequencies are used if ``regular`` is false. An
        encoder that moves less than one step between samples rounds many of them alike. Its noise is then not white up
        to the Nyquist frequency of a fast clock: frequencies ``below_hz`` represent lower ones better.
        """
        low, high = _NOISE_BAND if regular else _SMOOTHED_BAND
        cycles = self.frequency * max(self.dt, high / below_hz)
        band = (cycles > low) & (cycles < high)
        return np.median(self.acceleration[:, band] / self.difference_gain[band] ** 2, axis=1)

    def q_noise_std(self) -> np.ndarray:
        """Return the standard deviation (n,) of white position noise."""
        return np.sqrt(self.q_noise_density() / (2 * self.dt))

    @property
    def smooth_acceleration(self) -> np.ndarray:
        """Return the power density (n, F) of the acceleration, averaged over a third of an octave."""
        f = self.frequency
        ends = np.searchsorted(f, f * 2.0 ** (-1.0 / 6.0)), np.searchsorted(f, f * 2.0 ** (1.0 / 6.0), side="right")
        # Sums from each start to its end, and from there to the next start; the latter are dropped.
        sums = np.add.reduceat(np.pad(self.acceleration, ((0, 0), (0, 1))), np.stack(ends, 1).ravel(), axis=1)
        return sums[:, ::2] / (ends[1] - ends[0])

    def motion_share(self, *, step: np.ndarray | float = math.nan, regular: bool = True) -> np.ndarray:
        """Return the share of the positions' power that is motion and not noise, (n, F) between 0 and 1.

            W(f) = 1 - S_noise(f) / S(f)

        S is averaged over a third of an octave: this is the gain of Wiener's non-causal filter. Above the motion it is
        made non-increasing, so that no random peak of the noise passes. The noise is at least that of rounding to
        steps, step^2 / 12: interpolation between steps removes noise at high frequencies, but not at lower ones.

        Source: Wiener, "Extrapolation, Interpolation and Smoothing of Stationary Time Series", 1949.

        Args:
            step: (n,) of the encoders, NaN if none is seen [rad or m].
            regular: whether rows are on the uniform clock.
        """
        f, smooth = self.frequency, self.smooth_acceleration
        white = self.q_noise_density(regular=regular, below_hz=_NOISE_BELOW_HZ)
        density = np.fmax(white, self.dt * np.square(step) / 6.0)
        noise = density[:, None] * self.difference_gain**2
        share = np.clip(1.0 - _NOISE_MARGIN * noise / np.maximum(smooth, 1e-300), 0.0, 1.0)
        share[:, f < LOWEST_HZ] = 1.0
        return np.minimum.accumulate(share, axis=1)

    def cutoff(self, moves: np.ndarray, longest_s: float) -> float:
        """Find the valley between the falling acceleration density of the motion and the rising one of the noise [Hz].

        There both are equally strong: a lower cut-off loses motion, a higher one adds differentiated noise. The result
        is the valley's upper edge, 1.5 dB above its floor. Densities are averaged over an octave, so the dip between
        two harmonics is not a valley. Their decibels are averaged over the moving joints, so no joint's scale matters
        and one that vibrates does not decide. If no noise limits the band, ten times the frequency below which 99 % of
        the acceleration lies is enough. The noise of the acceleration, `S_q (2 pi)^4 f^5 / 5`, grows with the fifth
        power of the cut-off. It must never exceed 1e-4 of the acceleration's power (1 % of its amplitude).

        Args:
            moves: (n,) bool, joints to use. longest_s: longest segment; the filters must leave some of it.
        """
        f, rate = self.frequency, 1 / self.dt
        acceleration = self.acceleration[moves]
        centres = np.geomspace(LOWEST_HZ, max(_NOISE_BAND[1] * rate, 2 * LOWEST_HZ), _BANDS)
        octaves = ((f >= centres[:, None] / np.sqrt(2)) & (f <= centres[:, None] * np.sqrt(2))).astype(float)
        octaves[np.arange(_BANDS), np.searchsorted(f[:-1], centres).clip(max=len(f) - 1)] = 1.0
        level = np.log(acceleration @ octaves.T / octaves.sum(axis=1) + 1e-300).mean(axis=0)
        velocity = acceleration[:, 1:] / self.difference_gain[1:]
        total = np.maximum(velocity.sum(axis=1, keepdims=True), 1e-300)
        motion = f[1 + np.argmax((velocity / total).mean(axis=0))]
        start = int(np.searchsorted(centres[:-1], motion))
        floor = start + int(np.argmin(level[start:]))
        rises = np.flatnonzero(level[floor:] > level[floor] + math.log(_VALLEY_RISE))
        valley = centres[floor + rises[0] - 1] if len(rises) else centres[-1]
        share = np.cumsum(acceleration[:, f <= valley], axis=1)
        highest = np.median(f[np.argmax(share >= 0.99 * share[:, -1:], axis=1)])
        power = acceleration[:, f <= valley].sum(axis=1) * f[1]
        density = np.maximum(self.q_noise_density()[moves], 1e-300)
        clean = np.median((_NOISE_PART * power * 5 / (density * (2 * np.pi) ** 4)) ** 0.2)
        proposal = max(float(min(valley, clean, _HARMONICS * max(highest, f[1]))), LOWEST_HZ, _REACHES / longest_s)
        return two_digits(min(proposal, HIGHEST_SHARE * rate))

    def qd_noise_std(self, cutoff_hz: float) -> np.ndarray:
        """Return the noise (n,) of measured velocities that are better than the differentiated position, else NaN.

        Better: above the motion, the measured velocity has less than a quarter of the power of the differentiated
        position; within the motion, it follows the latter without lag or gain error. Many drives report a velocity that
        looks smooth because it is late, which the fit would take for physics.
        """
        f = self.frequency
        inside, beyond = (f > 0) & (f <= cutoff_hz), (f > 2 * cutoff_hz) & (f <= 4 * cutoff_hz)
        if not self._has_velocity or not beyond.any():
            return np.full(self._n, np.nan)
        # a central difference has no phase and the gain sin(w dt) / (w dt)
        error = np.abs(self.cross - np.sinc(2 * f * self.dt) * self.measured)[:, inside].sum(axis=1)
        follows = error <= _LAG_TOLERANCE * self.measured[:, inside].sum(axis=1)
        power = np.median(self.measured[:, beyond], axis=1)
        quieter = power < _QUIETER * np.median(self.derived[:, beyond], axis=1)
        return np.where(follows & quieter, np.sqrt(power / (2 * self.dt)), np.nan)


def two_digits(value: float) -> float:
    """Round to two significant digits."""
    return float(f"{value:.2g}") if math.isfinite(value) else value
