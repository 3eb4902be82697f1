"""What a user should know of the input, above all what was left out; ``verdict.py`` has what is to be doubted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import compress

import numpy as np
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics
from torchrbd.dataset.columns import Columns
from torchrbd.dataset.resting import at_rest
from torchrbd.display import Remark
from torchrbd.likelihood.urdf_prior import Prior, unphysical_bodies
from torchrbd.recordings import Filtering, Survey, skipped_segments
from torchrbd.robot import STANDARD_GRAVITY, RobotModel


def input_notes(
    columns: Columns,
    surveys: Sequence[Survey],
    filtering: Filtering,
    prior: Prior,
    held: Sequence[str],
    without_torque: Tensor,
) -> tuple[Remark, ...]:
    """Return what the user should know of URDF and recordings."""
    silent = compress(columns.robot.joint_names, without_torque.tolist())
    return (
        *_recording_notes(columns.robot, surveys, filtering),
        *_torque_filter(filtering),
        *(Remark("no changing torque", {"joint": joint}) for joint in silent),
        *_robot_notes(columns, prior, held),
    )


def _recording_notes(robot: RobotModel, surveys: Sequence[Survey], filtering: Filtering) -> Iterator[Remark]:
    """Yield the notes on each recording, with its name."""
    for s in surveys:
        yield from (note.of(s.name) for note in s.notes)
        yield from (Remark("constant torque", {"joint": joint}, s.name) for joint in s.constant_tau)
        for begin, end in skipped_segments(s, filtering):
            yield Remark("left out", {"begin_s": float(begin), "end_s": float(end)}, s.name)
    warm = ~np.isnan([s.temperature_min for s in surveys])
    for s, known in zip(surveys, warm, strict=True):
        if lacked := [*compress(robot.joint_names, warm.any(0) & ~known)]:
            yield Remark("no temperature", {"joints": lacked}, s.name)


def _torque_filter(filtering: Filtering) -> Iterator[Remark]:
    """Yield what torques had passed before they were recorded."""
    if (passed := filtering.low_pass) is not None:
        yield Remark("torques low-passed", {"half_hz": passed.half_hz, "order": passed.order})


def _robot_notes(columns: Columns, prior: Prior, held: Sequence[str]) -> Iterator[Remark]:
    """Yield what to know of the URDF."""
    robot = columns.robot
    yield from (Remark("unphysical URDF inertia", {"body": body}) for body in unphysical_bodies(columns))
    if robot.gravity.tolist() != [*STANDARD_GRAVITY]:
        yield Remark("gravity", {"gravity": robot.gravity.tolist()})
    known = [("rotors", robot.armature), ("springs", robot.stiffness)]
    if given := [name for name, values in known if bool(values.any())]:
        yield Remark("known rotors or springs", {"parts": given, "source": robot.description.source})
    massless = (n for b, n in enumerate(robot.body_names) if b not in prior.bodies and n not in held)
    yield from (Remark("massless body", {"body": body}) for body in massless)


def rest_notes(training: BlockStatistics) -> list[Remark]:
    """Return which joints never move in the blocks that are fitted."""
    seen = training.torque[..., 0] > 0
    still = (at_rest(training) | ~seen).all(0) & seen.any(0)
    return [Remark("joint at rest", {"joint": j}) for j in compress(training.columns.robot.joint_names, still.tolist())]
