"""Torques at one joint that friction solvers have no part in: springs, ripple, couplings."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from math import exp
from typing import Any

import numpy as np

from .contract import Effect, Now, Place, State, another, inner
from .motion import Motion
from .robots import Robot


@dataclass
class Push(Effect):
    """tau = value(q, qd, t)."""

    @abstractmethod
    def value(self, x: State) -> Any:
        """Return the torque [N m]."""

    def torque(self, x: Motion) -> np.ndarray:
        return self.at_joint(x, self.value(x))

    def act(self, now: Now) -> None:
        now.push[self.joint] += self.value(now)


@dataclass
class JointSpring(Push):
    """k (q - q_0)."""

    id = "joint_spring"
    rest: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> JointSpring:
        return cls(joint, 1.0, inner(rng, x.q[:, joint]))

    def value(self, x: State) -> Any:
        return self.strength * (x.q[..., self.joint] - self.rest)

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"stiffness": self.strength, "rest_position": self.rest}


@dataclass
class OneSidedSpring(Push):
    """k max(0, q - q_0), or its mirror image."""

    id = "one_sided_spring"
    contact: float
    side: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> OneSidedSpring:
        side, at = float(rng.choice([-1.0, 1.0])), float(rng.uniform(0.6, 0.85))
        return cls(joint, 1.0, float(np.quantile(x.q[:, joint], at if side > 0 else 1 - at)), side)

    def value(self, x: State) -> Any:
        return self.side * self.strength * np.maximum(0.0, self.side * (x.q[..., self.joint] - self.contact))

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"stiffness": self.strength, "contact_position": self.contact, "side": self.side}

    def place(self, robot: Robot) -> Place:
        low, high = (self.contact, None) if self.side > 0 else (None, self.contact)
        region = [{"signal": f"q_{robot.joints[self.joint]}", "low": low, "high": high}]
        return super().place(robot) | {"region": region}


@dataclass
class Counterbalance(Push):
    """A spring between a crank on the link and a point of the base: dE/dq with E = k/2 (L(q) - L_0)^2.

        L^2 = a^2 + b^2 - 2 a b cos(q - q_0);  dE/dq = k (1 - L_0 / L) a b sin(q - q_0)

    Strength is k a b; free_length is L_0 / b.
    """

    id = "counterbalance"
    dead_centre: float
    ratio: float
    free_length: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> Counterbalance:
        centre, ratio = inner(rng, x.q[:, joint], 0.1, 0.9), float(rng.uniform(0.4, 0.8))
        return cls(joint, 1.0, centre, ratio, float(rng.uniform(0.5, 0.9)) * (1.0 - ratio) + 0.1)

    def value(self, x: State) -> Any:
        theta = x.q[..., self.joint] - self.dead_centre
        length = np.sqrt(1.0 + self.ratio**2 - 2.0 * self.ratio * np.cos(theta))
        return self.strength * (1.0 - self.free_length / length) * np.sin(theta)

    def parameters(self, x: Motion) -> dict[str, float]:
        return {
            "spring_torque": self.strength,
            "force_torque": -self.strength * self.free_length,
            "dead_centre": self.dead_centre,
            "crank_ratio": self.ratio,
        }


@dataclass
class TorqueRipple(Push):
    """A sin(m q + phase)."""

    id = "torque_ripple"
    order: float
    phase: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> TorqueRipple:
        # At least four periods in the range, and slow enough to be seen below the usual cut-off at median speed.
        fewest = 4 * 2 * np.pi / np.ptp(x.q[:, joint])
        most = max(1.5 * fewest, 2 * np.pi * 4.0 / float(np.median(np.abs(x.qd[:, joint])) + 1e-9))
        order = float(np.exp(rng.uniform(np.log(fewest), np.log(min(most, 80.0) + fewest))))
        return cls(joint, 1.0, round(order), float(rng.uniform(-np.pi, np.pi)))

    def value(self, x: State) -> Any:
        return self.strength * np.sin(self.order * x.q[..., self.joint] + self.phase)

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"amplitude": self.strength, "phase": self.phase, "order": self.order}


@dataclass
class JointCoupling(Push):
    """k (q_other - q_0)."""

    id = "joint_coupling"
    other: int
    rest: float
    sign: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> JointCoupling:
        other = another(rng, x.robot.n, joint)
        return cls(joint, 1.0, other, float(x.q[:, other].mean()), float(rng.choice([-1.0, 1.0])))

    def value(self, x: State) -> Any:
        return self.sign * self.strength * (x.q[..., self.other] - self.rest)

    def parameters(self, x: Motion) -> dict[str, float]:
        k = self.sign * self.strength
        return {"stiffness": k, "offset": -k * self.rest}

    def place(self, robot: Robot) -> Place:
        return super().place(robot) | {"other": robot.joints[self.other]}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"q_{robot.joints[self.other]}"]


@dataclass
class VelocityCoupling(JointCoupling):
    """d qd_other."""

    id = "velocity_coupling"

    def value(self, x: State) -> Any:
        return self.sign * self.strength * x.qd[..., self.other]

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"viscous": self.sign * self.strength}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"qd_{robot.joints[self.other]}"]


@dataclass
class Presliding(Push):
    """c z with Dahl's state: dz/dt = qd / d (1 - z sign(qd))."""

    id = "presliding_hysteresis"
    distance: float
    _z: float = field(default=0.0, init=False)
    _q: float = field(default=0.0, init=False)

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> Presliding:
        return cls(joint, 1.0, float(rng.uniform(0.03, 0.12) * np.ptp(x.q[:, joint])))

    def value(self, x: State) -> Any:
        """Return c z of a sequence; z starts as if the joint had been sliding."""
        moved = np.diff(x.q[:, self.joint]).tolist()
        z = [float(np.sign(x.qd[0, self.joint]))]
        for step in moved:
            z.append(_dahl(z[-1], step / self.distance))
        return self.strength * np.array(z)

    def begin(self, now: Now) -> None:
        self._z, self._q = float(np.sign(now.qd[self.joint])), float(now.q[self.joint])

    def act(self, now: Now) -> None:
        q = float(now.q[self.joint])
        self._z, self._q = _dahl(self._z, (q - self._q) / self.distance), q
        now.push[self.joint] += self.strength * self._z

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"coulomb": self.strength, "distance": self.distance}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"{signal}_{robot.joints[self.joint]}" for signal in ("q", "qd")]


def _dahl(z: float, step: float) -> float:
    """Return z after a step in one direction, in parts of the presliding distance."""
    end = 1.0 if step > 0 else -1.0
    return end + (z - end) * exp(-abs(step))
