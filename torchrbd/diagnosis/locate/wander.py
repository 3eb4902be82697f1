"""Wandering torque: what changes slowly, whatever the motion: heat, a hose, a supply, or physics of many signals.

With the mean periodogram P(f) of a joint's leftover e, each sample counted by its weight a (joints that stick have a
torque of their own), slow power P_s below f_s and usual power P_n where neither motion nor wandering is,

    rms^2 = 2 f_s dt (P_s - P_n)

Noise with a shorter memory than 1 / f_s has P_s = P_n, so that n bins of it have n P_s / P_n ~ Gamma(n).

Source: Percival, Walden, "Spectral analysis for physical applications", 1993, ch. 6.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal.windows import hann
from scipy.stats import gamma

from torchrbd.diagnosis.locate.hum import long_runs, repeats
from torchrbd.diagnosis.locate.scene import Scene
from torchrbd.diagnosis.results import Location, Where
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.words import number, torque_unit

# What a recording must last to tell slow from motion [s].
SHORTEST_S = 15.0
# Slow is below [Hz]. Noise is judged above the motion [Hz] and below the cut-off, in parts of the rate of the rows.
SLOW_HZ, NOISE_FROM_HZ, NOISE_TO = 0.5, 1.0, 0.32
# Less, in parts of a joint's torque RMS, is the drift of a sensor: on 24 development nulls with a drift of .004 at most
# .0073 (benchmarks/null_gains.py). What chance gives less often is believed.
DRIFT, _CHANCE = 0.01, 1e-6
# The Hann window leaves that part of the bins independent.
_INDEPENDENT = 0.5


class Slow(NamedTuple):
    """The slow part of a leftover: RMS, that in parts of the joint's torque RMS, and how often chance gives as much."""

    rms: float
    part: float
    chance: float


def wanders(fit: Fit, model: str) -> tuple[Location, ...]:
    """Return the joints whose leftover wanders, the largest first; ``model`` is the name of what leaves it."""
    scene, left = Scene.of(fit), fit.leftover()
    found = [
        _location(scene, joint, left[joint], slow, model)
        for joint, slow in slow_parts(fit).items()
        if slow.part > DRIFT and slow.chance < _CHANCE
    ]
    return tuple(sorted(found, key=lambda x: -x.gain))


def slow_parts(fit: Fit) -> dict[int, Slow]:
    """Return the slow part of what a fit leaves, by joint; nothing where there is none to be told from the motion."""
    scene, left = Scene.of(fit), fit.leftover()
    runs = _runs(scene)
    if not runs or NOISE_TO / scene.dt < 1.5 * NOISE_FROM_HZ or any(repeats(scene.samples.q[:, run]) for run in runs):
        return {}
    return {joint: _slow(scene, runs, left[joint], joint) for joint in scene.seen}


def _runs(scene: Scene) -> list[np.ndarray]:
    t, of = scene.samples.t, scene.samples.recording
    lasts = {k: np.ptp(t[of == k]) for k in np.unique(of)}
    return [run for run in long_runs(scene) if lasts[of[run[0]]] > SHORTEST_S]


def _slow(scene: Scene, runs: list[np.ndarray], left: np.ndarray, joint: int) -> Slow:
    """Return the slow part of a leftover (M,)."""
    slow, usual, bins = 0.0, 0.0, 0.0
    for r in runs:
        a, h = scene.samples.weight[joint, r], hann(len(r), sym=False)
        e = a * (left[r] - np.average(left[r], weights=a**2 + 1e-300))
        power = np.abs(np.fft.rfft(h * e)) ** 2 / (h**2).sum()
        f = np.fft.rfftfreq(len(r), scene.dt)
        below, noise = (f > 0) & (f < SLOW_HZ), (f > NOISE_FROM_HZ) & (f < NOISE_TO / scene.dt)
        slow += power[below].mean() / len(runs)
        usual += np.median(power[noise]) / math.log(2.0) / len(runs)
        bins += _INDEPENDENT * below.sum()
    chance = gamma.sf(bins * slow / max(usual, 1e-300), bins)
    rms = float(np.sqrt(2.0 * SLOW_HZ * scene.dt * max(slow - usual, 0.0)))
    whole = float(np.sqrt(np.mean(scene.samples.tau[joint] ** 2)))
    return Slow(rms, rms / max(whole, 1e-300), float(max(chance, 1e-300)))


def _location(scene: Scene, joint: int, left: np.ndarray, slow: Slow, model: str) -> Location:
    name, unit = scene.robot.joint_names[joint], torque_unit(scene.robot, joint)
    power = float(np.mean((scene.samples.weight[joint] * left) ** 2, where=scene.samples.measured[joint]))
    return Location(
        model=model,
        joints=(name,),
        links=(),
        where=Where(),
        depends_on=("t",),
        form="wander",
        course="slow",
        gain=-math.log(slow.chance),
        torque_rms={name: slow.rms},
        share={name: min(slow.rms**2 / max(power, 1e-300), 1.0)},
        curve=None,
        attack=None,
        statement=f"{name}: a torque of {number(slow.rms)} {unit} RMS that changes slowly is not explained; it follows "
        "no signal that was tried.",
    )
