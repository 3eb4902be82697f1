"""From files to block statistics: the two streaming passes that every fit and diagnosis starts with.

survey (clock, noise, band) -> one cut-off for all -> states, regressor and features, tile by tile -> block statistics
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchrbd.errors import OptionError, RecordingError
from torchrbd.inference.block_statistics import BlockStatistics, block_statistics
from torchrbd.inference.columns import Columns
from torchrbd.inference.payload import payload_parameters
from torchrbd.inference.prior import Prior, unphysical_bodies, urdf_prior
from torchrbd.inference.settings import Settings
from torchrbd.physics import Effect, JointScale
from torchrbd.recordings import (
    Filtering,
    Recording,
    States,
    Survey,
    choose_cutoff,
    open_recording,
    read_mapping,
    skipped_segments,
    survey,
    tiles,
)
from torchrbd.robot import RobotModel

Progress = Callable[[str, float], None]
"""Told what is being done and which part (0 to 1) of it is done."""

_BLOCK_S, _BLOCK_CYCLES, _MOST_BLOCKS, _LEAST_BLOCKS = 1.0, 5.0, 256, 6
# Neighbouring blocks that are kept back together: fewer seams between what is fitted and what is judged.
_HOLDOUT_RUN = 2
# Below this many standard deviations of its noise a velocity has no direction.
_REST_NOISE, _REST_PART = 2.0, 1e-3
_BEYOND_LIMIT = 3.0


@dataclass(frozen=True)
class Prepared:
    """A robot, its recordings, and the statistics of both.

    Attributes:
        robot: as the URDF gives it.
        recordings, surveys: in the order given, held-out ones last.
        filtering: the one filter pair of all.
        columns: layout of x.
        statistics: all blocks.
        held_out: (B,) bool, blocks that no fit or choice may see.
        holdout_words: the same for a person.
        prior: around the URDF.
        used: (n_dof,) bool, joints whose torque counts.
        payload: per recording name, inertial parameters (n_params,) of known loads.
        notes: what the user should know of the input.
    """

    robot: RobotModel
    recordings: tuple[Recording, ...]
    surveys: tuple[Survey, ...]
    filtering: Filtering
    columns: Columns
    statistics: BlockStatistics
    held_out: Tensor
    holdout_words: str
    prior: Prior
    used: Tensor
    payload: dict[str, Tensor]
    notes: tuple[str, ...]

    @property
    def fitted(self) -> tuple[str, ...]:
        """Names of the recordings that are not held out as a whole."""
        seen = {b.recording for b, held in zip(self.statistics.blocks, self.held_out.tolist(), strict=True) if not held}
        return tuple(r.name for r in self.recordings if r.name in seen)

    @property
    def training(self) -> BlockStatistics:
        """Blocks to fit and choose with."""
        return self.statistics.select(~self.held_out)

    @property
    def judging(self) -> BlockStatistics:
        """Blocks kept back."""
        return self.statistics.select(self.held_out)

    def measured(self, k: int) -> Tensor:
        """Return (n_dof,) bool, the joints whose torque in recording k counts."""
        return _measured(self.recordings[k], self.surveys[k]) & self.used

    def tiles(self, k: int) -> Iterator[States]:
        """Stream the states of recording k; known payloads are taken off its torque."""
        return _tiles(self.robot, self.recordings[k], self.surveys[k], self.filtering, self.payload)


def prepare(
    robot: RobotModel,
    recordings: Sequence[str | Path | Recording],
    settings: Settings,
    effects: Sequence[Effect],
    progress: Progress = lambda *_: None,
) -> Prepared:
    """Read everything.

    Args:
        robot: the robot.
        recordings: files or opened recordings to fit.
        settings: the user's choices.
        effects: physics to have columns for.
        progress: told how far the work is.

    Raises:
        RecordingError, OptionError: input that cannot be used.
    """
    opened, n_fitted = _open(robot, recordings, settings)
    surveys = []
    for k, recording in enumerate(opened):
        progress("looking through the recordings", k / len(opened))
        surveys.append(survey(recording))
    filtering = Filtering(choose_cutoff(surveys) if settings.cutoff_hz is None else settings.cutoff_hz)
    columns = Columns(robot, effects, _scales(robot, surveys, filtering))
    used, held = settings.used_joints(robot), settings.held_bodies(robot)
    payload = payload_parameters(robot, [r.name for r in opened], settings.payload)
    statistics = _stream(columns, opened, surveys, filtering, used, payload, progress)
    held_out, words = _held_out(statistics, opened, n_fitted, settings)
    n_training = int((~held_out).sum())
    if n_training < _LEAST_BLOCKS:
        raise RecordingError(
            f"after filtering at {filtering.cutoff_hz:g} Hz and holding out {words}, {n_training} blocks of "
            f"{_block_s(surveys, filtering):.2g} s are left to fit; at least {_LEAST_BLOCKS} are needed: "
            "give longer or more recordings"
        )
    weight, _, square = statistics.torque.sum(0).unbind(-1)
    if not weight.any():
        raise RecordingError("no torque that changes is recorded for any of the joints in use; nothing can be fitted")
    torque_rms = (square / weight.clamp_min(1e-300)).sqrt()
    prior = urdf_prior(columns, torque_rms, _feature_rms(statistics), held=held, kappa=settings.kappa)
    return Prepared(
        robot=robot,
        recordings=opened,
        surveys=tuple(surveys),
        filtering=filtering,
        columns=columns,
        statistics=statistics,
        held_out=held_out,
        holdout_words=words,
        prior=prior,
        used=used,
        payload=payload,
        notes=_notes(columns, surveys, filtering, prior, held, used & (weight == 0)),
    )


def _open(
    robot: RobotModel, recordings: Sequence[str | Path | Recording], settings: Settings
) -> tuple[tuple[Recording, ...], int]:
    mapping = read_mapping(settings.mapping) if settings.mapping else None

    def opened(source: str | Path | Recording) -> Recording:
        if isinstance(source, Recording):
            return source.of_joints(robot.joint_names, settings.time)
        return open_recording(source, robot.joint_names, mapping=mapping, time=settings.time)

    if not recordings:
        raise OptionError("no recording to fit; give at least one")
    both = {str(r) for r in recordings} & {str(h) for h in settings.holdout}
    if both:
        raise OptionError(f"{', '.join(sorted(both))} is both fitted and held out; leave it out of one list")
    found = [*map(opened, recordings), *map(opened, settings.holdout)]
    names = [r.name for r in found]
    for k, name in enumerate(names):
        if name in names[:k]:
            parents = [str(r.path or r.name) for r in found if r.name == name]
            raise RecordingError(
                f"two recordings are called '{name}' ({', '.join(parents)}); rename one, results refer to them by name"
            )
    return tuple(found), len(recordings)


def _scales(robot: RobotModel, surveys: Sequence[Survey], filtering: Filtering) -> tuple[JointScale, ...]:
    speed = np.max([s.velocity_max for s in surveys], axis=0)
    noise = np.max(
        [np.sqrt(filtering.state_noise(s.q_noise_std, s.clock.dt, s.qd_noise_std)[:, 1, 1].numpy()) for s in surveys],
        axis=0,
    )
    rest = np.maximum.reduce([_REST_NOISE * noise, _REST_PART * speed, np.full(robot.n_dof, 1e-6)])
    return tuple(JointScale(*map(float, values)) for values in zip(speed, rest, strict=True))


def _tiles(
    robot: RobotModel, recording: Recording, s: Survey, filtering: Filtering, payload: dict[str, Tensor]
) -> Iterator[States]:
    for states in tiles(recording, s, filtering):
        if recording.name in payload:
            known = robot.inverse_dynamics(states.q.T, states.qd.T, states.qdd.T, payload[recording.name]).T
            states = replace(states, tau=states.tau - known)
        yield states


def _stream(
    columns: Columns, recordings: Sequence[Recording], surveys: Sequence[Survey], filtering: Filtering, used: Tensor,
    payload: dict[str, Tensor], progress: Progress,
) -> BlockStatistics:  # fmt: skip
    duration = sum(s.duration_s for s in surveys)
    block_s = _block_s(surveys, filtering)
    done, statistics = 0.0, None
    for recording, s in zip(recordings, surveys, strict=True):

        def watched(stream: Iterator[States], before: float = done) -> Iterator[States]:
            for states in stream:
                progress("building the statistics", min(1.0, (before + float(states.t[0])) / duration))
                yield states

        measured = _measured(recording, s) & used
        stream = watched(_tiles(columns.robot, recording, s, filtering, payload))
        part = block_statistics(
            columns, recording.name, stream, measured, block_s=block_s, independent_rate_hz=filtering.effective_rate
        )
        statistics = part if statistics is None else statistics + part
        done += s.duration_s
    assert statistics is not None
    return statistics.coarsened(_MOST_BLOCKS)


def _block_s(surveys: Sequence[Survey], filtering: Filtering) -> float:
    """Return the length of a block [s]: some cycles of the cut-off, and so long that not too many are kept."""
    return max(_BLOCK_S, _BLOCK_CYCLES / filtering.cutoff_hz, sum(s.duration_s for s in surveys) / _MOST_BLOCKS)


def _measured(recording: Recording, s: Survey) -> Tensor:
    """Return (n_dof,) bool: joints with a torque that changes; a constant one comes from no sensor."""
    return torch.tensor(
        [m and n not in s.constant_tau for m, n in zip(recording.measured, recording.joints, strict=True)]
    )


def _notes(
    columns: Columns,
    surveys: Sequence[Survey],
    filtering: Filtering,
    prior: Prior,
    held: Sequence[str],
    without_torque: Tensor,
) -> tuple[str, ...]:
    robot, notes = columns.robot, []
    for s in surveys:
        found = [*s.notes, *(f"the torque of {name} never changes and is not used" for name in s.constant_tau)]
        found += [
            f"{name} moves at up to {fastest:.3g} per second, its limit is {limit:.3g}: check the units of q and t"
            for name, fastest, limit in zip(robot.joint_names, s.velocity_max, robot.velocity.tolist(), strict=True)
            if fastest > _BEYOND_LIMIT * limit > 0
        ]
        found += [
            f"{a:.3g} to {b:.3g} s left out: too short for the filters" for a, b in skipped_segments(s, filtering)
        ]
        notes += [note if note.startswith(s.name) else f"{s.name}: {note}" for note in found]
    silent = (name for name, none in zip(robot.joint_names, without_torque.tolist(), strict=True) if none)
    notes += [f"no recording has a torque that changes for {name}" for name in silent]
    notes += [
        f"the URDF's inertia of {body} is that of no extended body of its mass; the fit starts from the nearest that is"
        for body in unphysical_bodies(columns)
    ]
    massless = (n for b, n in enumerate(robot.body_names) if b not in prior.bodies and n not in held)
    return (
        *notes,
        *(f"{name} has no mass in the URDF and keeps none; give it a rough one if it has any" for name in massless),
    )


def _held_out(
    statistics: BlockStatistics, recordings: Sequence[Recording], n_fitted: int, settings: Settings
) -> tuple[Tensor, str]:
    names = [block.recording for block in statistics.blocks]
    if settings.holdout:
        kept = {r.name for r in recordings[n_fitted:]}
        return torch.tensor([name in kept for name in names]), ", ".join(sorted(kept))
    period = max(2, round(_HOLDOUT_RUN / settings.holdout_fraction))
    run = min(_HOLDOUT_RUN, period // 2)
    # Counted through all recordings; of very few blocks at least the last is kept back.
    position = (torch.arange(len(names)) + settings.seed * run) % period
    held_out = position >= period - run
    if not held_out.any():
        held_out[-run:] = True
    return held_out, f"{100 * float(held_out.double().mean()):.0f} % of the time, in short runs throughout"


def _feature_rms(statistics: BlockStatistics) -> Tensor:
    columns = statistics.columns
    power, weight = torch.zeros(columns.n, dtype=torch.float64), statistics.torque[..., 0].sum(0)
    for joint, total in enumerate(statistics.total()):
        if weight[joint] > 0:
            power[columns.of_joint[joint]] += total.diagonal()[:-1] / weight[joint]
    return power.sqrt()
