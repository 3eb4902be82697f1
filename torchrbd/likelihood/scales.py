"""What recordings cover at each joint: speeds, positions, loads, temperatures, and the speed that is rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from torchrbd.effects import JointScale
from torchrbd.likelihood.reading import Reading
from torchrbd.recordings import Filtering, Survey

# Below this many standard deviations of its noise a velocity has no direction.
_REST_NOISE, _REST_PART, _LEAST_REST = 2.0, 1e-3, 1e-6
# A joint that has covered no more steps of its encoder rests: its control holds it, or it slips.
_STEPS_AT_REST = 20.0


def joint_scales(speed_max: Tensor, velocity_noise: Tensor, low: Tensor, high: Tensor) -> tuple[JointScale, ...]:
    """Return the scales of joints that reach speeds (n_dof,), known to a noise of standard deviation (n_dof,).

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
    """Return what recordings cover at each joint, told by a survey of each; ``filtering`` makes their states."""
    noise = [filtering.state_noise(s.q_noise_std, s.clock.dt, s.qd_noise_std)[:, 1, 1].sqrt() for s in surveys]
    speed = torch.from_numpy(np.max([s.velocity_max for s in surveys], axis=0))
    low = torch.from_numpy(np.min([s.q_min for s in surveys], axis=0))
    high = torch.from_numpy(np.max([s.q_max for s in surveys], axis=0))
    # Of a joint whose temperature one recording lacks, none is known.
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
    """Return the scales with the largest torque that a rigid body with pi (n_params,) takes."""
    most = torch.zeros(len(scales), dtype=torch.float64)
    for k in range(len(reading.recordings)):
        for states in reading.tiles(k):
            load = reading.robot.inverse_dynamics(states.q.T, states.qd.T, states.qdd.T, pi)
            most = torch.maximum(most, load.abs().amax(0))
    return tuple(replace(scale, load_max=load) for scale, load in zip(scales, most.tolist(), strict=True))
