"""What a user may choose, checked against the robot and the recordings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchrbd.effects import Effect, effect, known_effects
from torchrbd.effects.told import ToldEffect
from torchrbd.errors import OptionError, closest
from torchrbd.estimators import ESTIMATORS, check_estimators
from torchrbd.inference.data.payload import Payload
from torchrbd.recordings import NamedSource, listed_sources
from torchrbd.robot import RobotModel

# Position noise beyond these is none [rad, m]; a lower band is that of no robot.
_LEAST_NOISE, _LARGEST_NOISE, _LEAST_CUTOFF_HZ = 1e-15, 1.0, 1e-3


@dataclass(frozen=True)
class Settings:
    """The options that ``identify``, ``diagnose`` and ``compare_estimators`` share, as keyword arguments.

    Where several are meant, one alone will do; text as on the command line is understood too ("2:30").

    Attributes:
        holdout: recordings (files, opened, or in memory) that no fit sees. Default: none, but
            ``holdout_fraction``.
        holdout_fraction: without ``holdout``, the part of each recording that is kept back, (0, 0.5]. Default: 0.25.
        time: use only this part of each recording, (from, to) [s] from its start. Default: all.
        joints: joints whose torque counts, by name. Default: all.
        effects: by id, at all their places, or as "id@place"; ``torchrbd.known_effects()`` lists the ids, a place is a
            joint, a pair "joint3_joint1" or a link. What acts for a time only is "id@place@recording=from:to" [s].
            ``identify`` fits them (default: viscous and Coulomb friction; ``[]`` for the rigid body alone), and so does
            ``compare_estimators`` (default: none); ``diagnose`` searches among them (default: all).
        exclude: effects not to use, by id. Default: none.
        gravity: in the base's axes, (x, y, z) [m/s^2], of a robot that is given by its URDF. Default: (0, 0, -9.81).
        trust: links whose inertia is not re-fitted, by name. Default: none.
        payload: known loads: ``torchrbd.inference.Payload`` or "FILE=kg,x,y,z[@LINK]" [kg, m]. Default: none.
        simulated: recordings of a simulator with the same commands, one for each recording and then for each of
            ``holdout``, in their order (files, opened, or in memory): they stand for the URDF in what is compared.
            Default: none.
        mapping: YAML file that maps other column names and units. Default: columns as in the README.
        cutoff_hz: band limit of torque and features [Hz]. Default: chosen from the data.
        estimator: of the parameters, one of ``torchrbd.estimators.ESTIMATORS``. Default: "auto".
        encoder_noise: standard deviation of the positions [rad, m], of all joints or {joint: std}. Default: estimated.
        kappa: weight of the URDF's inertia against the data, above 0 [-]. Default: 3.
        seed: which blocks are kept back, a whole number. Default: 0.
    """

    holdout: tuple[NamedSource, ...] = ()
    holdout_fraction: float = 0.25
    time: tuple[float, float] | None = None
    joints: tuple[str, ...] | None = None
    effects: tuple[str, ...] | None = None
    exclude: tuple[str, ...] = ()
    gravity: tuple[float, ...] | None = None
    trust: tuple[str, ...] = ()
    payload: tuple[Payload, ...] = ()
    simulated: tuple[NamedSource, ...] = ()
    mapping: Path | None = None
    cutoff_hz: float | None = None
    estimator: str = "auto"
    encoder_noise: float | Mapping[str, float] | None = None
    kappa: float = 3.0
    seed: int = 0

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
    def names(cls) -> frozenset[str]:
        """Return the names of all settings."""
        return frozenset(f.name for f in fields(cls))

    @classmethod
    def from_mapping(cls, options: Mapping[str, Any], place: str) -> Settings:
        """Read settings as a YAML file or keyword arguments give them; ``place`` is named in errors."""
        known = cls.names()
        for key in options:
            if key not in known:
                hint = closest(key, known) or f"known: {', '.join(sorted(known))}"
                raise OptionError(f"{place}: unknown setting '{key}'; {hint}")
        values = dict(options)
        for key, word in (("holdout", "held-out recording"), ("simulated", "simulated recording")):
            values[key] = tuple(listed_sources(values.get(key), word))
        for key in ("joints", "effects"):
            if values.get(key) is not None:
                values[key] = tuple(map(str, _listed(values[key])))
        for key in ("exclude", "trust"):
            values[key] = tuple(map(str, _listed(values.get(key))))
        values["payload"] = tuple(
            p if isinstance(p, Payload) else Payload.parse(str(p)) for p in _listed(values.get("payload"))
        )
        if values.get("gravity") is not None:
            values["gravity"] = _vector(values["gravity"], place)
        if values.get("time") is not None:
            values["time"] = _interval(values["time"], place)
        if values.get("mapping") is not None:
            values["mapping"] = Path(str(values["mapping"]))
        if "estimator" in values:
            values["estimator"] = str(values["estimator"])
        if values.get("encoder_noise") is not None:
            values["encoder_noise"] = _noise(values["encoder_noise"], place)
        for key, kind in (("cutoff_hz", float), ("holdout_fraction", float), ("kappa", float), ("seed", int)):
            if values.get(key) is not None:
                values[key] = _number(values[key], kind, key, place)
        return cls(**values)

    def told_effects(self) -> tuple[ToldEffect, ...]:
        """Return the effects that were named and not excluded, with their places.

        Raises:
            OptionError: an id is unknown.
        """
        excluded = {effect(name).id for name in self.exclude}
        told = (ToldEffect.parse(text) for text in self.effects or ())
        return tuple(one for one in told if one.effect.id not in excluded)

    def chosen_effects(self) -> tuple[Effect, ...]:
        """Return the effects to search for.

        Raises:
            OptionError: an id is unknown, or no effect is left.
        """
        told = {one.effect.id: one.effect for one in self.told_effects()}
        excluded = {effect(name).id for name in self.exclude}
        wanted = known_effects() if self.effects is None else told
        chosen = tuple(e for name, e in wanted.items() if name not in excluded)
        if not chosen:
            raise OptionError("no effect is left to look for; name others with 'effects' or exclude fewer")
        return chosen

    def used_joints(self, robot: RobotModel) -> Tensor:
        """Return (n_dof,) bool, the joints whose torque counts."""
        names = robot.joint_names if self.joints is None else self.joints
        _check_names(names, robot.joint_names, "joint", robot.name)
        return torch.tensor([name in names for name in robot.joint_names])

    def known_encoder_noise(self, robot: RobotModel) -> Tensor:
        """Return (n_dof,) standard deviations of the positions [rad, m]; NaN where they are to be estimated.

        Raises:
            OptionError: a joint that the robot lacks.
        """
        given = self._encoder_noise()
        _check_names((name for name in given if name), robot.joint_names, "joint", robot.name)
        everywhere = given.get("", math.nan)
        return torch.tensor([given.get(name, everywhere) for name in robot.joint_names], dtype=torch.float64)

    def _encoder_noise(self) -> Mapping[str, float]:
        """Return the noise by joint; that of all joints under the empty name."""
        if self.encoder_noise is None:
            return {}
        return self.encoder_noise if isinstance(self.encoder_noise, Mapping) else {"": self.encoder_noise}

    def held_bodies(self, robot: RobotModel) -> tuple[str, ...]:
        """Return the bodies that ``trust`` keeps; a link that is fixed to a body stands for the body."""
        body_of = {link.name: body for body, links in robot.folded.items() for link in links}
        _check_names(self.trust, tuple(body_of), "link", robot.name)
        return tuple(dict.fromkeys(body_of[name] for name in self.trust))


def _check_names(names: Iterable[str], known: tuple[str, ...], kind: str, robot: str) -> None:
    for name in names:
        if name not in known:
            raise OptionError(f"robot '{robot}' has no moving {kind} '{name}'; it has: {', '.join(known)}")


def _noise(value: Any, place: str) -> float | dict[str, float]:
    """Read a number, {joint: number}, or as the command line has it a list of 'number' or 'joint=number'."""
    if isinstance(value, Mapping):
        return {
            str(joint): float(_number(std, float, f"encoder_noise of {joint}", place)) for joint, std in value.items()
        }
    entries = [str(entry).rpartition("=")[::2] for entry in _listed(value)]
    noise = {joint: float(_number(std, float, "encoder_noise", place)) for joint, std in entries}
    if len(noise) < len(entries) or not noise or ("" in noise and len(noise) > 1):
        raise OptionError(
            f"{place}: encoder_noise {value}: expected one number for all joints or JOINT=number for some, each once"
        )
    return noise.get("", noise)


def _number(value: Any, kind: type[int] | type[float], key: str, place: str) -> int | float:
    if isinstance(value, bool):
        raise OptionError(f"{place}: {key} is {str(value).lower()}; expected a number")
    try:
        number = kind(value)
    except (TypeError, ValueError, OverflowError):
        raise OptionError(f"{place}: {key} is '{value}'; expected a number") from None
    if kind is int and number != float(value):
        raise OptionError(f"{place}: {key} is {value}; expected a whole number")
    return number


def _vector(value: Any, place: str) -> tuple[float, ...]:
    entries = _listed(value)
    if len(entries) != 3:
        raise OptionError(f"{place}: gravity is '{value}'; expected three numbers, e.g. 0, 0 and -9.81")
    found = tuple(float(_number(entry, float, "gravity", place)) for entry in entries)
    if not all(map(math.isfinite, found)):
        raise OptionError(f"{place}: gravity is {value}; expected three finite numbers, e.g. 0, 0 and -9.81")
    return found


def _listed(value: Any) -> list[Any]:
    if value is None:
        return []
    return list(value) if isinstance(value, (list, tuple)) else [value]


def _interval(value: Any, place: str) -> tuple[float, float]:
    try:
        start, end = value.split(":") if isinstance(value, str) else value
        if isinstance(start, bool) or isinstance(end, bool):
            raise TypeError
        low, high = float(start or 0.0), float(end) if end not in ("", None) else math.inf
        if math.isnan(low) or math.isnan(high):
            raise ValueError
    except (ValueError, TypeError):
        raise OptionError(f"{place}: time '{value}': expected FROM:TO in seconds, e.g. '2:30' (quoted)") from None
    if not low < high:
        raise OptionError(f"{place}: time '{value}': the end must come after the start")
    return low, high
