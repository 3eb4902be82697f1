"""What ``torchrbd inspect`` does: look at a file, print what it holds, write a mapping."""

from __future__ import annotations

import math
from itertools import compress
from pathlib import Path

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from torchrbd._runtime.outputs import check_file, write_whole
from torchrbd.errors import OptionError
from torchrbd.recordings import Inspection, Mapping, inspect_recording, read_mapping
from torchrbd.recordings.mapping_text import mapping_text
from torchrbd.report.text.console import MAPPING_HINT, wrote
from torchrbd.report.text.numbers import number
from torchrbd.report.text.recordings import lacks_words, survey_words, unmatched_words
from torchrbd.robot import RobotModel


def inspect(file: Path, urdf: Path | None, mapping_file: Path | None, into: Path | None) -> None:
    """Print what a file holds, and write a mapping if a file is named.

    Raises:
        InputError: a file that cannot be read.
        OptionError: the mapping is there already.
    """
    if into is not None and into.exists() and not into.is_symlink():
        raise OptionError(f"'{into}' exists, and may have been edited; name another file for the mapping")
    if into is not None:
        check_file(into)
    robot = None if urdf is None else RobotModel.from_urdf(urdf)
    mapping = Mapping() if mapping_file is None else read_mapping(mapping_file)
    found = inspect_recording(file, robot, mapping)
    print_inspection(found, hint=into is None)
    if into is not None:
        sliding = () if robot is None else tuple(compress(robot.joint_names, robot.prismatic.tolist()))
        write_whole(into, mapping_text(found, mapping, sliding).encode())
        Console(highlight=False, soft_wrap=True).print(wrote(into), markup=False)


def print_inspection(found: Inspection, hint: bool = True) -> None:
    """Print clock, motion and channels of a recording, or the columns of a file that is none yet.

    Args:
        found: what a look at the file showed.
        hint: whether to mention that a mapping can be written.
    """
    out = Console(highlight=False)
    _print_clock(found, out)
    if found.recording is None:
        table = Table(Column("column", overflow="fold"), *map(_right, ("smallest", "largest")))
        for column, (low, high) in found.ranges.items():
            table.add_row(Text(column), *(("text or empty", "") if math.isnan(low) else (number(low), number(high))))
        out.print(table)
    else:
        _print_motion(found, out)
        _print_channels(found, out)
    if found.lacking:
        remedy = f"; {MAPPING_HINT}" if hint else ""
        out.print(Text.assemble(("problem:", "bold yellow"), " ", found.lacking, remedy), soft_wrap=True)
    for remark in found.remarks:
        out.print(Text.assemble(("warning:", "bold yellow"), " ", str(remark)))
    for note in found.survey.notes if found.survey is not None else ():
        out.print(f"note: {note}", markup=False)


def _print_clock(found: Inspection, out: Console) -> None:
    seen = found.survey
    words = unmatched_words(len(found.columns)) if seen is None else survey_words(seen, len(found.joints))
    out.print(Text.assemble((f"{found.name}:", "bold"), f" {words}"))


def _print_motion(found: Inspection, out: Console) -> None:
    columns = ("from", "to", "RMS speed", "reversals")
    table = Table(Column("joint", overflow="fold"), *map(_right, columns), "rich enough?")
    for one in found.motions:
        values = (number(one.low), number(one.high), number(one.speed_rms), str(one.reversals))
        table.add_row(Text(one.joint), *values, lacks_words(one))
    out.print(table)


def _print_channels(found: Inspection, out: Console) -> None:
    titles = ("smallest", "largest", "noise", "step", "missing")
    table = Table(Column("column", overflow="fold"), *map(_right, titles), "cut off")
    seen = found.survey
    steps = {} if seen is None else {"q": seen.q_resolution, "tau": seen.tau_resolution}
    for one in found.channels:
        step = float(steps[one.signal][found.joints.index(one.joint)]) if one.signal in steps else math.nan
        ends = [word for word, cut in (("below", one.clipped_low), ("above", one.clipped_high)) if cut]
        values = (number(one.low), number(one.high), number(one.noise_std), number(step), str(one.missing))
        table.add_row(Text(one.column), *values, " and ".join(ends))
    out.print(table)


def _right(title: str) -> Column:
    return Column(title, justify="right")
