"""Smooth all recordings of a job at once: they share parameters and noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.columns import Columns
from torchrbd.dataset.reading import Reading
from torchrbd.dataset.scales import joint_scales
from torchrbd.inference.input_noise import InputNoise
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.physical.uncertain_states import UncertainStates
from torchrbd.inference.smoothing.smoother import StateSmoother
from torchrbd.inference.smoothing.stretch import SAMPLES_PER_KNOT, Stretch, knots_per_output, stretches
from torchrbd.likelihood.urdf_prior import Prior
from torchrbd.recordings import Filtering, States, Survey

# Torque noise to start from is at least so much of what a fit on filtered states leaves.
_LEAST_SHARE = 0.02


@dataclass(frozen=True)
class Trajectory:
    """The smoothed motion of a recording; replaces the filtered states of a tile."""

    parts: tuple[tuple[Stretch, Tensor], ...]

    def __call__(self, states: States) -> States:
        """Return the tile with smoothed q, qd and qdd; torque and times stay."""
        own = [part for part in self.parts if part[0].segment == states.segment]
        # a stretch ends midway to the next one's first torque
        ends = [s.grid.first_output - 0.5 * s.grid.output_step for s, _ in own[1:]]
        number = torch.bucketize(states.t, torch.tensor(ends, dtype=torch.float64))
        q, qd, qdd = (torch.empty_like(states.q) for _ in range(3))
        for k, (stretch, c) in enumerate(own):
            here = number == k
            found = stretch.grid.states(c, states.t[here].numpy())
            q[:, here], qd[:, here], qdd[:, here] = found
        return replace(states, q=q, qd=qd, qdd=qdd)


@dataclass(frozen=True)
class Smoothed:
    """What smoothing found.

    Attributes:
        trajectories: per recording.
        columns: layout of x, with directions of motion as sharp as smoothed velocities allow.
        states: information on x that their uncertainty loses.
        encoder_std: (n_dof,) position noise, [rad] or [m].
    """

    trajectories: tuple[Trajectory, ...]
    columns: Columns
    states: UncertainStates
    encoder_std: Tensor


def smoothable(survey: Survey, filtering: Filtering) -> bool:
    """Say whether a recording has enough positions to a spline coefficient, and no better velocities."""
    stride = filtering.stride(survey.clock.dt)
    room = stride >= SAMPLES_PER_KNOT * knots_per_output(stride * survey.clock.dt)
    return room and bool(np.isnan(survey.qd_noise_std).all())


def smooth(
    reading: Reading,
    prior: Prior,
    start: FittedModel,
    noise: InputNoise,
    kept_back: Callable[[str, Tensor], Tensor],
    progress: Callable[[float], None],
) -> Smoothed:
    """Estimate states and parameters together; friction is fitted as well, as it would else bend the states.

    Args:
        reading: the recordings, filtered states.
        prior: of x.
        start: a fit on filtered states.
        noise: of the positions, and what it does to that fit.
        kept_back: says of a recording's name and times (O,) which are held out: the torque is not used there.
        progress: called with the stage and the part of it that is done.
    """
    found: list[tuple[Stretch, ...]] = []
    for k, recording in enumerate(reading.recordings):

        def counted(t: Tensor, k: int = k, name: str = recording.name) -> Tensor:
            return ~kept_back(name, t).unsqueeze(1) & reading.measured(k)

        found.append(stretches(recording, reading.surveys[k], reading.filtering, reading.tiles(k), counted))
    torque = (start.noise_variance * (1 - noise.share).clamp_min(_LEAST_SHARE)).sqrt()
    used = [s for own in found for s in own if bool(s.counts.any())]
    columns = start.columns
    smoother = StateSmoother(columns, prior, used, _friction(columns), start.x, torque, noise.encoder_std)
    smoother.fit(progress)
    said = smoother.information or smoother.refresh()
    covered = ("speed_max", "q_low", "q_high")
    speed, *reach = (torch.tensor([getattr(s, name) for s in columns.scales]).double() for name in covered)
    renewed = joint_scales(speed, (said.velocity_noise / said.outputs).sqrt(), *reach)
    pairs = zip(columns.scales, renewed, strict=True)
    sharper = columns.at_scales([replace(old, rest_width=new.rest_width) for old, new in pairs])
    x = sharper.taken_from(columns, smoother.x.detach())
    torque, encoder = smoother.log_torque_std.detach().exp(), smoother.log_encoder_std.detach().exp()
    last = StateSmoother(sharper, prior, used, _friction(sharper), x, torque, encoder)
    last.trajectories = smoother.trajectories
    said = last.refresh(torch.arange(sharper.n))
    moved = iter(smoother.trajectories)
    trajectories = tuple(
        Trajectory(tuple((s, next(moved).detach() if bool(s.counts.any()) else s.encoder) for s in own))
        for own in found
    )
    return Smoothed(trajectories, sharper, said.uncertain_states(torque.square()), encoder)


def _friction(columns: Columns) -> Tensor:
    """Return the columns of friction at joints that move; of others the direction is unknown and bends all states."""
    own = (c for c in columns.urdf_friction if columns.scale(c.site).moves)
    return torch.tensor([k for c in own for k in columns.of(c)], dtype=torch.long)
