"""Identify every robot of a fleet, a folder each, and compare them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from torchrbd._runtime.deadline import asked_for
from torchrbd._runtime.engines import Engine
from torchrbd._runtime.outputs import OutputFolder, inside, write_whole
from torchrbd.cli.interrupts import finishing_on_interrupt
from torchrbd.cli.progress import progress_bar
from torchrbd.dataset.reading import Progress
from torchrbd.errors import InputError, OptionError, UnfinishedError, reason
from torchrbd.export.json_files import write_fleet
from torchrbd.fleet.compare import compare_fleet
from torchrbd.fleet.results import UNFINISHED, FleetComparison
from torchrbd.inference import identify
from torchrbd.inference.many import WithEffects, counted
from torchrbd.inference.robots_file import RobotEntry, read_robots
from torchrbd.recordings.contents import digest
from torchrbd.report.files import IDENTIFIED, write_identified
from torchrbd.report.fleet import write_fleet_report
from torchrbd.report.text.console import more_words, wrote_fleet
from torchrbd.report.text.numbers import number

# The inputs of a robot's files, saved with them; this one is written last.
_MADE_FROM = "made_from.json"
# Of those files; it counts the changes after which results of before and after cannot be compared.
FORMAT = 1
# That the table names.
_MOST_ROBOTS = 40


def fleet(robots_file: Path, output: Path, before: Path | None, engine: Engine, quiet: bool) -> None:
    """Identify what is not identified yet, compare all, and show who differs.

    If the user interrupts, those that are identified are compared, and the next call identifies the others.

    Raises:
        InputError: some could not be identified; it says which and why, the others are done.
    """
    robots = read_robots(robots_file)
    _check_before(before, output)
    with (
        finishing_on_interrupt(),
        OutputFolder(output) as folder,
        progress_bar(time_left=True, quiet=quiet) as progress,
    ):
        failed, left = identify_fleet(robots, output, engine, progress)
        if len(failed) == len(robots):
            raise InputError(f"no robot could be identified{_reasons(failed)}")
        progress("comparing", 1.0)
        names = [one.name for one in robots]
        result = compare_fleet(output, names, before=before, failed=failed, left=left)
        folder.fill(partial(_write, result))
    failed = {one.name: one.error for one in result.members if one.error and one.verdict != UNFINISHED}
    _print(result)
    words = wrote_fleet(output)
    Console(highlight=False, soft_wrap=True).print(words, markup=False)
    if failed:
        raise InputError(f"{len(failed)} of {len(robots)} robots could not be identified{_reasons(failed)}")


def identify_fleet(
    robots: Sequence[RobotEntry], output: Path, engine: Engine, progress: Progress
) -> tuple[dict[str, str], list[str]]:
    """Identify those whose files are not there, or were made from something else.

    Returns:
        by name why some failed, and the names of those that the user's interrupt has left.
    """
    progress("looking at what is there", 0.0)
    failed: dict[str, str] = {}
    left: list[str] = []
    tasks: list[tuple[RobotEntry, str]] = []
    for one in robots:
        try:
            made_from = _made_from(one)
        except OSError as error:
            failed[one.name] = f"{error.filename}: {error.strerror}"
            continue
        if not _is_there(output / one.name, made_from):
            tasks.append((one, made_from))
    there = len(robots) - len(tasks) - len(failed)
    work, notable = (
        WithEffects(partial(_identify, output.absolute())),
        counted(progress, len(tasks), f"{there} there, "),
    )
    for (one, _), attempt in zip(tasks, engine.done(work, tasks, notable), strict=True):
        if isinstance(attempt.error, UnfinishedError):
            left.append(one.name)
        elif attempt.error is not None:
            failed[one.name] = reason(attempt.error)
    return failed, left


def _identify(output: Path, task: tuple[RobotEntry, str]) -> None:
    """Identify one robot and write its files.

    Raises:
        UnfinishedError: the user's interrupt has ended it early; the next call identifies it again.
    """
    entry, made_from = task
    folder = inside(output, entry.name)
    found = identify(entry.urdf, entry.recordings, **entry.options)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _MADE_FROM).unlink(missing_ok=True)
    write_identified(found, folder)
    if not found.finished and asked_for():
        raise UnfinishedError(f"{entry.name}: was ended early; identify it again")
    write_whole(folder / _MADE_FROM, made_from.encode())


def _made_from(entry: RobotEntry) -> str:
    """Return what a robot's results depend on, as JSON.

    Raises:
        OSError: a file cannot be read.
    """
    files = {"urdf": entry.urdf, **{f"recording {k}": path for k, path in enumerate(entry.recordings)}}
    options = {key: value for key, value in entry.options.items() if key != "mapping"}
    if "mapping" in entry.options:
        files["mapping"] = entry.options["mapping"]
    content = {
        "format": FORMAT,
        "options": options,
        "files": {key: [path.name, *digest(path)] for key, path in files.items()},
    }
    return json.dumps(content, indent=1, sort_keys=True, default=str)


def _is_there(folder: Path, made_from: str) -> bool:
    """Say whether a robot's files are all there, made from the same."""
    files = [folder / name for name in (*IDENTIFIED, _MADE_FROM)]
    return all(file.is_file() for file in files) and files[-1].read_bytes() == made_from.encode()


def _check_before(before: Path | None, output: Path) -> None:
    if before is None:
        return
    if not before.is_dir():
        raise OptionError(f"--before '{before}': expected the folder of an earlier 'torchrbd fleet -o'")
    if not any(before.glob(f"*/{IDENTIFIED[0]}")):
        raise OptionError(f"--before '{before}': holds no results of 'torchrbd fleet -o'; give the folder of some")
    if before.resolve() == output.resolve():
        raise OptionError(
            f"--before is the folder of -o, so that nothing could have changed; give the folder of an earlier time, "
            f"or another -o than '{output}'"
        )


def _write(result: FleetComparison, folder: Path) -> None:
    write_fleet(result, folder / "fleet.json")
    write_fleet_report(result, folder / "fleet.html")


def _print(result: FleetComparison) -> None:
    """Print the robots that differ, changed or failed."""
    out = Console(highlight=False)
    out.print(result.statement, markup=False)
    notable = [one for one in result.members if one.is_notable]
    table = Table(Column("robot", no_wrap=True), "verdict", Column("nmse", justify="right"), "what")
    for one in notable[:_MOST_ROBOTS]:
        table.add_row(Text(one.name), one.verdict, number(one.nmse), Text(one.statement, overflow="fold"))
    if notable:
        out.print(table)
    if len(notable) > _MOST_ROBOTS:
        out.print(more_words(len(notable) - _MOST_ROBOTS, "fleet.json"), markup=False)


def _reasons(failed: Mapping[str, str]) -> str:
    return "".join(f"\n  {name}: {why}" for name, why in failed.items())
