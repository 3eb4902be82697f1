"""Open the recordings of one job: those to fit, then those held out as a whole, and a simulator's of the same."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from torchrbd.errors import OptionError, RecordingError
from torchrbd.inference.settings import Settings
from torchrbd.recordings import Recording, open_recording, read_mapping
from torchrbd.robot import RobotModel


def open_all(
    robot: RobotModel, recordings: Sequence[str | Path | Recording], settings: Settings
) -> tuple[Recording, ...]:
    """Open recordings with the robot's joints in its order, cut to the time that the settings ask for.

    Args:
        robot: the robot.
        recordings: files or opened recordings to fit.
        settings: say which others to hold out, how to read columns, and which part of the time counts.

    Returns:
        those to fit in the order given, then those held out.

    Raises:
        RecordingError: a file that cannot be used, or two recordings of one name.
        OptionError: nothing to fit, or a file both fitted and held out.
    """
    mapping = read_mapping(settings.mapping) if settings.mapping else None

    def opened(source: str | Path | Recording) -> Recording:
        if isinstance(source, Recording):
            return source.of_joints(robot.joint_names, settings.time)
        return open_recording(source, robot.joint_names, mapping=mapping, time=settings.time)

    if not recordings:
        raise OptionError("no recording to fit; give at least one")
    both = set(map(_file, recordings)) & set(map(_file, settings.holdout))
    if both:
        raise OptionError(f"{', '.join(sorted(both))} is both fitted and held out; leave it out of one list")
    found = [*map(opened, recordings), *map(opened, settings.holdout)]
    names = [r.name for r in found]
    for k, name in enumerate(names):
        if name in names[:k]:
            parents = [str(r.path or r.name) for r in found if r.name == name]
            raise RecordingError(
                f"two recordings are called '{name}' ({', '.join(parents)}); rename one, results refer to them by name"
            )
    return tuple(found)


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

    def opened(source: Path | Recording) -> Recording:
        if isinstance(source, Recording):
            return source.of_joints(robot.joint_names)
        try:
            return open_recording(source, robot.joint_names)
        except RecordingError:
            if settings.mapping is None:
                raise
            return open_recording(source, robot.joint_names, mapping=read_mapping(settings.mapping))

    return tuple(map(opened, given))


def _file(source: str | Path | Recording) -> str:
    """Return what tells a recording from others: its file, or the name of one that has none."""
    return str(source.path or source.name) if isinstance(source, Recording) else str(source)
