"""Open the recordings of one job: those to fit, then those held out as a whole, and a simulator's of the same."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from torchrbd.errors import OptionError, RecordingError
from torchrbd.inference.settings import Settings
from torchrbd.recordings import (
    Data,
    InMemory,
    NamedSource,
    Recording,
    RecordingSource,
    listed_sources,
    open_recording,
    read_mapping,
)
from torchrbd.robot import RobotModel


def open_all(
    robot: RobotModel, recordings: Sequence[RecordingSource | InMemory], settings: Settings
) -> tuple[Recording, ...]:
    """Open recordings with the robot's joints in its order, cut to the time that the settings ask for.

    Args:
        robot: the robot.
        recordings: files, opened recordings or data in memory to fit.
        settings: say which others to hold out, how to read columns, and which part of the time counts.

    Returns:
        those to fit in the order given, then those held out.

    Raises:
        RecordingError: a file or data that cannot be used, or two recordings of one name.
        OptionError: nothing to fit, or the same both fitted and held out.
    """
    mapping = read_mapping(settings.mapping) if settings.mapping else None

    def opened(source: NamedSource) -> Recording:
        if isinstance(source, Recording):
            return source.of_joints(robot.joint_names, settings.time)
        data, name = _named(source)
        return open_recording(data, robot.joint_names, mapping=mapping, time=settings.time, name=name)

    fitted = listed_sources(recordings)
    if not fitted:
        raise OptionError("no recording to fit; give at least one")
    both = {_same(source): _words(source) for source in settings.holdout if _same(source) in map(_same, fitted)}
    if both:
        raise OptionError(f"{', '.join(sorted(both.values()))} is both fitted and held out; leave it out of one list")
    for k, source in enumerate(fitted):
        for other in fitted[:k]:
            if isinstance(source, InMemory) and _same(source) == _same(other):
                raise RecordingError(f"{_words(other)} and {_words(source)} are the same data; give them once")
            if isinstance(source, Path) and isinstance(other, Path) and source.resolve() == other.resolve():
                raise RecordingError(f"'{other}' is given twice; give it once")
    found = [*map(opened, fitted), *map(opened, settings.holdout)]
    names = [r.name for r in found]
    for k, name in enumerate(names):
        if name in names[:k]:
            parents = [str(r.path or r.name) for r in found if r.name == name]
            raise RecordingError(
                f"two recordings are called '{name}' ({', '.join(parents)}); rename one, results refer to them by name"
            )
    return tuple(found)


def have_drives(sources: Sequence[NamedSource], settings: Settings) -> bool:
    """Return whether joints have drives, whose torque is computed from set-points.

    Raises:
        RecordingError: a mapping that cannot be read.
    """
    opened = any(isinstance(source, Recording) and source.drives.of for source in sources)
    return opened or bool(settings.mapping and read_mapping(settings.mapping).drives)


def open_simulated(robot: RobotModel, settings: Settings, recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Open the simulator's recordings, one for each real one; none if the settings name none.

    Their columns are called as in the README, or as the settings' mapping has them.

    Raises:
        RecordingError: a file that cannot be used.
        OptionError: more or fewer than there are real ones.
    """
    given = settings.simulated
    if given and len(given) != len(recordings):
        raise OptionError(
            f"{len(given)} simulated recordings for {len(recordings)} real ones "
            f"({', '.join(r.name for r in recordings)}); give one for each, those of held-out recordings last"
        )

    def opened(source: NamedSource) -> Recording:
        if isinstance(source, Recording):
            return source.of_joints(robot.joint_names)
        data, name = _named(source)
        try:
            return open_recording(data, robot.joint_names, name=name)
        except RecordingError:
            if settings.mapping is None:
                raise
            return open_recording(data, robot.joint_names, mapping=read_mapping(settings.mapping), name=name)

    return tuple(map(opened, given))


def _named(source: Path | InMemory) -> tuple[Path | Data, str | None]:
    """Return what to open, and its name if it has one that is not its file's."""
    return (source.data, source.name) if isinstance(source, InMemory) else (source, None)


def _same(source: NamedSource) -> str | int:
    """Return what identifies a recording: its file, its data, or the name of one that has been opened."""
    return id(source.data) if isinstance(source, InMemory) else _words(source)


def _words(source: NamedSource) -> str:
    """Return what a person calls a recording."""
    if isinstance(source, Recording):
        return str(source.path or source.name)
    return source.name if isinstance(source, InMemory) else str(source)
