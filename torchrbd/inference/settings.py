"""What a user may choose, checked against the robot and the recordings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchrbd._runtime.deadline import seconds_of
from torchrbd.effects import Effect, effect, known_effects
from torchrbd.effects.requested import RequestedEffect
from torchrbd.errors import OptionError, closest
from torchrbd.options import Options, Payload
from torchrbd.recordings import listed_sources
from torchrbd.robot import RobotModel


class Settings(Options):
    __doc__ = Options.__doc__

    @classmethod
    def from_mapping(cls, options: Mapping[str, Any], place: str) -> Settings:
        """Read settings as a YAML file or keyword arguments give them; ``place`` is named in errors."""
        known = cls.names()
        for key in options:
            if key not in known:
                hint = closest(key, known) or f"known: {', '.join(sorted(known))}"
                raise OptionError(f"{place}: unknown setting '{key}'; {hint}")
        values = {key: value for key, value in options.items() if value is not None}
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
        values["time_limit"] = seconds_of(values.get("time_limit"))
        for key, kind in (("cutoff_hz", float), ("holdout_fraction", float), ("kappa", float), ("seed", int)):
            if values.get(key) is not None:
                values[key] = _number(values[key], kind, key, place)
        return cls(**values)

    def requested_effects(self) -> tuple[RequestedEffect, ...]:
        """Return the effects that were named and not excluded, with their places.

        Raises:
            OptionError: an id is unknown.
        """
        excluded = {effect(name).id for name in self.exclude}
        named = (RequestedEffect.parse(text) for text in self.effects or ())
        return tuple(one for one in named if one.effect.id not in excluded)

    def chosen_effects(self) -> tuple[Effect, ...]:
        """Return the effects to search for.

        Raises:
            OptionError: an id is unknown, or no effect is left.
        """
        named = {one.effect.id: one.effect for one in self.requested_effects()}
        excluded = {effect(name).id for name in self.exclude}
        wanted = known_effects() if self.effects is None else named
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

    def held_bodies(self, robot: RobotModel) -> tuple[str, ...]:
        """Return the bodies that ``trust`` keeps; a link that is fixed to a body means that body."""
        body_of = {link.name: body for body, links in robot.folded.items() for link in links}
        _check_names(self.trust, tuple(body_of), "link", robot.name)
        return tuple(dict.fromkeys(body_of[name] for name in self.trust))


def _check_names(names: Iterable[str], known: tuple[str, ...], kind: str, robot: str) -> None:
    for name in names:
        if name not in known:
            hint = f"{closest(name, known)} ".lstrip()
            raise OptionError(f"robot '{robot}' has no moving {kind} '{name}'; {hint}it has: {', '.join(known)}")


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
