"""Identify each recording on its own, into a folder of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import partial
from math import nan
from pathlib import Path
from typing import Any

from rich.console import Console

from torchrbd.cli.progress import progress_bar
from torchrbd.cli.tables import print_each
from torchrbd.errors import InputError, OptionError, reason
from torchrbd.inference import Identification
from torchrbd.inference.many import identify_and
from torchrbd.outputs import OutputFolder, inside
from torchrbd.report.files import IDENTIFIED, REPORT, write_files


@dataclass(frozen=True)
class Brief:
    """What the table says of an identification: its verdict, and the mean nmse of the URDF and of the last model."""

    verdict: str
    before: float
    after: float


_FAILED = Brief("failed", nan, nan)


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

    Raises:
        OptionError: two recordings for one folder, or one for none inside the output folder.
        InputError: some could not be identified; it says which and why, the others are done.
    """
    _check_stems(recordings)
    for file in recordings:
        _folder_of(output, file)
    into = partial(_write_brief, output)
    with OutputFolder(output), progress_bar(quiet=quiet) as progress:
        found = identify_and(into, robot, recordings, "identify", options, jobs=jobs, progress=progress)
    pairs = list(zip(recordings, found, strict=True))
    print_each((file.name, *astuple(one.value or _FAILED), one.seconds) for file, one in pairs)
    failed = [(file, one.error) for file, one in pairs if one.error is not None]
    if len(failed) < len(found):
        words = f"wrote {', '.join(IDENTIFIED)} and {REPORT} to {output}/<recording>"
        Console(highlight=False, soft_wrap=True).print(words, markup=False)
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
    return Brief(result.verdict, before, after)


def _reason(file: Path, error: Exception) -> str:
    """Say why a recording failed; an error that was foreseen says it in its own words, most name the file."""
    words = reason(error)
    return words if str(file) in words else f"{file}: {words}"
