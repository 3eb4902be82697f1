"""Dry friction: levels that MuJoCo's friction solver holds at rest too."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from .contract import Effect, Now, Place, State, inner, named
from .motion import Motion
from .robots import Robot


@dataclass
class Dry(Effect):
    """tau = level sign(qd)."""

    @abstractmethod
    def level(self, x: State) -> Any:
        """Return the level >= 0 [N m]."""

    def torque(self, x: Motion) -> np.ndarray:
        return self.at_joint(x, self.level(x) * x.direction()[:, self.joint])

    def act(self, now: Now) -> None:
        now.level[self.joint] += self.level(now)

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"qd_{robot.joints[self.joint]}"]


@dataclass
class Coulomb(Dry):
    """c sign(qd)."""

    id = "coulomb_friction"
    beside_friction = False

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> Coulomb:
        return cls(joint, 1.0)

    def level(self, x: State) -> Any:
        return self.strength

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"coulomb": self.strength}


@dataclass
class AsymmetricCoulomb(Dry):
    """c (1 + a) forwards, c (1 - a) backwards."""

    id = "asymmetric_coulomb_friction"
    beside_friction = False
    asymmetry: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> AsymmetricCoulomb:
        return cls(joint, 1.0, float(rng.choice([-1, 1]) * rng.uniform(0.3, 0.8)))

    def level(self, x: State) -> Any:
        return self.strength * (1.0 + self.asymmetry * np.sign(x.qd[..., self.joint]))

    def parameters(self, x: Motion) -> dict[str, float]:
        plus, minus = self.strength * (1 + self.asymmetry), self.strength * (1 - self.asymmetry)
        return {"coulomb_plus": plus, "coulomb_minus": minus}

    def same_as(self, robot: Robot) -> list[Place]:
        return [named(effect, robot, [self.joint]) for effect in ("coulomb_friction", "torque_offset")]


@dataclass
class Stribeck(Dry):
    """c + (s - c) exp(-(qd / v_s)^2); strength is s - c."""

    id = "stribeck_friction"
    over_coulomb = ("coulomb", "static")
    base: float
    speed: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> Stribeck:
        fastest = float(np.abs(x.qd[:, joint]).max())
        return cls(joint, 1.0, float(rng.uniform(0.5, 1.2)), float(rng.uniform(0.08, 0.2)) * fastest)

    def level(self, x: State) -> Any:
        return self.strength * (self.base + np.exp(-((x.qd[..., self.joint] / self.speed) ** 2)))

    def parameters(self, x: Motion) -> dict[str, float]:
        coulomb = self.strength * self.base
        return {"coulomb": coulomb, "static": coulomb + self.strength, "stribeck_speed": self.speed}


@dataclass
class LoadDependent(Dry):
    """k |load| sign(qd)."""

    id = "load_dependent_friction"

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> LoadDependent:
        return cls(joint, 1.0)

    def level(self, x: State) -> Any:
        return self.strength * np.abs(x.load[..., self.joint])

    def limit(self, x: Motion) -> float:
        return 0.8

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"load_friction": self.strength}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"{signal}_{robot.joints[self.joint]}" for signal in ("tau", "qd")]


@dataclass
class TimeVarying(Dry):
    """(c_end + (c_start - c_end) exp(-t / T)) sign(qd), t from each recording's start; strength is c_start."""

    id = "time_varying_friction"
    over_coulomb = ("coulomb_end", "coulomb_start")
    end: float
    time_constant: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> TimeVarying:
        return cls(joint, 1.0, float(rng.uniform(0.0, 0.3)), float(rng.uniform(4.0, 12.0)))

    def level(self, x: State) -> Any:
        return self.strength * (self.end + (1.0 - self.end) * np.exp(-x.t / self.time_constant))

    def parameters(self, x: Motion) -> dict[str, float]:
        return {
            "coulomb_end": self.strength * self.end,
            "coulomb_start": self.strength,
            "time_constant": self.time_constant,
        }

    def depends_on(self, robot: Robot) -> list[str]:
        return ["t", f"qd_{robot.joints[self.joint]}"]


@dataclass
class PositionDependent(Dry):
    """c exp(-((q - q_0) / w)^2) sign(qd)."""

    id = "position_dependent_friction"
    over_coulomb = ("coulomb", "coulomb_at_centre")
    centre: float
    width: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> PositionDependent:
        q = x.q[:, joint]
        return cls(joint, 1.0, inner(rng, q), float(rng.uniform(0.08, 0.2) * np.ptp(q)))

    def level(self, x: State) -> Any:
        return self.strength * np.exp(-(((x.q[..., self.joint] - self.centre) / self.width) ** 2))

    def parameters(self, x: Motion) -> dict[str, float]:
        at_centre = {"coulomb": 0.0, "coulomb_at_centre": self.strength}
        return {"centre": self.centre, "width": self.width, **at_centre}

    def place(self, robot: Robot) -> Place:
        low, high = self.centre - self.width, self.centre + self.width
        region = [{"signal": f"q_{robot.joints[self.joint]}", "low": low, "high": high}]
        return super().place(robot) | {"region": region}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"{signal}_{robot.joints[self.joint]}" for signal in ("q", "qd")]


@dataclass
class CableDrag(Dry):
    """c sign(qd) between two angles, with soft edges: friction that depends on position, of another shape."""

    id = "cable_drag"
    start: float
    end: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> CableDrag:
        q, width = x.q[:, joint], float(rng.uniform(0.2, 0.4) * np.ptp(x.q[:, joint]))
        centre = inner(rng, q, 0.25, 0.75)
        return cls(joint, 1.0, centre - 0.5 * width, centre + 0.5 * width)

    def level(self, x: State) -> Any:
        q, edge = x.q[..., self.joint], 0.1 * (self.end - self.start)
        return 0.5 * self.strength * (np.tanh((q - self.start) / edge) - np.tanh((q - self.end) / edge))

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"start": self.start, "end": self.end, "resistance": self.strength}

    def place(self, robot: Robot) -> Place:
        region = [{"signal": f"q_{robot.joints[self.joint]}", "low": self.start, "high": self.end}]
        return super().place(robot) | {"region": region}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"{signal}_{robot.joints[self.joint]}" for signal in ("q", "qd")]

    def same_as(self, robot: Robot) -> list[Place]:
        return [named("position_dependent_friction", robot, [self.joint])]
