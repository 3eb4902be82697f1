"""Statistics of many recordings: a file each, made by one process or by all that ``torchrun`` has started."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from torchrbd._runtime.outputs import check_file
from torchrbd._runtime.ranks import Ranks
from torchrbd._runtime.threads import single_threaded
from torchrbd.dataset.reading import Progress
from torchrbd.errors import InputError, OptionError
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.settings import Settings
from torchrbd.inference.statistics import merging
from torchrbd.inference.statistics.building import conditions, payload_words, statistics_of
from torchrbd.inference.statistics.files import read_head, write_file
from torchrbd.inference.statistics.results import Conditions, Statistics
from torchrbd.options import Names, Payload, given
from torchrbd.recordings import NamedSource
from torchrbd.recordings.contents import digest
from torchrbd.recordings.formats.opening import STATISTICS
from torchrbd.robot import RobotModel


@single_threaded()
def write_statistics(
    robot: RobotModel | str | Path | bytes,
    recordings: Sequence[str | Path] | str | Path,
    folder: str | Path,
    *,
    merged: str | Path | None = None,
    ranks: Ranks | None = None,
    time: str | tuple[float, float] | None = None,
    joints: Names | None = None,
    effects: Names | None = None,
    exclude: Names = (),
    gravity: Sequence[float] | None = None,
    payload: Sequence[Payload | str] | Payload | str = (),
    mapping: str | Path | None = None,
    cutoff_hz: float | None = None,
    encoder_noise: float | Mapping[str, float] | None = None,
    progress: Progress = lambda *_: None,
) -> list[Path]:
    """Stream recordings into files of second moments, which ``identify`` takes in place of them.

    A file that is there, of the same recording, options and format, is left as it is: an interrupted call goes on
    where it was. Memory does not grow with the recordings.

    Args:
        robot: a robot or its URDF; its kinematics count, its inertias do not.
        recordings: files or folders.
        folder: for ``<recording>.stats``.
        merged: file for the moments of all recordings together, as ``merge_statistics`` would write it.
        ranks: processes that share the work; this one alone if not given.
        time: use only this part of each recording, FROM:TO [s] from its start, e.g. 2:30. In Python, text or a pair of
            numbers. Default: all.
        joints: joints whose torque counts, by name. Default: all.
        effects: effects to fit (``diagnose``: to search among), by id at all their places, or as EFFECT@PLACE. A place
            is a joint, a pair such as joint3_joint1, or a link. EFFECT@PLACE@RECORDING=FROM:TO [s] acts for a time
            only. In Python, ``torchrbd.known_effects()`` lists the ids, and [] is the rigid body alone. Default: of
            ``diagnose`` all, of ``compare_estimators`` none, else viscous and Coulomb friction and a torque offset.
        exclude: effects not to use, by id. Default: none.
        gravity: acceleration in the base's axes, X Y Z [m/s^2], e.g. 0 9.81 0 for an arm on a wall. In Python, only
            with a robot that is given by its URDF. Default: 0 0 -9.81.
        payload: known loads, FILE=kg,x,y,z[@LINK]: mass [kg] and centre of mass [m] in the frame of a link. In Python,
            text or ``torchrbd.inference.Payload``. Default: none; of a chain, the link is the last one.
        mapping: YAML file with other column names, units, signs, gear ratios or torque constants. Default: columns t,
            q_<joint>, tau_<joint> in SI units.
        cutoff_hz: band limit of torque and features [Hz]. Default: chosen from the data.
        encoder_noise: standard deviation of the positions [rad, m], one number or JOINT=number for each. In Python, a
            number or {joint: number}. Default: estimated.
        progress: called with how many are done, the rate, and the part of the work that is done.

    Returns:
        the files, in the order of the recordings.

    Raises:
        InputError: a robot, recording or option that cannot be used, or a place for the sum that cannot be written.
    """
    robot, sources, settings = read_arguments(robot, recordings, given(locals()), "stats")
    if not sources:
        raise OptionError("stats: no recording; give at least one")
    made, ranks, folder = conditions(robot, settings), ranks or Ranks(), Path(folder)
    paths = [_path(source) for source in sources]
    _check_names(paths)
    _check_payloads(paths, settings)
    if merged is not None:
        check_file(Path(merged))
    files = [folder / f"{path.name}{STATISTICS}" for path in paths]
    for file in files:
        check_file(file)
    own = ranks.own(list(zip(paths, files, strict=True)))
    tell = _progress_of(progress, len(own))
    for k, (path, file) in enumerate(own):
        if not _is_up_to_date(file, path, made, settings):
            write_file(statistics_of(robot, path, settings, made, _part_of(tell, k)), file)
        tell(k + 1.0, _rows(file))
    if merged is not None:
        write_merged(files, Path(merged), ranks)
    else:
        ranks.wait()
    return files


def merge_statistics(files: Sequence[str | Path], output: str | Path) -> Statistics:
    """Add statistics files and write them as one, with no more blocks than a fit looks at.

    Raises:
        InputError: a file that cannot be read, or files that were made under different conditions.
        OptionError: the sum cannot be written there.
    """
    heads = [read_head(file) for file in files]
    if any(Path(output).exists() and Path(output).samefile(file) for file in files):
        raise OptionError(f"output '{output}': is one of the files to add; name another for the sum")
    check_file(Path(output))
    found = merging.merged(heads)
    write_file(found, output)
    return found


def write_merged(files: Sequence[Path], output: Path, ranks: Ranks) -> None:
    """Write the sum of the files of all processes, each of which reads its own; the moments go through an all-reduce.

    Every block is filled by one process and zero in the others, so that sums are exact, whatever the number of them.
    """
    own = frozenset(ranks.own(range(len(files))))
    every = {k: head for part in ranks.gathered({k: read_head(files[k]) for k in own}) for k, head in part.items()}
    found = merging.merged([every[k] for k in sorted(every)], own)
    *moments, torque = map(ranks.summed, (*found.moments, found.torque))
    if ranks.first:
        write_file(replace(found, moments=tuple(moments), torque=torque), output)
    ranks.wait()


def _path(source: NamedSource) -> Path:
    if not isinstance(source, Path):
        raise OptionError(f"stats: '{source.name}' lies in memory; statistics are made of files")
    if source.suffix == STATISTICS:
        raise OptionError(f"stats: {source} holds statistics already; give recordings")
    if not source.exists():
        raise OptionError(f"stats: {source}: no such file; check the path")
    return source


def _check_names(paths: Sequence[Path]) -> None:
    seen: dict[str, Path] = {}
    for path in paths:
        other = seen.setdefault(path.name.casefold(), path)
        if other is path:
            continue
        if path.exists() and path.samefile(other):
            raise OptionError(f"'{path}' is given twice; give it once")
        else:
            raise OptionError(f"statistics of '{other}' and '{path}' would be one file; rename one of them")


def _check_payloads(paths: Sequence[Path], settings: Settings) -> None:
    for one in settings.payload:
        if one.recording not in [path.name for path in paths]:
            raise OptionError(f"payload for '{one.recording}', which is no recording here")


def _is_up_to_date(file: Path, recording: Path, made: Conditions, settings: Settings) -> bool:
    """Say whether a file is what would be made of a recording now."""
    if not file.is_file():
        return False
    try:
        head = read_head(file)
    except InputError:
        return False
    if head.conditions != made or len(head.origins) != 1:
        return False
    (origin,) = head.origins
    return (origin.name, origin.payload, (origin.size, origin.sha256)) == (
        recording.name,
        payload_words(recording.name, settings),
        digest(recording),
    )


def _rows(file: Path) -> int:
    return sum(one.rows for one in read_head(file).origins)


def _progress_of(progress: Progress, total: int) -> Callable[[float, int], None]:
    """Return a callback for the progress: recordings done (with parts), and rows since the last call."""
    start, rows = time.perf_counter(), 0

    def tell(done: float, more: int) -> None:
        nonlocal rows
        rows += more
        rate = rows / max(time.perf_counter() - start, 1e-9)
        words = f"{int(done)} of {total} recordings" + (f", {rate / 1e3:.0f} thousand rows/s" if rows else "")
        progress(words, min(done / max(total, 1), 1.0))

    return tell


def _part_of(tell: Callable[[float, int], None], k: int) -> Progress:
    return lambda _, part: tell(k + 0.99 * part, 0)
