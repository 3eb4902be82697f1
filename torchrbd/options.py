"""The options that ``identify``, ``diagnose`` and similar functions share: names, types, defaults, texts and spelling.

This is the only place that defines them. Signatures, docstrings, the command line, the YAML file of ``--config`` and
its schema follow from it, or a test compares them with it. It imports little: ``torchrbd --help`` needs no torch for
it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

from torchrbd.errors import OptionError
from torchrbd.estimators import ESTIMATORS, check_estimators

Names: TypeAlias = Sequence[str] | str
"""One or several names."""
Source: TypeAlias = Any
"""A recording: a file, an opened recording, or data in memory."""

# Limits of plausible position noise [rad, m], and the lowest plausible band limit of a robot [Hz].
_LEAST_NOISE, _LARGEST_NOISE, _LEAST_CUTOFF_HZ = 1e-15, 1.0, 1e-3
# Upper limits of a load's mass [kg] and distance [m].
_HEAVIEST, _FURTHEST = 1e6, 1e3


@dataclass(frozen=True)
class Spelling:
    """Spelling of an option on the command line.

    Attributes:
        group: heading in ``--help``.
        metavar: name of its value.
        kind: type of one value.
        many: whether several values may follow.
        count: number of values that must follow, if not one.
        name: without leading dashes; empty for the field's own name, with dashes for underscores.
        choices: the allowed values; empty if there is no list.
    """

    group: str
    metavar: str
    kind: type = str
    many: bool = False
    count: int = 1
    name: str = ""
    choices: tuple[str, ...] = ()


def _spelt(group: str, metavar: str, kind: type = str, **more: Any) -> dict[str, Spelling]:
    return {"spelling": Spelling(group, metavar, kind, **more)}


@dataclass(frozen=True)
class Payload:
    """A known load on the robot in one recording: mass [kg] and centre of mass [m] in the frame of ``link``."""

    recording: str
    mass: float
    centre: tuple[float, float, float]
    link: str | None = None

    @classmethod
    def parse(cls, text: str) -> Payload:
        """Read ``FILE=kg,x,y,z`` or ``FILE=kg,x,y,z@LINK``."""
        name, _, numbers = text.rpartition("=")
        numbers, _, link = numbers.partition("@")
        try:
            mass, x, y, z = (float(part) for part in numbers.split(","))
        except ValueError:
            raise OptionError(f"payload '{text}': expected FILE=kg,x,y,z or FILE=kg,x,y,z@LINK") from None
        if not name or not 0.0 < mass <= _HEAVIEST or not math.hypot(x, y, z) <= _FURTHEST:
            raise OptionError(
                f"payload '{text}': expected FILE=kg,x,y,z with a mass above zero, at most {_HEAVIEST:g} kg, "
                f"within {_FURTHEST:g} m"
            )
        return cls(Path(name).name, mass, (x, y, z), link or None)


@dataclass(frozen=True)
class Options:
    """What a user may choose.

    Where several values are meant, one alone will do; text as on the command line is understood too ("2:30").

    Attributes:
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
    """

    holdout: tuple[Source, ...] = field(default=(), metadata=_spelt("Data", "FILE", Path, many=True))
    holdout_fraction: float = field(default=0.25, metadata=_spelt("Data", "X", float))
    time: tuple[float, float] | None = field(default=None, metadata=_spelt("Data", "FROM:TO"))
    joints: tuple[str, ...] | None = field(default=None, metadata=_spelt("Data", "JOINT", many=True))
    effects: tuple[str, ...] | None = field(default=None, metadata=_spelt("Model", "EFFECT", many=True))
    exclude: tuple[str, ...] = field(default=(), metadata=_spelt("Model", "EFFECT", many=True))
    gravity: tuple[float, ...] | None = field(default=None, metadata=_spelt("Model", "X Y Z", float, count=3))
    trust: tuple[str, ...] = field(default=(), metadata=_spelt("Model", "LINK", many=True))
    payload: tuple[Payload, ...] = field(default=(), metadata=_spelt("Data", "FILE=kg,x,y,z", many=True))
    simulated: tuple[Source, ...] = field(default=(), metadata=_spelt("Data", "FILE", Path, many=True))
    mapping: Path | None = field(default=None, metadata=_spelt("Data", "YAML", Path))
    cutoff_hz: float | None = field(default=None, metadata=_spelt("Data", "HZ", float, name="cutoff"))
    estimator: str = field(default="auto", metadata=_spelt("Model", "NAME", choices=tuple(ESTIMATORS)))
    encoder_noise: float | Mapping[str, float] | None = field(
        default=None, metadata=_spelt("Data", "[JOINT=]X", many=True)
    )
    kappa: float = field(default=3.0, metadata=_spelt("Model", "X", float))
    seed: int = field(default=0, metadata=_spelt("Model", "N", int))
    time_limit: float | None = field(default=None, metadata=_spelt("Model", "SECONDS"))

    def __post_init__(self) -> None:
        if not 0.0 < self.holdout_fraction <= 0.5:
            raise OptionError(f"holdout_fraction is {self.holdout_fraction:g}; expected a number in (0, 0.5]")
        if not 0.0 < self.kappa < math.inf:
            raise OptionError(f"kappa is {self.kappa:g}; expected a number above 0")
        check_estimators([self.estimator], tuple(ESTIMATORS))
        for joint, std in self._encoder_noise().items():
            if not _LEAST_NOISE <= std <= _LARGEST_NOISE:
                place = f" of {joint}" if joint else ""
                raise OptionError(
                    f"encoder_noise{place} is {std:g}; expected a standard deviation above 0 in rad or m, at most "
                    f"{_LARGEST_NOISE:g}"
                )
        if self.cutoff_hz is not None and not self.cutoff_hz >= _LEAST_CUTOFF_HZ:
            raise OptionError(f"cutoff is {self.cutoff_hz:g} Hz; expected at least {_LEAST_CUTOFF_HZ:g} Hz")
        if self.seed < 0:
            raise OptionError(f"seed is {self.seed}; expected a whole number that is not negative")

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of all options, in their order."""
        return tuple(f.name for f in fields(cls))

    def __repr__(self) -> str:
        changed = (f for f in fields(self) if getattr(self, f.name) != f.default)
        return f"{type(self).__name__}({', '.join(f'{f.name}={getattr(self, f.name)!r:.60}' for f in changed)})"

    def _encoder_noise(self) -> Mapping[str, float]:
        """Return the noise by joint; one value for all joints has an empty name."""
        if self.encoder_noise is None:
            return {}
        return self.encoder_noise if isinstance(self.encoder_noise, Mapping) else {"": self.encoder_noise}


