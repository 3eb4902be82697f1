"""What lies between the command and the link: first-order actuators, elastic joints and play."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .contract import Effect, Now, Place, named
from .motion import Motion
from .robots import Robot
from .whole_robot import RotorInertia

_SUBSTEPS = 5


@dataclass
class ActuatorLag(Effect):
    """T d(acting)/dt + acting = command, and the command is recorded; all joints alike if ``joint`` is -1."""

    id = "actuator_lag"
    whole_robot = True
    _acting: np.ndarray = field(default_factory=lambda: np.zeros(0), init=False)

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> ActuatorLag:
        return cls(joint if rng.random() < 0.5 else -1, 0.01)

    def _joints(self, n: int) -> list[int]:
        return list(range(n)) if self.joint < 0 else [self.joint]

    def torque(self, x: Motion) -> np.ndarray:
        tau, joints = np.zeros_like(x.load), self._joints(x.robot.n)
        tau[:, joints] = self.strength * np.gradient(x.load[:, joints], x.t[1] - x.t[0], axis=0)
        return tau

    def limit(self, x: Motion) -> float:
        return 0.06

    def begin(self, now: Now) -> None:
        self._acting = now.load.copy()

    def drive(self, now: Now, acting: np.ndarray) -> None:
        joints, before = self._joints(len(acting)), self._acting
        self._acting = before - np.expm1(-now.h / self.strength) * (acting - before)
        # The mean over the step: with its end alone the lag would be half a step shorter.
        acting[joints] = 0.5 * (before + self._acting)[joints]

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"time_constant": self.strength}

    def place(self, robot: Robot) -> Place:
        joints = [robot.joints[j] for j in self._joints(robot.n)]
        return {"joints": joints, "links": [], "other": None, "region": None}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"tau_{robot.joints[j]}" for j in self._joints(robot.n)]

    def same_as(self, robot: Robot) -> list[Place]:
        return [named("time_delay", robot, self._joints(robot.n))]


@dataclass
class TwoMass(Effect):
    """A motor and a link with something between them that yields; what is recorded is the motor's."""

    by_difference = True
    inertia: float
    _theta: float = field(default=0.0, init=False)
    _omega: float = field(default=0.0, init=False)

    @property
    @abstractmethod
    def stiffness(self) -> float:
        """Stiffness of what lies between [N m/rad]."""

    @property
    @abstractmethod
    def damping(self) -> float:
        """Damping of it [N m s/rad]."""

    @abstractmethod
    def yielding(self, load: np.ndarray) -> np.ndarray:
        """Return how far the motor is ahead of the link [rad] under a load at rest."""

    @abstractmethod
    def wound(self, gap: float) -> float:
        """Return the part of motor minus link [rad] that the spring is wound by."""

    def torque(self, x: Motion) -> np.ndarray:
        """Return the load of the link, which is behind the motor, less that of a link that is not."""
        h, behind = x.t[1] - x.t[0], np.zeros_like(x.q)
        behind[:, self.joint] = self.yielding(x.load[:, self.joint])
        slower = np.gradient(behind, h, axis=0)
        link = x.q - behind, x.qd - slower, x.qdd - np.gradient(slower, h, axis=0)
        return x.robot.torque(*link) - x.load

    def begin(self, now: Now) -> None:
        at_rest = float(self.yielding(now.load[self.joint : self.joint + 1])[0])
        self._theta, self._omega = float(now.q[self.joint]) + at_rest, float(now.qd[self.joint])
        # From here on the encoder is the motor's.
        if now.seen_q is now.q:
            now.seen_q, now.seen_qd = now.q.copy(), now.qd.copy()
        self.see(now)

    def see(self, now: Now) -> None:
        now.seen_q[self.joint], now.seen_qd[self.joint] = self._theta, self._omega

    def drive(self, now: Now, acting: np.ndarray) -> None:
        q, qd, motor = float(now.q[self.joint]), float(now.qd[self.joint]), float(acting[self.joint])
        h, passed = now.h / _SUBSTEPS, 0.0
        theta, omega = self._theta, self._omega
        for _ in range(_SUBSTEPS):
            wound = self.wound(theta - q)
            torque = self.stiffness * wound + (self.damping * (omega - qd) if wound else 0.0)
            omega += h / self.inertia * (motor - torque)
            theta += h * omega
            q += h * qd
            passed += torque / _SUBSTEPS
        self._theta, self._omega = theta, omega
        acting[self.joint] = passed

    def companions(self) -> Sequence[Effect]:
        return (RotorInertia(self.joint, self.inertia),)

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"tau_{robot.joints[self.joint]}"]


@dataclass
class JointElasticity(TwoMass):
    """A spring; strength is its compliance 1/k."""

    id = "joint_elasticity"
    link: float
    ratio: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> JointElasticity:
        free, motor = _link_and_motor(x, joint)
        return cls(joint, 0.01 / float(np.abs(x.load[:, joint]).max()), motor, free, float(rng.uniform(0.1, 0.25)))

    @property
    def stiffness(self) -> float:
        return 1.0 / self.strength

    @property
    def damping(self) -> float:
        return 2.0 * self.ratio * float(np.sqrt(self.stiffness * self.link))

    def yielding(self, load: np.ndarray) -> np.ndarray:
        return load / self.stiffness

    def wound(self, gap: float) -> float:
        return gap

    def limit(self, x: Motion) -> float:
        # The link on its spring must stay well above the motion's band, and give by no more than .15 rad.
        resonance = 2 * np.pi * 5.0
        return min(1.0 / (self.link * resonance**2), 0.15 / float(np.abs(x.load[:, self.joint]).max()))

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"stiffness": self.stiffness, "damping": self.damping}


@dataclass
class Backlash(TwoMass):
    """Play of so much altogether (strength), with flanks so stiff that they yield by a twentieth of it."""

    id = "backlash"
    link: float
    peak: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> Backlash:
        free, motor = _link_and_motor(x, joint)
        return cls(joint, 0.01, motor, free, float(np.abs(x.load[:, joint]).max()))

    @property
    def stiffness(self) -> float:
        # A stiffer one would be too fast for the step.
        return min(20.0 * self.peak / self.strength, 5e5 * self.link)

    @property
    def damping(self) -> float:
        return 2.0 * 0.3 * float(np.sqrt(self.stiffness * self.link))

    def yielding(self, load: np.ndarray) -> np.ndarray:
        return 0.5 * self.strength * np.sign(load) + load / self.stiffness

    def wound(self, gap: float) -> float:
        half = 0.5 * self.strength
        return gap - half if gap > half else gap + half if gap < -half else 0.0

    def limit(self, x: Motion) -> float:
        return 0.06

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"backlash": self.strength}


def _link_and_motor(x: Motion, joint: int) -> tuple[float, float]:
    """Return the link's least inertia and a motor's, between a third of that and what the motor meets [kg m^2]."""
    held, free = x.robot.inertias(x.q)
    return float(free[joint]), 0.3 * float(np.sqrt(held[joint] * free[joint]))


@dataclass
class DeadZone(Effect):
    """Of the command, recorded, only what is beyond +-w acts: w sign(load) is added."""

    id = "torque_dead_zone"
    by_difference = True

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> DeadZone:
        return cls(joint, 1.0)

    def torque(self, x: Motion) -> np.ndarray:
        return self.at_joint(x, self.strength * np.sign(x.load[:, self.joint]))

    def drive(self, now: Now, acting: np.ndarray) -> None:
        acting[self.joint] -= np.clip(acting[self.joint], -self.strength, self.strength)

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"half_width": self.strength}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"tau_{robot.joints[self.joint]}"]
