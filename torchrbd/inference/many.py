"""Identify many robots, each from its own recordings, on every core.

What an identification spends its time on (noise, clocks and friction's signs, learnt in turns until they settle, each
robot with its own number of turns) is not work that can be stacked over robots; it is shared out to processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from torchrbd._runtime.processes import Attempt, side_by_side
from torchrbd.dataset.reading import Progress
from torchrbd.display import brief
from torchrbd.effects import Effect, known_effects, register
from torchrbd.errors import OptionError, RecordingError, UnfinishedError
from torchrbd.inference.data.bodies import check_masses
from torchrbd.inference.identification import Identification
from torchrbd.inference.identify import identify, read_arguments
from torchrbd.inference.ordinary import with_friction
from torchrbd.inference.settings import Settings
from torchrbd.options import Names, Payload, given
from torchrbd.recordings import InMemory, NamedSource, Recording, RecordingSource, Sources, listed_sources
from torchrbd.recordings.memory import is_data
from torchrbd.robot import RobotModel

Robot = RobotModel | str | Path | bytes
Value = TypeVar("Value")
Given = TypeVar("Given")
Task = TypeVar("Task")


@dataclass(frozen=True)
class Outcome:
    """What came of one of many identifications.

    Attributes:
        name: of its recording; of several, with commas between.
        identification: None if it failed.
        error: why it failed, as ``identify`` raises it; None if it did not.
        seconds: that it took.
    """

    name: str
    identification: Identification | None
    error: Exception | None
    seconds: float

    def __repr__(self) -> str:
        return brief(self, name=self.name, identification=self.identification, error=self.error, seconds=self.seconds)

    def result(self) -> Identification:
        """Return the identification, or raise the error."""
        if self.identification is None:
            raise self.error or RuntimeError(f"{self.name}: nothing was identified")
        return self.identification


def identify_many(
    robots: Robot | Sequence[Robot],
    recordings: Iterable[RecordingSource | Sequence[RecordingSource]] | RecordingSource,
    *,
    jobs: int | None = None,
    holdout: Sources = (),
    holdout_fraction: float = 0.25,
    time: str | tuple[float, float] | None = None,
    joints: Names | None = None,
    effects: Names | None = None,
    exclude: Names = (),
    gravity: Sequence[float] | None = None,
    trust: Names = (),
    payload: Sequence[Payload | str] | Payload | str = (),
    simulated: Sources = (),
    mapping: str | Path | None = None,
    cutoff_hz: float | None = None,
    estimator: str = "auto",
    encoder_noise: float | Mapping[str, float] | None = None,
    kappa: float = 3.0,
    seed: int = 0,
    time_limit: float | str | None = None,
    progress: Progress = lambda *_: None,
) -> list[Outcome]:
    """Identify many robots, or one robot many times, as ``identify(robot, recording, ...)`` does each.

    The work is shared out to processes, one a core; one recording is identified in this one alone. What cannot be used
    does not stop the others, and ``time_limit`` is for each:

        outcomes = torchrbd.identify_many("robot.urdf", files)
        models = {one.name: one.identification.model for one in outcomes if one.identification}
        reasons = {one.name: one.error for one in outcomes if one.error}

    Args:
        robots: a robot or its URDF, or one for each entry of ``recordings``.
        recordings: for each identification a recording, or a list of several; whatever ``identify``
            takes.
        jobs: processes in all. Default: one for each core that this process may use; give it where a container has
            fewer, or where memory is short: each takes 0.5 to 1 GB.
        holdout: recordings that no fit uses; the reported errors are those on them. In Python, files, opened recordings
            or data in memory. Default: none; a part of each recording is held out, see ``holdout_fraction``.
        holdout_fraction: without ``holdout``, the part of each recording that is held out, (0, 0.5]. Default: 0.25.
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
        trust: links whose inertia is not fitted again, by name. Default: none.
        payload: known loads, FILE=kg,x,y,z[@LINK]: mass [kg] and centre of mass [m] in the frame of a link. In Python,
            text or ``torchrbd.inference.Payload``. Default: none; of a chain, the link is the last one.
        simulated: recordings of a simulator with the same commands: one for each recording, then one for each of
            ``holdout``, in their order. The robot is compared with them in place of the URDF. Where the simulator has
            other inertials than the URDF, the difference is reported as inertial parameters. Default: none.
        mapping: YAML file with other column names, units, signs, gear ratios or torque constants. Default: columns t,
            q_<joint>, tau_<joint> in SI units.
        cutoff_hz: band limit of torque and features [Hz]. Default: chosen from the data.
        estimator: how parameters are estimated. In Python, ``torchrbd.estimators.ESTIMATORS`` lists the names. Default:
            auto.
        encoder_noise: standard deviation of the positions [rad, m], one number or JOINT=number for each. In Python, a
            number or {joint: number}. Default: estimated.
        kappa: weight of the URDF's inertia against the data, above 0. Default: 3.
        seed: which blocks of time are held out, a whole number. Default: 0.
        time_limit: seconds, or text such as 90s or 2min, after which the search ends; the best model so far is then
            fitted, judged, written and marked as unfinished. Reading, learning the noise and reporting are not cut
            short. Default: none.
        progress: called with how many have been identified, in this thread; an error that it raises ends the work.

    Returns:
        outcomes in the order of ``recordings``.

    Raises:
        OptionError, RobotError: an option, or a robot that is the same for all, that cannot be used; or another number
            of robots than of recordings.
    """
    single = isinstance(recordings, (str, Path, Recording)) or is_data(recordings)
    entries: Any = [recordings] if single else recordings
    several = [_named(sources, k) for k, sources in enumerate(entries)]
    names = [", ".join(one.name for one in sources) for sources in several]
    found = identify_and(_itself, robots, several, "identify_many", given(locals()), jobs=jobs, progress=progress)
    return [Outcome(name, one.value, one.error, one.seconds) for name, one in zip(names, found, strict=True)]


def identify_and(
    then: Callable[[Identification, Given], Value],
    robots: Robot | Sequence[Robot],
    recordings: Sequence[Given],
    place: str,
    options: Mapping[str, Any],
    *,
    jobs: int | None = None,
    progress: Progress = lambda *_: None,
) -> list[Attempt[Value]]:
    """Identify many, and in the same process do with each what is wanted of it.

    Args:
        then: does it; what it returns is all that comes back.
        place: is named in errors.
        options: of ``identify``, by name.
        robots, recordings, jobs, progress: as for ``identify_many``.
    """
    if isinstance(robots, Robot):
        robot, _, settings = read_arguments(robots, (), options, place)
        _check(settings, robot)
        options = {name: value for name, value in options.items() if name != "gravity"}
        each: list[Robot] = [robot] * len(recordings)
    else:
        each = list(robots)
        Settings.from_mapping(options, place)
        if len(each) != len(recordings):
            raise OptionError(
                f"{place}: {len(each)} robots for {len(recordings)} recordings; give one for all, or one for each"
            )
    work, on_result = WithEffects(partial(_identified, then, options)), counted(progress, len(recordings))
    return side_by_side(work, list(zip(each, recordings, strict=True)), jobs=jobs, on_result=on_result)


def _identified(
    then: Callable[[Identification, Given], Value], options: Mapping[str, Any], task: tuple[Robot, Given]
) -> Value:
    robot, sources = task
    return then(identify(robot, cast(Any, sources), **options), sources)


@dataclass(frozen=True)
class WithEffects(Generic[Task, Value]):
    """Work that knows, in any process, the effects that are known where it is made."""

    work: Callable[[Task], Value]
    known: tuple[Effect, ...] = field(default_factory=lambda: tuple(known_effects().values()))

    def __call__(self, task: Task) -> Value:
        for one in self.known:
            register(one)
        return self.work(task)


def counted(progress: Progress, total: int, before: str = "") -> Callable[[Attempt[Any]], None]:
    """Return a callback that reports, after the text ``before``, how many of so many have been identified."""
    counts = {"identified": 0, "failed": 0}

    def tell() -> None:
        failed = f", {counts['failed']} failed" if counts["failed"] else ""
        words = f"{before}identified {counts['identified']} of {total}{failed}"
        progress(words, sum(counts.values()) / max(1, total))

    def on_result(attempt: Attempt[Any]) -> None:
        if isinstance(attempt.error, UnfinishedError):
            return
        counts["identified" if attempt.error is None else "failed"] += 1
        tell()

    tell()
    return on_result


def _itself(identification: Identification, _: object) -> Identification:
    return identification


def _check(settings: Settings, robot: RobotModel) -> None:
    """Refuse at once what would be refused for every recording."""
    check_masses(robot)
    settings.used_joints(robot)
    settings.held_bodies(robot)
    settings.known_encoder_noise(robot)
    with_friction(settings)


def _named(sources: Any, k: int) -> list[NamedSource]:
    """Return an entry's recordings; one in memory is called by the entry's place, "recording 3"."""
    try:
        found = listed_sources(sources)
    except RecordingError as error:
        raise OptionError(f"identify_many: entry {k} of recordings: {error}") from None
    if len(found) == 1 and isinstance(found[0], InMemory):
        return [InMemory(f"recording {k + 1}", found[0].data)]
    return found
