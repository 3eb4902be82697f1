"""Compare an exported file with the model that it was made from, on the motion of recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from torchrbd.display import Remark
from torchrbd.errors import OptionError
from torchrbd.export.gathered import described, gather
from torchrbd.export.replay import replayed
from torchrbd.export.simulators import written
from torchrbd.model import RigidBodyDynamics
from torchrbd.recordings import (
    Filtering,
    Recording,
    States,
    choose_cutoff,
    open_recording,
    read_mapping,
    survey,
    tiles,
)

# Rows that memory (hysteresis, delays) reaches back over, and that are held at a time.
_ROWS = 1 << 14


@dataclass(frozen=True)
class JointCheck:
    """How far file and model are apart at one joint.

    Attributes:
        joint: its name.
        unit: of its torque, "N m" or "N".
        torque: RMS of the model's torque.
        difference: RMS of the file's torque minus the model's.
    """

    joint: str
    unit: str
    torque: float
    difference: float

    @property
    def part(self) -> float:
        """Difference over torque; not a number for a joint without torque."""
        return self.difference / self.torque if self.torque else float("nan")


@dataclass(frozen=True)
class FileCheck:
    """A comparison of an exported file with its model.

    Attributes:
        joints: in the robot's order.
        samples: states that were compared.
        cutoff_hz: up to which the motion is seen.
        notes: what is left out of the comparison.
    """

    joints: tuple[JointCheck, ...]
    samples: int
    cutoff_hz: float
    notes: tuple[Remark, ...]


def check_file(
    model: RigidBodyDynamics,
    to: str,
    recordings: Sequence[str | Path | Recording],
    *,
    mapping: str | Path | None = None,
    cutoff_hz: float | None = None,
) -> FileCheck:
    """Replay the file that a model is written to in MuJoCo, and compare its torques with the model's.

    The motion is that of the recordings, low-passed as everywhere; their torques play no part. The model is that of
    the recording, so that what acts in it alone counts as a difference: known loads too, but not the recording's clock.

    Args:
        model: that is written.
        to: "mjcf" or "urdf".
        recordings: files, or opened recordings.
        mapping: YAML file of other column names and units.
        cutoff_hz: band limit of the motion [Hz]; chosen from the data by default.

    Raises:
        OptionError: MuJoCo is not installed, or there is no recording.
        InputError: MuJoCo does not take the file.
        RecordingError: a recording that cannot be used.
    """
    if not recordings:
        raise OptionError("no recording to check on; give at least one")
    # Torques are compared, so that actuators take torques.
    file = written(RigidBodyDynamics(model.robot, model.pi, model.terms, model.rest_width, model.conditions), to)
    own, notes = _met_by_inverse_dynamics(model, in_time=to == "mjcf")
    opened = _opened(model, recordings, mapping)
    surveys = [survey(one) for one in opened]
    filtering = Filtering(choose_cutoff(surveys) if cutoff_hz is None else cutoff_hz)
    squares, samples = np.zeros((2, model.robot.n_dof)), 0
    for recording, seen in zip(opened, surveys, strict=True):
        for states in tiles(recording, seen, filtering, _ROWS):
            q, qd, qdd, tau = _sampled(own, states)
            squares += np.stack([(tau**2).sum(0), ((replayed(file, model.robot, q, qd, qdd) - tau) ** 2).sum(0)])
            samples += len(tau)
    torque, difference = np.sqrt(squares / samples).tolist()
    units = ["N" if slides else "N m" for slides in model.robot.prismatic.tolist()]
    rows = zip(model.robot.joint_names, units, torque, difference, strict=True)
    return FileCheck(tuple(JointCheck(*row) for row in rows), samples, filtering.cutoff_hz, notes)


def _opened(
    model: RigidBodyDynamics, recordings: Sequence[str | Path | Recording], mapping: str | Path | None
) -> list[Recording]:
    columns, names = None if mapping is None else read_mapping(mapping), model.robot.joint_names
    return [
        one.of_joints(names) if isinstance(one, Recording) else open_recording(one, names, mapping=columns)
        for one in recordings
    ]


def _met_by_inverse_dynamics(
    model: RigidBodyDynamics, *, in_time: bool
) -> tuple[RigidBodyDynamics, tuple[Remark, ...]]:
    """Return a model without the clocks of recordings, and notes.

    With ``in_time`` it is also without what the file holds in its actuators' course in time, and the notes say what
    that is.
    """
    aside = {id(term) for term in gather(model).in_time} if in_time else set()
    notes = tuple(
        Remark("not compared", {"term": described(term, model.robot)}) for term in model.terms if id(term) in aside
    )
    kept = [term for term in model.terms if id(term) not in aside]
    conditions = {name: one.without_clock() for name, one in model.conditions.items()}
    return RigidBodyDynamics(model.robot, model.pi, kept, model.rest_width, conditions), notes


def _sampled(model: RigidBodyDynamics, states: States) -> list[np.ndarray]:
    """Return q, qd, qdd and the model's torque at the outputs of a tile, (M, n_dof) each."""
    with torch.no_grad():
        warm = None if states.temperature is None else states.temperature.T
        tau = model(states.q.T, states.qd.T, states.qdd.T, states.t, warm, states.recording)
    at = torch.searchsorted(states.t, states.t_out.contiguous())
    return [x[at].numpy() for x in (states.q.T, states.qd.T, states.qdd.T, tau)]
