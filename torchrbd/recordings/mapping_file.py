"""The YAML file of a mapping: its keys with their descriptions, checked, as a ``Mapping``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from torchrbd.errors import RecordingError
from torchrbd.recordings.checked_yaml import Keys, Number, check_key, checked, read_yaml, wrong
from torchrbd.recordings.drives import Drive
from torchrbd.recordings.mapping import CURRENT_UNITS, ESTIMATE, SIGNALS, TIME_UNITS, UNITS, Mapping, Source

_LONGEST_DELAY_S = 1.0


def _plain(unit: str) -> str:
    """Return a unit without spaces and signs: 'N m', 'N*m' and 'Nm' are one."""
    return unit.replace(" ", "").replace("*", "").replace("·", "")


def _unit(units: dict[str, float]) -> Any:
    """Return the pydantic type of a unit, in any spelling."""
    known = {_plain(name): name for name in units}

    def read(value: Any) -> str:
        if not isinstance(value, str) or _plain(value) not in known:
            raise wrong(f"unknown unit {value!r}; valid units are {', '.join(units)}")
        return known[_plain(value)]

    return Annotated[Literal[tuple(units)], BeforeValidator(read)]


def _not_zero(value: float) -> float:
    if value == 0:
        raise wrong("zero would erase the signal; leave it out, or give another number")
    return value


def _positive(value: float) -> float:
    if value <= 0:
        raise wrong(f"expected a number above 0, got {value:g}")
    return value


def _not_negative(value: float) -> float:
    if value < 0:
        raise wrong(f"expected 0 or more, got {value:g}")
    return value


def _sign(value: float) -> float:
    if abs(value) != 1:
        raise wrong(f"expected 1 or -1, got {value:g}; use scale for other factors")
    return value


def _column(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise wrong(f"expected a column's name, got {value!r}")
    return value


def _delay(value: float) -> float:
    if abs(value) > _LONGEST_DELAY_S:
        raise wrong(f"expected seconds, at most {_LONGEST_DELAY_S:g} either way, got {value:g}")
    return value


def _topic(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise wrong(f"expected a name such as /joint_states, got {value!r}")
    return value


def _episodes(value: Any) -> tuple[int, ...]:
    numbers = value if isinstance(value, list) else [value]
    if not numbers or any(isinstance(one, bool) or not isinstance(one, int) or one < 0 for one in numbers):
        raise wrong(f"expected numbers from 0 such as [0, 3], got {value!r}")
    return tuple(numbers)


def _joints(value: Any) -> Any:
    if not isinstance(value, dict):
        raise wrong(f"expected one key for each joint, got {value!r:.80}")
    for key in value:
        check_key(key)
    return value


def _damping(value: Any) -> Any:
    if value == ESTIMATE:
        raise wrong("it cannot be distinguished from viscous friction: leave kd out, and viscous friction includes it")
    return value


def _or_estimate(check: Any) -> Any:
    """Return the pydantic type of a number that passes a check, or of the word that leaves it to the data."""
    number: Any = Annotated[Number, AfterValidator(check), Tag("number")]
    word: Any = Annotated[Literal["estimate"], Tag("word")]
    return Annotated[number | word, Discriminator(lambda value: "word" if value == ESTIMATE else "number")]


Column = Annotated[str, BeforeValidator(_column)]
Factor = Annotated[Number, AfterValidator(_not_zero)]


class Time(Keys):
    """The column of time."""

    missing: ClassVar[dict[str, str]] = {"column": "'column' is missing: the name of the column"}
    column: Column = Field(description="name of the column of time")
    unit: _unit(TIME_UNITS) = Field("s", description=f"unit of the column: {', '.join(TIME_UNITS)}")  # type: ignore[valid-type]


class Changes(Keys):
    """Conversion of a column to a signal: signal = sign * scale * unit * column / gear_ratio + offset.

    A torque is multiplied by the gear ratio instead.
    """

    sign: Annotated[Number, AfterValidator(_sign)] = Field(1.0, description="1, or -1 for the other direction")
    scale: Factor = Field(1.0, description="any other factor")
    offset: Number = Field(0.0, description="added last, in SI units of the joint")
    gear_ratio: Factor = Field(
        1.0, description="motor turns for one turn of the joint, where the column is the motor's: q = motor / ratio, "
        "tau = motor * ratio",
    )  # fmt: skip

    def factor(self) -> float:
        """Return the product of sign and scale."""
        return self.sign * self.scale


class Signal(Changes):
    """The column of a signal."""

    missing: ClassVar[dict[str, str]] = {"column": "'column' is missing: the name of the column"}
    column: Column = Field(description="name of the column; {joint} and {index} (from 0) are filled in")


def _signal(kind: str, words: str) -> type[Signal]:
    """Return the model of one kind of signal, with its units."""
    units = UNITS[kind]
    fields: dict[str, Any] = {
        "__annotations__": {"unit": _unit(units)},
        "unit": Field(next(iter(units)), description=f"unit of the column: {', '.join(units)}"),
        "__doc__": f"A column that holds {words}.",
        "__module__": __name__,
    }
    return type(words.title().replace(" ", ""), (Signal,), fields)


class Current(Changes):
    """The column of a motor's current, which gives a torque: tau = current * torque_constant * gear_ratio."""

    missing: ClassVar[dict[str, str]] = {
        "torque_constant": "a current needs its torque_constant [N m / A]",
        "current": "'current' is missing: the name of its column",
    }
    current: Column = Field(description="name of the column of the current; {joint} and {index} are filled in")
    torque_constant: _or_estimate(_not_zero) = Field(  # type: ignore[valid-type]
        description="torque of the motor for one ampere [N m / A]; or estimate"
    )
    unit: _unit(CURRENT_UNITS) = Field("A", description="unit of the current: A, mA")  # type: ignore[valid-type]


