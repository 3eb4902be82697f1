"""From a recording to its second moments, in two streaming passes: a survey, then the moments."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from torchrbd.dataset.columns import Columns
from torchrbd.dataset.reading import Progress, Reading
from torchrbd.dataset.scales import covered_scales
from torchrbd.effects import Effect, JointScale
from torchrbd.errors import OptionError
from torchrbd.inference.ordinary import with_friction
from torchrbd.inference.preparation import read
from torchrbd.inference.settings import Settings
from torchrbd.inference.statistics.results import Conditions, Origin, Statistics, known
from torchrbd.recordings import NamedSource, read_mapping
from torchrbd.recordings.contents import digest
from torchrbd.robot import RobotModel
from torchrbd.robot.identity import kinematics_sha256

# Two recordings that cover different ranges: an effect with a grid of shapes has another one for each.
_WIDE = JointScale(1.0, 1e-3, -1.0, 1.0, load_max=10.0, duration_s=60.0, temperature=(20.0, 30.0))
_NARROW = JointScale(0.3, 1e-2, 0.0, 0.4, load_max=3.0, duration_s=20.0, temperature=(15.0, 20.0))


def conditions(robot: RobotModel, settings: Settings) -> Conditions:
    """Return what moments will depend on.

    Raises:
        OptionError: an option that moments cannot have.
        RecordingError: a mapping that cannot be read.
    """
    if settings.cutoff_hz is None:
        raise OptionError(
            "statistics need --cutoff HZ, the same for all that are to be used together; 'torchrbd identify' on some "
            "of the recordings says which it chooses"
        )
    counts, mapping = settings.used_joints(robot).tolist(), settings.mapping
    if mapping is not None:
        read_mapping(mapping)
    return Conditions(
        robot=robot.name,
        kinematics_sha256=kinematics_sha256(robot),
        joints=robot.joint_names,
        gravity=tuple(robot.gravity.tolist()),
        cutoff_hz=settings.cutoff_hz,
        effects=tuple(e.id for e in moment_effects(settings)),
        used=tuple(name for name, one in zip(robot.joint_names, counts, strict=True) if one),
        time=settings.time,
        mapping_sha256=None if mapping is None else digest(mapping)[1],
        encoder_noise=known(settings.known_encoder_noise(robot)),
    )


def moment_effects(settings: Settings) -> tuple[Effect, ...]:
    """Return the effects that have columns.

    Raises:
        OptionError: one of them depends on the load, on a place, on the time or on what a recording covers.
    """
    placed = [text for text in settings.effects or () if "@" in text]
    if placed:
        raise OptionError(f"'{placed[0]}': moments have columns at every joint; name the effect without a place")
    found = with_friction(settings)
    loaded = [e.id for e in found if e.uses_load]
    if loaded:
        raise OptionError(f"{', '.join(loaded)}: depends on the load, which moments do not have; leave it out")
    shaped = [e.id for e in found if e.shapes(_WIDE) != e.shapes(_NARROW)]
    if shaped:
        raise OptionError(
            f"{', '.join(shaped)}: its shapes are sought in the range that a recording covers, so that moments of two "
            "recordings would be of other columns; leave it out, or identify from the recordings with another "
            "--estimator"
        )
    return found


def statistics_of(
    robot: RobotModel, source: NamedSource, settings: Settings, made: Conditions, progress: Progress
) -> Statistics:
    """Return the moments of one recording under conditions that have been checked."""
    own = replace(settings, holdout=(), simulated=(), payload=_own_payload(source, settings), cutoff_hz=made.cutoff_hz)
    reading, _ = read(robot, [source], own, progress)
    found = of_reading(reading, own, made, progress)
    (recording,), (origin,) = reading.recordings, found.origins
    if recording.path is None:
        return found
    size, sha256 = digest(recording.path)
    return replace(found, origins=(replace(origin, size=size, sha256=sha256),))


def of_reading(reading: Reading, settings: Settings, made: Conditions, progress: Progress) -> Statistics:
    """Return the moments of the one recording of a reading, whose content nobody asks for."""
    (recording,), (seen,) = reading.recordings, reading.surveys
    columns = Columns(reading.robot, moment_effects(settings), covered_scales(reading.surveys, reading.filtering))
    origin = Origin(
        name=recording.name,
        size=None,
        sha256=None,
        rows=seen.rows,
        duration_s=seen.duration_s,
        position_noise=tuple(seen.q_noise_std.tolist()),
        payload=payload_words(recording.name, settings),
        notes=seen.notes,
    )
    found = reading.statistics(columns, progress)
    place = str(recording.path or recording.name)
    return Statistics(
        made, (origin,), columns.scales, columns.labels_of_joint, found.blocks, found.moments, found.torque, place
    )


def payload_words(name: str, settings: Settings) -> tuple[str, ...]:
    """Return the known loads of a recording, in words."""
    return tuple(str(one) for one in settings.payload if one.recording == name)


def _own_payload(source: NamedSource, settings: Settings) -> tuple[Any, ...]:
    return tuple(one for one in settings.payload if one.recording == source.name)
