"""What sensors make of an ideal record: encoder steps, coloured torque noise, drift, coarse current steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from scipy.signal import lfilter

from .contract import Effect, rms
from .simulate import STEP, Run
from .tiers import Conditions


@dataclass(frozen=True)
class Noise:
    """Of all recordings of a case.

    Attributes:
        rate_hz: of the recorder.
        torque: standard deviation in parts of each joint's torque RMS.
        colour_s: time in which it forgets itself.
        drift: RMS in parts of the torque RMS.
        encoder_bits: a turn.
        torque_step: (n,) [N m].
    """

    rate_hz: float
    torque: float
    colour_s: float
    drift: float
    encoder_bits: int
    torque_step: np.ndarray


def noise_of(rng: np.random.Generator, conditions: Conditions, fits: Sequence[Run], effects: Sequence[Effect]) -> Noise:
    """Draw the sensors of a case."""
    peak = np.max([np.abs(run.recorded(effects).tau).max(0) for run in fits], axis=0)
    steps = float(rng.uniform(*conditions.torque_steps))
    return Noise(
        rate_hz=float(rng.choice(conditions.rates_hz)),
        torque=conditions.torque_noise,
        colour_s=float(rng.uniform(*conditions.colour_s)),
        drift=conditions.drift,
        encoder_bits=int(rng.integers(conditions.encoder_bits[0], conditions.encoder_bits[1] + 1)),
        torque_step=peak / steps if steps else np.zeros_like(peak),
    )


def table(
    rng: np.random.Generator,
    run: Run,
    effects: Sequence[Effect],
    joints: Sequence[str],
    noise: Noise,
    shows_temperature: bool,
) -> pa.Table:
    """Return the columns of a recording: t, q_<joint>, tau_<joint> and, if shown, temperature_<joint> [deg C]."""
    record, every = run.recorded(effects), round(1 / (noise.rate_hz * STEP))
    t, q, tau = record.t[::every], record.q[::every], record.tau[::every]
    size = rms(tau)
    tau = tau + noise.torque * size * _coloured(rng, tau.shape, noise.colour_s * noise.rate_hz)
    tau = tau + noise.drift * size * _drift(rng, t, tau.shape[1])
    tau = _in_steps(tau, noise.torque_step)
    q = _in_steps(q, np.full(q.shape[1], 2 * np.pi / 2**noise.encoder_bits))
    columns = {"t": t}
    columns |= {f"q_{joint}": q[:, k] for k, joint in enumerate(joints)}
    columns |= {f"tau_{joint}": tau[:, k] for k, joint in enumerate(joints)}
    if shows_temperature:
        warm = _in_steps(run.temperature[::every], np.full(q.shape[1], 0.1))
        columns |= {f"temperature_{joint}": warm[:, k] for k, joint in enumerate(joints)}
    return pa.table(columns)


def _coloured(rng: np.random.Generator, shape: tuple[int, ...], samples: float) -> np.ndarray:
    """Return stationary first-order noise of unit variance whose correlation falls by 1/e in so many samples."""
    white = rng.standard_normal(shape)
    if not samples:
        return white
    pole = float(np.exp(-1.0 / samples))
    white[1:] *= np.sqrt(1.0 - pole**2)
    return np.asarray(lfilter([1.0], [1.0, -pole], white, axis=0))


def _drift(rng: np.random.Generator, t: np.ndarray, n: int) -> np.ndarray:
    """Return random walks (N, n) of unit RMS with a step every five seconds, in straight lines."""
    knots = np.arange(0.0, t[-1] + 5.0, 5.0)
    walks = np.cumsum(rng.standard_normal((len(knots), n)), axis=0)
    walks = np.stack([np.interp(t, knots, walk) for walk in walks.T], axis=1)
    return (walks - walks.mean(0)) / rms(walks - walks.mean(0))


def _in_steps(x: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return (N, n) rounded to multiples of (n,) steps; as it is where a step is 0."""
    coarse = step > 0
    x = x.copy()
    x[:, coarse] = np.round(x[:, coarse] / step[coarse]) * step[coarse]
    return x
