"""Torques that are in no catalogue: what is to be found of them is where they sit and what they depend on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .contract import Place, State, another, inner, rms
from .friction import Dry
from .joint_torques import JointCoupling, Push
from .motion import Motion
from .robots import Robot
from .viscosity import Wet


@dataclass
class TorqueBump(Push):
    """A exp(-((q - q_0) / w)^2), whatever the direction."""

    id = "torque_bump"
    centre: float
    width: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> TorqueBump:
        q = x.q[:, joint]
        return cls(joint, 1.0, inner(rng, q), float(rng.uniform(0.05, 0.12) * np.ptp(q)))

    def value(self, x: State) -> Any:
        return self.strength * np.exp(-(((x.q[..., self.joint] - self.centre) / self.width) ** 2))

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"amplitude": self.strength, "centre": self.centre, "width": self.width}

    def place(self, robot: Robot) -> Place:
        low, high = self.centre - self.width, self.centre + self.width
        region = [{"signal": f"q_{robot.joints[self.joint]}", "low": low, "high": high}]
        return super().place(robot) | {"region": region}


@dataclass
class VelocityProduct(JointCoupling):
    """k qd qd_other."""

    id = "velocity_product"

    def value(self, x: State) -> Any:
        return self.sign * self.strength * x.qd[..., self.joint] * x.qd[..., self.other]

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"coefficient": self.sign * self.strength}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"qd_{robot.joints[j]}" for j in (self.joint, self.other)]


@dataclass
class TorqueHum(Push):
    """A sin(2 pi f t + phase), t from each recording's start."""

    id = "torque_hum"
    frequency: float
    phase: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> TorqueHum:
        return cls(joint, 1.0, float(rng.uniform(1.8, 3.5)), float(rng.uniform(-np.pi, np.pi)))

    def value(self, x: State) -> Any:
        return self.strength * np.sin(2 * np.pi * self.frequency * x.t + self.phase)

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"amplitude": self.strength, "frequency_hz": self.frequency, "phase": self.phase}

    def depends_on(self, robot: Robot) -> list[str]:
        return ["t"]


@dataclass
class RandomWalk(Push):
    """A torque that wanders: a random walk in straight lines, another in each recording; strength is its RMS."""

    id = "random_walk_torque"
    seed: int
    _EVERY_S = 0.5

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> RandomWalk:
        return cls(joint, 1.0, int(rng.integers(2**31)))

    def __post_init__(self) -> None:
        self._walks: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    def value(self, x: State) -> Any:
        return self.strength * np.interp(x.t, *self._walk(x.file))

    def _walk(self, file: str) -> tuple[np.ndarray, np.ndarray]:
        if file not in self._walks:
            steps = np.random.default_rng([self.seed, *file.encode()]).standard_normal(120)
            path = np.cumsum(steps) - np.cumsum(steps).mean()
            self._walks[file] = self._EVERY_S * np.arange(120), path / rms(path)
        return self._walks[file]

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"rms": self.strength}

    def depends_on(self, robot: Robot) -> list[str]:
        return ["t"]


@dataclass
class FrictionByOther(Dry):
    """c (1 + sin(q_other - q_0)) sign(qd): outside of every catalogue."""

    id = "angle_dependent_friction_of_other"
    other: int
    angle: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> FrictionByOther:
        other = another(rng, x.robot.n, joint)
        return cls(joint, 1.0, other, inner(rng, x.q[:, other]))

    def level(self, x: State) -> Any:
        return self.strength * (1.0 + np.sin(x.q[..., self.other] - self.angle))

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"coulomb": self.strength, "angle": self.angle}

    def place(self, robot: Robot) -> Place:
        return super().place(robot) | {"other": robot.joints[self.other]}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"q_{robot.joints[self.other]}", f"qd_{robot.joints[self.joint]}"]


@dataclass
class OneWayDamper(Wet):
    """d max(0, qd), or its mirror image: a damper with a valve."""

    id = "one_way_damper"
    side: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> OneWayDamper:
        return cls(joint, 1.0, float(rng.choice([-1.0, 1.0])))

    def rate(self, x: State) -> Any:
        return self.strength * (self.side * x.qd[..., self.joint] > 0)

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"viscous": self.strength, "side": self.side}
