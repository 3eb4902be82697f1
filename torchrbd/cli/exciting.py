"""What ``torchrbd excite`` does: design a motion, print what it uses of its limits, write it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from torchrbd._runtime.outputs import check_file
from torchrbd.cli.progress import progress_bar
from torchrbd.errors import OptionError
from torchrbd.excitation import Excitation, excite
from torchrbd.export.motion_files import check_rate, series_of, write_motion
from torchrbd.report.text.console import clearance_words, condition_words, ends_words, motion_words, wrote
from torchrbd.report.text.numbers import number


def design(
    robot: Path,
    diagnosis: Path | None,
    file: Path,
    rate_hz: float,
    limits: Mapping[str, Sequence[str]],
    options: Mapping[str, Any],
    quiet: bool,
) -> None:
    """Design a motion, print and write it.

    Args:
        robot: its file.
        diagnosis: folder of one.
        file: CSV file to write.
        rate_hz: of its samples.
        limits: words such as "joint1=-1:1", by the argument of ``excite`` that they are for.
        options: other arguments of ``excite``, None where one was not given.
        quiet: do not say how far the work is.

    Raises:
        InputError: a robot, diagnosis or option that cannot be used.
    """
    if file.is_dir() or file.suffix.lower() != ".csv":
        raise OptionError(f"output '{file}' is no CSV file; name one, e.g. {file.with_suffix('') / 'motion.csv'}")
    for path in (file, series_of(file)):
        check_file(path)
    check_rate(rate_hz)
    given: dict[str, Any] = {name: value for name, value in options.items() if value is not None}
    given |= {
        "ranges": dict(_range("--range", word) for word in limits["ranges"]),
        "box": dict(_range("--box", word, ends=True) for word in limits["box"]),
        "velocities": dict(_value("--velocity", word) for word in limits["velocities"]),
        "efforts": dict(_value("--effort", word) for word in limits["efforts"]),
    }
    with progress_bar(quiet=quiet) as progress:
        result = excite(robot, diagnosis, progress=progress, **given)
    asked = {"diagnosis": diagnosis, "rate_hz": rate_hz, **given}
    series = write_motion(result, file, rate_hz, asked)
    print_motion(result, rate_hz)
    Console(highlight=False, soft_wrap=True).print(wrote(f"{file} and {series}"), markup=False)


def _parts(option: str, word: str, example: str) -> tuple[str, str]:
    name, equals, value = word.rpartition("=")
    if not (name and equals):
        raise OptionError(f"{option}: expected {example}, got '{word}'")
    return name, value


def _range(option: str, word: str, *, ends: bool = False) -> tuple[str, tuple[float, float]]:
    """Read NAME=LOW:HIGH; either end may be left out if ``ends``."""
    example = "AXIS=LOW:HIGH, e.g. z=0.05: or x=-0.4:0.6" if ends else "JOINT=LOW:HIGH, e.g. joint2=-1:1.5"
    name, value = _parts(option, word, example)
    low, colon, high = value.partition(":")
    try:
        found = tuple(float(text) if text or not ends else open_end for text, open_end in _ended(low, high))
    except ValueError:
        colon = ""
    if not colon:
        raise OptionError(f"{option}: expected {example}, got '{word}'")
    return name, found  # type: ignore[return-value]


def _ended(low: str, high: str) -> Iterable[tuple[str, float]]:
    return (low.strip(), -math.inf), (high.strip(), math.inf)


def _value(option: str, word: str) -> tuple[str, float]:
    """Read NAME=NUMBER."""
    example = "JOINT=NUMBER, e.g. joint2=1.5"
    name, value = _parts(option, word, example)
    try:
        return name, float(value)
    except ValueError:
        raise OptionError(f"{option}: expected {example}, got '{word}'") from None


def print_motion(result: Excitation, rate_hz: float) -> None:
    """Print length, condition numbers, what is used of the limits, and what it separates."""
    out = Console(highlight=False)
    words = motion_words(result.periods, result.motion.period_s, rate_hz)
    out.print(Text.assemble((f"{result.robot.name}:", "bold"), f" {words}"))
    out.print(condition_words(result.condition), soft_wrap=True)
    _print_uses(result, out)
    if math.isfinite(result.clearance):
        out.print(clearance_words(result.clearance))
    _print_separations(result, out)
    start = dict(zip(result.robot.joint_names, result.motion.start.tolist(), strict=True))
    out.print(ends_words(start), markup=False, soft_wrap=True)
    for note in result.notes:
        out.print(f"note: {note}", markup=False, soft_wrap=True)


def _print_uses(result: Excitation, out: Console) -> None:
    titles = ("from", "to", "of range", "speed", "of limit", "acceleration", "torque", "of limit")
    table = Table(Column("joint", overflow="fold"), *(Column(title, justify="right") for title in titles))
    for one in result.uses:
        values = (
            number(one.low),
            number(one.high),
            _percent(one.range_used),
            number(one.speed),
            _percent(one.speed_used),
        )
        rest = (number(one.acceleration), number(one.torque), _percent(one.torque_used))
        table.add_row(Text(one.joint), *values, *rest)
    out.print(table)


def _print_separations(result: Excitation, out: Console) -> None:
    if not result.separations:
        return
    titles = ("expected log Bayes factor", "probability before", "expected after")
    table = Table(Column("apart", overflow="fold"), *(Column(title, justify="right") for title in titles))
    for one in result.separations:
        after = f"{100.0 * one.probability_after:.3g} %"
        row = (f"{one.log_bayes_factor:.3g}", f"{100.0 * one.probability:.2g} %", after)
        table.add_row(Text(f"{one.one} | {one.other}"), *row)
    out.print(table)


def _percent(part: float) -> str:
    return "" if math.isnan(part) else f"{100.0 * part:.0f} %"
