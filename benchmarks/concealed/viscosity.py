"""Wet friction: rates of viscous kind, which MuJoCo's integrator takes implicitly."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from .contract import Effect, Now, State
from .motion import Motion
from .robots import Robot


@dataclass
class Wet(Effect):
    """tau = rate qd."""

    @abstractmethod
    def rate(self, x: State) -> Any:
        """Return the rate >= 0 [N m s/rad]."""

    def torque(self, x: Motion) -> np.ndarray:
        return self.at_joint(x, self.rate(x) * x.qd[:, self.joint])

    def act(self, now: Now) -> None:
        now.damping[self.joint] += self.rate(now)

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"qd_{robot.joints[self.joint]}"]


@dataclass
class Viscous(Wet):
    """d qd."""

    id = "viscous_friction"
    beside_friction = False

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> Viscous:
        return cls(joint, 1.0)

    def rate(self, x: State) -> Any:
        return self.strength

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"viscous": self.strength}


@dataclass
class PowerLaw(Wet):
    """k |qd|^a sign(qd)."""

    id = "power_law_friction"
    exponent: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> PowerLaw:
        return cls(joint, 1.0, float(rng.choice([rng.uniform(0.4, 0.6), rng.uniform(1.4, 1.7)])))

    def rate(self, x: State) -> Any:
        # A power below one has no slope at rest.
        speed = np.maximum(np.abs(x.qd[..., self.joint]), 1e-3)
        return self.strength * speed ** (self.exponent - 1.0)

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"friction": self.strength, "exponent": self.exponent}


@dataclass
class QuadraticDrag(Wet):
    """k qd |qd|."""

    id = "quadratic_drag"

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> QuadraticDrag:
        return cls(joint, 1.0)

    def rate(self, x: State) -> Any:
        return self.strength * np.abs(x.qd[..., self.joint])

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"drag": self.strength}


@dataclass
class ThermalViscosity(Wet):
    """d exp(-b (T - T_0)) qd with T_0 = 40 deg C."""

    id = "thermal_viscosity"
    per_kelvin: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> ThermalViscosity:
        return cls(joint, 1.0, float(rng.uniform(0.03, 0.07)))

    def rate(self, x: State) -> Any:
        return self.strength * np.exp(-self.per_kelvin * (x.temperature[..., self.joint] - 40.0))

    def parameters(self, x: Motion) -> dict[str, float]:
        """Return what the rate falls per kelvin along the line through it that errs least in torque."""
        speed = np.abs(x.qd[:, self.joint])
        slope, _ = np.polyfit(x.temperature[:, self.joint], self.rate(x), 1, w=speed)
        return {"viscous_per_kelvin": -float(slope)}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"{signal}_{robot.joints[self.joint]}" for signal in ("temperature", "qd")]


@dataclass
class SpeedDependentLoss(Wet):
    """k |load| qd."""

    id = "speed_dependent_loss"

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> SpeedDependentLoss:
        return cls(joint, 1.0)

    def rate(self, x: State) -> Any:
        return self.strength * np.abs(x.load[..., self.joint])

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"loss": self.strength}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"{signal}_{robot.joints[self.joint]}" for signal in ("tau", "qd")]
