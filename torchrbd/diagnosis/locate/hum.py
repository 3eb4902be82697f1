"""Hums: torque of one frequency, whatever the motion: a resonance, an unbalanced fan, a ripple of the supply.

With the periodogram of R runs of a joint's leftover, each from its own start,

    P(f) = 1/R sum_r |sum_k h_k e_r(k) exp(-2 pi i f t_k)|^2 / sum_k h_k^2

and B(f) its median over the frequencies around f, R P / B is a sum of R exponential variables where the spectrum is
smooth: a line stands out of it. What a model leaves of a motion that repeats itself has lines too: there nothing can be
said.

Source: Thomson, "Spectrum estimation and harmonic analysis", Proc. IEEE 1982, on lines in a coloured spectrum.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import correlate, detrend, find_peaks
from scipy.signal.windows import hann
from scipy.stats import gamma

from torchrbd.diagnosis.locate.scene import Scene
from torchrbd.diagnosis.results import Location, Region, Where
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.words import number, torque_unit
from torchrbd.robot import RobotModel

# Slower than this it is drift, or the motion [Hz]; what a run must last to tell [s].
SLOWEST_HZ, SHORTEST_S = 1.0, 5.0
# Width of the neighbourhood that a line is compared with [Hz].
_AROUND_HZ = 1.5
# A line is believed if chance gives one, at any joint and frequency, less often: no spectrum is quite smooth. On 24
# development nulls the least was 2e-6 (benchmarks/null_gains.py).
CHANCE = 1e-9
# A motion repeats itself that is so much like itself some time later, having been unlike it between.
_ALIKE, _UNLIKE = 0.95, 0.5
_PADDED = 4


class Line(NamedTuple):
    """A line in a spectrum: frequency and how well the longest run tells it [Hz], amplitude, chance of it."""

    frequency_hz: float
    resolution_hz: float
    amplitude: float
    chance: float


def hums(fit: Fit, model: str) -> tuple[Location, ...]:
    """Return the hums in what a fit leaves, the clearest first; ``model`` is its name."""
    scene, left = Scene.of(fit), fit.leftover()
    found = []
    for joint, line in lines(fit):
        power = float(np.mean(left[joint] ** 2, where=scene.samples.measured[joint]))
        found.append(_location(scene, joint, line, power, model))
    return tuple(sorted(found, key=lambda x: -x.gain))


def described(
    robot: RobotModel, joint: int, frequency_hz: float, amplitude: float, resolution_hz: float, where: str = ""
) -> tuple[Region, str]:
    """Return the band of a hum, as wide as the recording can tell, and the hum in words."""
    height = f"{number(amplitude)} {torque_unit(robot, joint)}"
    words = f"{robot.joint_names[joint]}: a hum of {frequency_hz:.2f} Hz, {height} high{where}, is not explained."
    return Region("frequency", frequency_hz - resolution_hz, frequency_hz + resolution_hz), words


def lines(fit: Fit, chance: float = CHANCE) -> list[tuple[int, Line]]:
    """Return the lines in the spectra of what a fit leaves, each with its joint, that chance gives less often."""
    scene, left = Scene.of(fit), fit.leftover()
    runs = long_runs(scene)
    if not runs or any(repeats(scene.samples.q[:, run]) for run in runs):
        return []
    return [(j, line) for j in scene.seen for line in _lines(scene, runs, left[j], len(scene.seen), chance)]


def _location(scene: Scene, joint: int, line: Line, power: float, model: str) -> Location:
    name, rms = scene.robot.joint_names[joint], line.amplitude / 2**0.5
    region, statement = described(scene.robot, joint, line.frequency_hz, line.amplitude, line.resolution_hz)
    return Location(
        model=model,
        joints=(name,),
        links=(),
        where=Where(region=(region,)),
        depends_on=("t",),
        form="hum",
        course="",
        gain=-math.log(line.chance),
        torque_rms={name: rms},
        share={name: min(rms**2 / power, 1.0)},
        curve=None,
        attack=None,
        statement=statement,
    )


def long_runs(scene: Scene) -> list[np.ndarray]:
    """Return the samples of each run that is long enough for a spectrum."""
    run = scene.samples.run
    runs = [np.flatnonzero(run == k) for k in np.unique(run)]
    return [r for r in runs if len(r) * scene.dt > SHORTEST_S]


def repeats(q: np.ndarray) -> bool:
    """Say whether a motion (n, M) repeats itself: by its correlation with itself some time later, all joints alike."""
    z = q - q.mean(1, keepdims=True)
    z = z / np.maximum(z.std(1, keepdims=True), 1e-12)
    M = z.shape[1]
    products = np.sum([correlate(one, one)[M - 1 :] for one in z], axis=0)
    power = np.concatenate(([0.0], np.cumsum((z**2).sum(0))))
    lags = np.arange(M // 2)
    alike = products[lags] / np.sqrt(power[M - lags] * (power[M] - power[lags]))
    apart = np.flatnonzero(alike < _UNLIKE)
    return bool(len(apart) and alike[apart[0] :].max() > _ALIKE)


def _lines(scene: Scene, runs: list[np.ndarray], signal: np.ndarray, trials: int, least: float) -> list[Line]:
    """Return the lines of a signal (M,), one of so many that are looked at, that chance gives less often than so."""
    longest = max(len(r) for r in runs)
    n = _PADDED * longest
    power, amplitude = np.zeros((2, n // 2 + 1))
    for r in runs:
        h = hann(len(r), sym=False)
        squared = np.abs(np.fft.rfft(h * detrend(np.nan_to_num(signal[r])), n)) ** 2
        power += squared / (h**2).sum() / len(runs)
        amplitude += (2.0 / h.sum()) ** 2 * squared / len(runs)
    df = 1.0 / (n * scene.dt)
    f = df * np.arange(len(power))
    shape = len(runs)
    usual = median_filter(power, max(3, round(_AROUND_HZ / df)), mode="nearest") / (gamma.median(shape) / shape)
    chance = gamma.sf(shape * power / np.maximum(usual, 1e-300), shape) * trials * longest * scene.dt * f[-1]
    peaks = find_peaks(power)[0]
    peaks = peaks[(chance[peaks] < least) & (f[peaks] > SLOWEST_HZ)]
    top = df * (peaks + _beside(np.log(np.maximum(power, 1e-300)), peaks))
    return [
        Line(float(at), 1.0 / (longest * scene.dt), float(amplitude[k] ** 0.5), max(float(chance[k]), 1e-300))
        for k, at in zip(peaks, top, strict=True)
    ]


def _beside(y: np.ndarray, peaks: np.ndarray) -> np.ndarray:
    """Return how far from a peak, in samples, the parabola through it and its neighbours is highest."""
    left, middle, right = (y[peaks + k] for k in (-1, 0, 1))
    return 0.5 * (left - right) / (left - 2.0 * middle + right)