def _form(value: Any) -> str:
    """Return the form in which a signal is written; no key of a file has such a name."""
    if isinstance(value, str):
        return "by name"
    return "by current" if isinstance(value, dict) and "current" in value else "by column"


def _one_of(kind: str, words: str) -> Any:
    by_name: Any = Annotated[Column, Tag("by name")]
    by_column: Any = Annotated[_signal(kind, words), Tag("by column")]
    forms = by_name | by_column
    if kind == "tau":
        forms = forms | Annotated[Current, Tag("by current")]
        return Annotated[forms, Discriminator(_form)]
    return Annotated[forms, Discriminator(lambda value: "by name" if isinstance(value, str) else "by column")]


class DriveKeys(Keys):
    """A position drive, whose torque is computed: tau = kp (q_ref - q) - kd qd, clipped to the limit."""

    missing: ClassVar[dict[str, str]] = {"kp": "a drive needs its stiffness kp [N m/rad], or 'kp: estimate'"}
    kp: _or_estimate(_positive) = Field(description="stiffness [N m/rad, N/m]; or estimate")  # type: ignore[valid-type]
    kd: Annotated[Number, BeforeValidator(_damping), AfterValidator(_not_negative)] = Field(
        0.0, description="damping [N m s/rad, N s/m]"
    )
    limit: Annotated[Number, AfterValidator(_positive)] | None = Field(
        None, description="greatest torque or force of either sign [N m, N]; none by default"
    )


class Joint(Keys):
    """The signals of one joint; a signal without an entry is read from the column <signal>_<joint>."""

    q: _one_of("q", "a position") | None = Field(None, description="position")  # type: ignore[valid-type]
    qd: _one_of("qd", "a velocity") | None = Field(None, description="velocity")  # type: ignore[valid-type]
    qdd: _one_of("qdd", "an acceleration") | None = Field(None, description="acceleration")  # type: ignore[valid-type]
    tau: _one_of("tau", "a torque") | None = Field(  # type: ignore[valid-type]
        None, description="torque or force of the joint, measured or from a motor's current"
    )
    q_ref: _one_of("q_ref", "a set point") | None = Field(None, description="set-point")  # type: ignore[valid-type]
    q_link: _one_of("q_link", "a link position") | None = Field(  # type: ignore[valid-type]
        None, description="position from an encoder behind the gear"
    )
    temperature: _one_of("temperature", "a temperature") | None = Field(  # type: ignore[valid-type]
        None, description="temperature of the joint"
    )
    drive: DriveKeys | None = Field(
        None, description="position drive that follows q_ref, in place of tau: its torque is computed"
    )

    @model_validator(mode="after")
    def _one_torque(self) -> Joint:
        if self.drive is not None and self.tau is not None:
            raise wrong("give 'tau' or 'drive', not both: a drive's torque is computed from its set-point")
        return self