def given(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options among the arguments of a function, which passes its ``locals()``."""
    return {name: arguments[name] for name in Options.names() if name in arguments}


def spelling(option: Field[Any]) -> Spelling:
    """Return the spelling of an option."""
    return option.metadata["spelling"]


def spelt(name: str) -> str:
    """Return an option's name on the command line and in YAML files, without leading dashes."""
    (option,) = (f for f in fields(Options) if f.name == name)
    return spelling(option).name or name.replace("_", "-")


@cache
def words() -> dict[str, str]:
    """Return the docstring's text for each option, by name."""
    _, _, listed = (Options.__doc__ or "").partition("Attributes:")
    entries = re.findall(r"^ {8}(\w+): (.+(?:\n {12}.+)*)", listed, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}


def plain_words(name: str) -> str:
    """Return the text for the command line and YAML files: without sentences about Python, options as spelt there."""
    sentences = re.split(r"(?<=\.) (?=[A-Z])", words()[name])
    text = " ".join(one for one in sentences if not one.startswith("In Python,"))
    return re.sub(r"``([\w.]+)``", lambda found: _plain(found[1]), text)


def _plain(name: str) -> str:
    if name in Options.names():
        return f"--{spelt(name)}"
    return name.rpartition(".")[2].replace("_", "-")
