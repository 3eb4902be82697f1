"""Identify each recording on its own, into a folder of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import partial
from math import nan
from pathlib import Path
from typing import Any

from rich.console import Console

from torchrbd._runtime.outputs import OutputFolder, inside
from torchrbd._runtime.processes import Attempt
from torchrbd.cli.interrupts import finishing_on_interrupt
from torchrbd.cli.progress import progress_bar
from torchrbd.cli.tables import print_each
from torchrbd.errors import InputError, OptionError, UnfinishedError, reason
from torchrbd.inference import Identification
from torchrbd.inference.many import identify_and
from torchrbd.report.files import IDENTIFIED, REPORT, write_files
from torchrbd.report.text.console import not_begun, wrote


@dataclass(frozen=True)
class Brief:
    """What the table says of an identification: its verdict, and the mean nmse of the URDF and of the last model."""

    verdict: str
    before: float
    after: float


_FAILED, _NOT_BEGUN = Brief("failed", nan, nan), Brief("not begun", nan, nan)


def identify_each(
    robot: Path,
    recordings: Sequence[Path],
    output: Path,
    options: Mapping[str, Any],
    *,
    jobs: int | None,
    quiet: bool,
) -> None:
    """Identify each recording, write its results, and show all in a table.

    If the user interrupts, what is begun ends with what it has found, and the others are not begun.

    Raises:
        OptionError: two recordings for one folder, or one for none inside the output folder.
        InputError: some could not be identified; it says which and why, the others are done.
    """
    _check_stems(recordings)
    for file in recordings:
        _folder_of(output, file)
    into = partial(_write_brief, output)
    with finishing_on_interrupt(), OutputFolder(output), progress_bar(quiet=quiet) as progress:
        found = identify_and(into, robot, recordings, "identify", options, jobs=jobs, progress=progress)
    pairs = list(zip(recordings, found, strict=True))
    print_each((file.name, *astuple(_brief(one)), one.seconds) for file, one in pairs)
    left = [file for file, one in pairs if isinstance(one.error, UnfinishedError)]
    failed = [(file, one.error) for file, one in pairs if one.error is not None and file not in left]
    out = Console(highlight=False, soft_wrap=True)
    if any(one.value for one in found):
        out.print(wrote(f"{', '.join(IDENTIFIED)} and {REPORT}", f"{output}/<recording>"), markup=False)
    if left:
        out.print(not_begun(len(left), len(found)), markup=False)
    if failed:
        reasons = "".join(f"\n  {_reason(file, error)}" for file, error in failed)
        raise InputError(f"{len(failed)} of {len(found)} recordings could not be identified{reasons}")


def _check_stems(recordings: Sequence[Path]) -> None:
    """Refuse recordings whose results would lie in one folder.

    Raises:
        OptionError: two have the same name without its ending; both are named.
    """
    seen: dict[str, Path] = {}
    for file in recordings:
        other = seen.setdefault(file.stem.casefold(), file)
        if other is not file:
            raise OptionError(
                f"the results of '{other}' and '{file}' would both be written to the folder '{file.stem}'; "
                "rename one or give it in another call with another -o"
            )


def _folder_of(output: Path, recording: Path) -> Path:
    """Return the folder of a recording's results.

    Raises:
        OptionError: its name is none that a folder inside can have, or is that of a link.
    """
    try:
        return inside(output, recording.stem)
    except OptionError as error:
        raise OptionError(f"{recording}: {error}") from None


def _write_brief(folder: Path, result: Identification, recording: Path) -> Brief:
    with OutputFolder(_folder_of(folder, recording)) as into:
        into.fill(partial(write_files, result))
    before, *_, after = (fit.mean_nmse for fit in result.fits.values())
    return Brief(result.verdict if result.finished else f"{result.verdict} (unfinished)", before, after)


def _brief(one: Attempt[Brief]) -> Brief:
    """Return what the table says of an attempt."""
    return one.value or (_NOT_BEGUN if isinstance(one.error, UnfinishedError) else _FAILED)


def _reason(file: Path, error: Exception) -> str:
    """Say why a recording failed; an error that was foreseen says it in its own words, most name the file."""
    words = reason(error)
    return words if str(file) in words else f"{file}: {words}"
