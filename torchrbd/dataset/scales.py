"""The range of recordings at each joint: speeds, positions, loads, temperatures, and the speed that counts as rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.reading import Reading
from torchrbd.effects import JointScale
from torchrbd.recordings import Filtering, Survey

# Speed that counts as rest: in standard deviations of the velocity's noise, as a fraction of the largest speed, and at
# least [rad/s, m/s].
_REST_NOISE, _REST_PART, _LEAST_REST = 2.0, 1e-3, 1e-6
# A joint that covers at most this many encoder steps is at rest: its control holds it, or it slips.
_STEPS_AT_REST = 20.0


def joint_scales(speed_max: Tensor, velocity_noise: Tensor, low: Tensor, high: Tensor) -> tuple[JointScale, ...]:
    """Return the scales of joints with largest speeds (n_dof,) and a velocity noise of standard deviation (n_dof,).

    Args:
        speed_max: (n_dof,) [rad/s, m/s].
        velocity_noise: (n_dof,) standard deviation [rad/s, m/s].
        low, high: (n_dof,) positions that they reach [rad, m].
    """
    least = torch.full_like(speed_max, _LEAST_REST)
    rest = torch.maximum(torch.maximum(_REST_NOISE * velocity_noise, _REST_PART * speed_max), least)
    values = zip(*(x.tolist() for x in (speed_max, rest, low, high)), strict=True)
    return tuple(JointScale(speed, width, least_q, most_q) for speed, width, least_q, most_q in values)


def covered_scales(surveys: Sequence[Survey], filtering: Filtering) -> tuple[JointScale, ...]:
    """Return the range of recordings at each joint, from their surveys; ``filtering`` makes their states."""
    noise = [filtering.state_noise(s.q_noise_std, s.clock.dt, s.qd_noise_std)[:, 1, 1].sqrt() for s in surveys]
    speed = torch.from_numpy(np.max([s.velocity_max for s in surveys], axis=0))
    low = torch.from_numpy(np.min([s.q_min for s in surveys], axis=0))
    high = torch.from_numpy(np.max([s.q_max for s in surveys], axis=0))
    # If one recording lacks a joint's temperature, its range is unknown.
    cold = np.min([s.temperature_min for s in surveys], axis=0)
    warm = np.max([s.temperature_max for s in surveys], axis=0)
    longest = max(s.segments[-1][1] for s in surveys)
    step = torch.from_numpy(np.fmin.reduce([s.q_resolution for s in surveys]))
    noise = torch.where(high - low <= _STEPS_AT_REST * step, speed, torch.stack(noise).amax(0))
    return tuple(
        replace(scale, duration_s=longest, temperature=None if np.isnan(c) else (float(c), float(w)))
        for scale, c, w in zip(joint_scales(speed, noise, low, high), cold, warm, strict=True)
    )


def with_loads(scales: Sequence[JointScale], reading: Reading, pi: Tensor) -> tuple[JointScale, ...]:
    """Return the scales with the largest torque of a rigid body with pi (n_params,)."""
    most = torch.zeros(len(scales), dtype=torch.float64)
    for k in range(len(reading.recordings)):
        for states in reading.tiles(k):
            load = reading.robot.inverse_dynamics(states.q.T, states.qd.T, states.qdd.T, pi)
            most = torch.maximum(most, load.abs().amax(0))
    return tuple(replace(scale, load_max=load) for scale, load in zip(scales, most.tolist(), strict=True))