class MappingFile(Keys):
    """The columns and units of a recording."""

    time: Annotated[Annotated[Column, Tag("by name")] | Annotated[Time, Tag("by column")], Discriminator(_form)] = (
        Field("t", description="column of time; may be just its name")
    )
    joints: Annotated[dict[str, Joint], BeforeValidator(_joints)] = Field(
        default_factory=dict,
        description="signals of each joint; the joint '*' is every joint without an entry of its own",
    )
    topic: Annotated[str, BeforeValidator(_topic)] | None = Field(
        None, description="topic of a ROS bag or of a PlotJuggler export, if it has several"
    )
    episodes: Annotated[tuple[int, ...], BeforeValidator(_episodes)] | None = Field(
        None, description="episodes of a LeRobot data set, numbered from 0; all by default"
    )
    torque_delay: Annotated[Number, AfterValidator(_delay)] = Field(
        0.0,
        description="delay of torques relative to the positions that they belong to [s]; below 0: early",
    )
    set_point_delay: Annotated[Number, AfterValidator(_delay)] = Field(
        0.0,
        description="time after which drives follow a set-point that was recorded [s]; below 0: it was recorded late",
    )


KEYS = frozenset(
    key for model in (MappingFile, Time, Signal, Current, DriveKeys, Joint) for key in (*model.model_fields, "unit")
)
"""Every key that a mapping can have."""


def read_mapping(path: str | Path) -> Mapping:
    """Read and check a mapping; ``torchrbd schema mapping`` prints its keys with their descriptions.

    `time: {column, unit}` is the column of time. `joints: {<joint>: {<signal>: {column, unit, sign, scale, offset,
    gear_ratio}}}` are those of the joints. The signals are q, qd, qdd, tau, q_ref (set-point), q_link (encoder behind
    the gear) and temperature. A signal may be just the column's name.

    The joint "*" is every joint without an entry of its own. `{joint}` and `{index}` (from 0) in a column's name are
    filled in. A gear ratio means that the column is the motor's: `q = motor / gear_ratio`, `tau = motor * gear_ratio`.
    A torque may come from a current: `{current, torque_constant, unit, gear_ratio, sign, offset}`, `tau = current *
    torque_constant * gear_ratio`. Offsets are added last, in SI units of the joint.

    `drive: {kp, kd, limit}` in place of `tau` is a position drive that follows `q_ref`. Its torque is computed.
    `kp: estimate` and `torque_constant: estimate` leave these to `identify` and `diagnose`.

    `topic` chooses a topic of a ROS bag or PlotJuggler export, `episodes: [0, 3]` those of a LeRobot data set.
    `torque_delay: 0.004` is the delay [s] of written torques relative to the positions that they belong to; it is
    negative if torques are early. `set_point_delay: 0.004` is the time after which drives follow a set-point.

    Raises:
        RecordingError: names the file, the line, the key and the closest valid one.
    """
    path = Path(path)
    content = read_yaml(path, "cannot read the mapping: {reason}; name a YAML file", RecordingError)
    found = checked(MappingFile, content, path, RecordingError)
    joints = {
        name: {signal: _source(getattr(one, signal), signal) for signal in SIGNALS if getattr(one, signal) is not None}
        for name, one in found.joints.items()
    }
    time = Source(found.time) if isinstance(found.time, str) else Source(found.time.column, TIME_UNITS[found.time.unit])
    drives = {name: _drive(one.drive) for name, one in found.joints.items() if one.drive is not None}
    return Mapping(
        str(path), time, joints, found.topic, found.episodes, found.torque_delay, found.set_point_delay, drives
    )


def _drive(keys: DriveKeys) -> Drive:
    kp = math.nan if keys.kp == ESTIMATE else keys.kp
    return Drive(kp, keys.kd, math.inf if keys.limit is None else keys.limit)


def _source(entry: Any, signal: str) -> Source:
    """Return the source of a signal, with all factors in one."""
    if isinstance(entry, str):
        return Source(entry)
    if isinstance(entry, Current):
        known = entry.torque_constant != ESTIMATE
        scale = entry.factor() * (entry.torque_constant if known else 1.0) * CURRENT_UNITS[entry.unit]
        return Source(entry.current, scale * entry.gear_ratio, entry.offset, is_current=True, is_known=known)
    scale = entry.factor() * UNITS[signal][entry.unit]  # type: ignore[attr-defined]
    scale = scale * entry.gear_ratio if signal == "tau" else scale / entry.gear_ratio
    return Source(entry.column, scale, entry.offset)
