"""What a user should know of the input, above all what was left out; ``verdict.py`` has what is to be doubted."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress

import numpy as np
from torch import Tensor

from torchrbd.likelihood.block_statistics import BlockStatistics
from torchrbd.likelihood.columns import Columns
from torchrbd.likelihood.resting import at_rest
from torchrbd.likelihood.urdf_prior import Prior, unphysical_bodies
from torchrbd.recordings import Filtering, Survey, skipped_segments
from torchrbd.robot import STANDARD_GRAVITY


def input_notes(
    columns: Columns,
    surveys: Sequence[Survey],
    filtering: Filtering,
    prior: Prior,
    held: Sequence[str],
    without_torque: Tensor,
) -> tuple[str, ...]:
    """Return what the user should know of URDF and recordings, the recording's name first."""
    robot, notes = columns.robot, []
    for s in surveys:
        found = [*s.notes, *(f"the torque of {name} never changes and is not used" for name in s.constant_tau)]
        found += [
            f"{a:.3g} to {b:.3g} s left out: too short for the filters" for a, b in skipped_segments(s, filtering)
        ]
        notes += [note if note.startswith(s.name) else f"{s.name}: {note}" for note in found]
    warm = ~np.isnan([s.temperature_min for s in surveys])
    for s, known in zip(surveys, warm, strict=True):
        if lacked := [*compress(robot.joint_names, warm.any(0) & ~known)]:
            notes.append(f"{s.name}: no temperature of {', '.join(lacked)}, so that of others is not used there")
    silent = (name for name, none in zip(robot.joint_names, without_torque.tolist(), strict=True) if none)
    notes += [f"no recording has a torque that changes for {name}" for name in silent]
    notes += [
        f"the URDF's inertia of {body} is that of no extended body of its mass; the fit starts from the nearest that is"
        for body in unphysical_bodies(columns)
    ]
    if robot.gravity.tolist() != [*STANDARD_GRAVITY]:
        notes.append(f"gravity is ({', '.join(f'{x:.4g}' for x in robot.gravity.tolist())}) m/s^2 in the base's axes")
    known = [("rotors", robot.armature), ("springs", robot.stiffness)]
    if given := [name for name, values in known if bool(values.any())]:
        notes.append(
            f"{' and '.join(given)} of joints are those of {robot.description.source}; what is fitted or found of them "
            "comes on top, and nmse is of the torque that they leave"
        )
    massless = (n for b, n in enumerate(robot.body_names) if b not in prior.bodies and n not in held)
    return (
        *notes,
        *(f"{name} has no mass in the URDF and keeps none; give it a rough one if it has any" for name in massless),
    )


def rest_notes(training: BlockStatistics) -> list[str]:
    """Return which joints never move in the blocks that are fitted."""
    seen = training.torque[..., 0] > 0
    still = (at_rest(training) | ~seen).all(0) & seen.any(0)
    names = compress(training.columns.robot.joint_names, still.tolist())
    return [f"{name} does not move in these recordings: its friction stays that of the URDF" for name in names]
