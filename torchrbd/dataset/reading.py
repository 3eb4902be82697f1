"""The reading of one job's recordings: filter, torques that count, and state estimates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics, block_statistics
from torchrbd.dataset.columns import Columns
from torchrbd.dataset.simulated import Simulated
from torchrbd.model import OTHERS, Condition
from torchrbd.recordings import TILE_ROWS, Drives, Filtering, Gain, Recording, States, Survey, tiles
from torchrbd.robot import RobotModel

Progress = Callable[[str, float], None]
"""Callback with the present stage and the fraction of it that is done (0 to 1)."""

StateEstimate = Callable[[States], States]
"""Replaces the filtered states of a tile by better ones."""

_BLOCK_S, _BLOCK_CYCLES, _MOST_BLOCKS = 1.0, 5.0, 256


@dataclass(frozen=True)
class Reading:
    """Recordings and how to read them.

    Attributes:
        robot: the robot.
        recordings, surveys: in the order given, held-out ones last.
        filtering: the filter pair for all.
        used: (n_dof,) bool, joints whose torque counts.
        payload: per recording name, inertial parameters (n_params,) of known loads.
        simulated: per recording, a simulator's torque beyond the URDF; empty if the comparison is with the URDF.
        smoothed: per recording, an estimate that replaces the filtered states; empty if they stay.
        delay_s: by recording, delay of its torque relative to its motion [s]; the torque is read earlier by that.
        lag_s: by recording, time constant of the actuators, if its torque is their command [s]; the torque that they
            supply is read. In both, the key "" is for recordings that are not among these.
        gains: estimated factors of torques.
        raw: whether torques are read as recorded, and states filtered. Only a simulator's torque beyond the URDF, and
            that of rotors and springs in the robot's description, are subtracted.
    """

    robot: RobotModel
    recordings: tuple[Recording, ...]
    surveys: tuple[Survey, ...]
    filtering: Filtering
    used: Tensor
    payload: dict[str, Tensor]
    simulated: tuple[Simulated, ...] = ()
    smoothed: tuple[StateEstimate, ...] = ()
    delay_s: Mapping[str, float] = field(default_factory=dict)
    lag_s: Mapping[str, float] = field(default_factory=dict)
    gains: tuple[Gain, ...] = ()
    raw: bool = False

    @property
    def conditions(self) -> dict[str, Condition]:
        """Conditions of the recordings, by name; "" for those that are not among these."""
        simulated = {one.recording: one.name for one in self.simulated}
        return {
            name: Condition(
                delay_s=self.delay_s.get(name, 0.0),
                lag_s=self.lag_s.get(name, 0.0),
                load=self.payload.get(name),
                simulated=simulated.get(name, ""),
            )
            for name in (*(r.name for r in self.recordings), OTHERS)
        }

    def measured(self, k: int) -> Tensor:
        """Return (n_dof,) bool, the joints whose torque in recording k counts; a constant torque is no measurement."""
        recording, constant = self.recordings[k], self.surveys[k].constant_tau
        varies = [m and n not in constant for m, n in zip(recording.measured, recording.joints, strict=True)]
        return torch.tensor(varies) & self.used

    def tiles(self, k: int, rows: int = TILE_ROWS) -> Iterator[States]:
        """Stream the states of recording k in tiles of about so many samples; what is known is taken off: payloads,
        rotors and springs of the robot's description, a simulator's extra torque."""
        recording = self.recordings[k]
        condition = self.conditions[recording.name]
        for states in tiles(recording, self.surveys[k], self.filtering, rows):
            yield self._less_known(states if self.raw else self._at_the_motion(states, k, condition), k, condition)

    def _at_the_motion(self, states: States, k: int, condition: Condition) -> States:
        """Return a tile with the torque at the time of the motion, smoothed states, and a known load subtracted."""
        states = replace(states, tau=condition.acting(states.tau, states.dt))
        if self.smoothed:
            states = self.smoothed[k](states)
        if condition.load is None:
            return states
        known = self.robot.inverse_dynamics(states.q.T, states.qd.T, states.qdd.T, condition.load).T
        return replace(states, tau=states.tau - states.as_recorded(known), loaded=condition.load)

    def _less_known(self, states: States, k: int, condition: Condition) -> States:
        """Return a tile without the torque of rotors and springs, and without a simulator's torque beyond the URDF."""
        known = self.robot.known_torque(states.q.T, states.qdd.T).T if self._has_rotors else None
        if self.simulated:
            less = self.simulated[k].taken_off(states)
            extra = states.tau - less.tau
            states = replace(less, tau=states.tau - condition.recorded(extra, states.dt)) if self.raw else less
        return states if known is None else replace(states, tau=states.tau - states.as_recorded(known), known=known)

    @property
    def driven(self) -> Tensor:
        """Which joints have a drive, whose torque is computed from set-points, (n_dof,) bool."""
        names = {joint for recording in self.recordings for joint in recording.drives.of}
        return torch.tensor([joint in names for joint in self.robot.joint_names])

    @property
    def drives(self) -> Drives | None:
        """The drives of the first recording that has some; None where all torques were recorded."""
        return next((r.drives for r in self.recordings if r.drives.of), None)

    @property
    def has_drives(self) -> bool:
        """Whether any joint has a drive."""
        return bool(self.driven.any())

    @property
    def has_known(self) -> bool:
        """Whether a part of the torque is known: of a load, or of rotors and springs of the robot's description."""
        return bool(self.payload) or self._has_rotors

    @property
    def _has_rotors(self) -> bool:
        return bool(self.robot.armature.any() or self.robot.stiffness.any())

    @property
    def block_s(self) -> float:
        """Length of a block [s]: some cycles of the cut-off, and long enough to limit the number of blocks."""
        return max(_BLOCK_S, _BLOCK_CYCLES / self.filtering.cutoff_hz, self._duration_s / _MOST_BLOCKS)

    @property
    def _duration_s(self) -> float:
        return sum(s.duration_s for s in self.surveys)

    def statistics(self, columns: Columns, progress: Progress, *, known_too: bool = False) -> BlockStatistics:
        """Stream all recordings into block statistics; see ``block_statistics`` for ``known_too``."""
        done, parts = 0.0, []
        for k, (recording, s) in enumerate(zip(self.recordings, self.surveys, strict=True)):

            def watched(stream: Iterator[States], before: float = done) -> Iterator[States]:
                for states in stream:
                    progress("building the statistics", min(1.0, (before + float(states.t[0])) / self._duration_s))
                    yield states

            parts.append(
                block_statistics(
                    columns,
                    recording.name,
                    watched(self.tiles(k)),
                    self.measured(k),
                    block_s=self.block_s,
                    independent_rate_hz=self.filtering.effective_rate,
                    known_too=known_too,
                )
            )
            done += s.duration_s
        joined = parts[0]
        for part in parts[1:]:
            joined = joined + part
        return joined.coarsened(_MOST_BLOCKS)
