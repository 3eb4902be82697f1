"""Describe a file before a fit: joints, clock, channels, motion, and what looks wrong."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchrbd.display import Remark
from torchrbd.errors import RecordingError
from torchrbd.recordings.channels import Channel, channels_of
from torchrbd.recordings.formats.opening import open_table
from torchrbd.recordings.formats.table import Table
from torchrbd.recordings.layouts import with_layout
from torchrbd.recordings.mapping import Mapping
from torchrbd.recordings.matching import no_torque, torqueless
from torchrbd.recordings.motions import Motion, motions_of
from torchrbd.recordings.recording import Recording, connect
from torchrbd.recordings.survey import Survey, survey
from torchrbd.recordings.unit_suspicions import suspected_units
from torchrbd.robot import RobotModel

_ROWS = 16384
# A quantisation step is coarse above this fraction of the signal's range; a motion is short below this time [s].
_COARSE, _SHORT_S = 1 / 200, 10.0


@dataclass(frozen=True)
class Inspection:
    """The result of ``inspect_recording``.

    Attributes:
        name: the file's.
        columns: all of the table.
        joints: the robot's, or those in the columns' names.
        lacking: why the columns do not fit, with the remedy; empty if they do.
        recording, survey: None if the columns do not fit.
        channels, motions: of the joints; empty if the columns do not fit.
        units: by column, the unit that its values suggest.
        remarks: what looks wrong.
        ranges: by column, smallest and largest value, if the columns do not fit; NaN for those without numbers.
    """

    name: str
    columns: tuple[str, ...]
    joints: tuple[str, ...]
    lacking: str
    recording: Recording | None
    survey: Survey | None
    channels: tuple[Channel, ...]
    motions: tuple[Motion, ...]
    units: dict[str, str]
    remarks: tuple[Remark, ...]
    ranges: dict[str, tuple[float, float]]


def inspect_recording(path: Path, robot: RobotModel | None = None, mapping: Mapping | None = None) -> Inspection:
    """Inspect a file.

    Args:
        path: the file or folder.
        robot: for its joints and limits; without it, the joints are those in the columns' names.
        mapping: names of the columns, as far as known.

    Raises:
        RecordingError: it cannot be read, or nothing in it moves.
    """
    mapping = mapping or Mapping()
    table = open_table(path, mapping)
    mapping = with_layout(table.columns, mapping, str(path))
    joints = robot.joint_names if robot is not None else joints_named(table.columns, mapping)
    lacking = ""
    try:
        if not joints:
            raise RecordingError(f"{path}: no columns q_<joint>; present: {', '.join(table.columns)}")
        mapping.check_joints(joints)
        recording = connect(path.name, path, table, joints, mapping, None, torque=False)
    except RecordingError as error:
        return _unmatched(path, table, joints, str(error) + no_torque(table.columns))
    if not recording.measured.any():
        lacking = str(torqueless(path, table.columns))
    seen = survey(recording)
    channels = channels_of(recording, {"q": seen.q_resolution, "tau": seen.tau_resolution})
    motions = motions_of(recording, seen, robot)
    units = suspected_units(recording, seen, channels, robot)
    remarks = (*_of_units(units), *_of_channels(channels, seen), *_of_time(seen))
    return Inspection(
        path.name, table.columns, tuple(joints), lacking, recording, seen, channels, motions, units, remarks, {}
    )


def joints_named(columns: Sequence[str], mapping: Mapping) -> tuple[str, ...]:
    """Return the joints in the names of the columns of positions, in the file's order."""
    own = [joint for joint in mapping.joints if joint != "*"]
    every = mapping.joints.get("*", {}).get("q")
    pattern = re.escape(every.column) if every is not None and "{joint}" in every.column else re.escape("q_{joint}")
    named = re.compile(pattern.replace(re.escape("{joint}"), "(.+)"))
    found = [
        match[1] for match in map(named.fullmatch, columns) if match and not match[0].startswith(("q_ref_", "q_link_"))
    ]
    return tuple(dict.fromkeys([*found, *own]))


def _unmatched(path: Path, table: Table, joints: Sequence[str], lacking: str) -> Inspection:
    """Describe a table whose columns do not fit: the range of each."""
    ranges = {}
    for column in table.columns:
        low = high = math.nan
        with suppress(RecordingError):  # it holds text
            for block in table.batches([column], _ROWS):
                low, high = np.fmin(low, np.fmin.reduce(block[0])), np.fmax(high, np.fmax.reduce(block[0]))
        ranges[column] = float(low), float(high)
    return Inspection(path.name, table.columns, tuple(joints), lacking, None, None, (), (), {}, (), ranges)


def _of_units(units: dict[str, str]) -> list[Remark]:
    return [Remark("other unit", {"column": column, "unit": unit}) for column, unit in units.items()]


def _of_channels(channels: Sequence[Channel], seen: Survey) -> list[Remark]:
    """Return remarks about single channels."""
    found, steps = [], {"q": dict[str, float](), "tau": dict[str, float]()}
    for signal, resolution in (("q", seen.q_resolution), ("tau", seen.tau_resolution)):
        joints = list(dict.fromkeys(one.joint for one in channels))
        steps[signal] = dict(zip(joints, resolution.tolist(), strict=False))
    for one in channels:
        ends = [end for end, cut in ((one.low, one.clipped_low), (one.high, one.clipped_high)) if cut]
        if ends:
            found.append(Remark("cut off", {"column": one.column, "ends": ends}))
        step, span = steps.get(one.signal, {}).get(one.joint, math.nan), one.high - one.low
        if step > _COARSE * span > 0:
            found.append(Remark("coarse steps", {"column": one.column, "step": step, "steps": span / step}))
        if one.held_rows > 1:
            values = {"column": one.column, "rows": one.held_rows, "rate_hz": seen.rate_hz / one.held_rows}
            found.append(Remark("slow source", values))
        if one.high == one.low:
            found.append(Remark("constant column", {"column": one.column}))
    return found


def _of_time(seen: Survey) -> list[Remark]:
    found = []
    if seen.duration_s < _SHORT_S:
        found.append(Remark("short recording", {"seconds": seen.duration_s, "least_s": _SHORT_S}))
    if not seen.clock.regular:
        found.append(Remark("uneven times"))
    return found
