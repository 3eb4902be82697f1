"""What is recorded wrongly: offsets, gains, delays, clipping; the robot itself is right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .contract import Effect, Place, Record, named
from .motion import Motion
from .robots import Robot


def _late(t: np.ndarray, x: np.ndarray, delay: float) -> np.ndarray:
    """Return x (N, n) later by a delay, in straight lines between samples."""
    return np.stack([np.interp(t - delay, t, column) for column in x.T], axis=1)


@dataclass
class TorqueOffset(Effect):
    """A constant is added to the recorded torque."""

    id = "torque_offset"
    sign: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> TorqueOffset:
        return cls(joint, 1.0, float(rng.choice([-1.0, 1.0])))

    def torque(self, x: Motion) -> np.ndarray:
        return self.at_joint(x, np.full(len(x.t), self.sign * self.strength))

    def sense(self, record: Record) -> None:
        record.tau[:, self.joint] += self.sign * self.strength

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"offset": self.sign * self.strength}

    def depends_on(self, robot: Robot) -> list[str]:
        return []

    def same_as(self, robot: Robot) -> list[Place]:
        return [named("asymmetric_coulomb_friction", robot, [self.joint])]


@dataclass
class TorqueScale(Effect):
    """The recorded torque is g times the acting one; strength is |g - 1|. All joints alike if ``joint`` is -1."""

    id = "torque_scale"
    sign: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> TorqueScale:
        return cls(joint, 0.1, float(rng.choice([-1.0, 1.0])))

    def _joints(self, n: int) -> list[int]:
        return list(range(n)) if self.joint < 0 else [self.joint]

    def torque(self, x: Motion) -> np.ndarray:
        tau, joints = np.zeros_like(x.load), self._joints(x.robot.n)
        tau[:, joints] = self.sign * self.strength * x.load[:, joints]
        return tau

    def limit(self, x: Motion) -> float:
        return 0.6

    def sense(self, record: Record) -> None:
        record.tau[:, self._joints(record.tau.shape[1])] *= 1.0 + self.sign * self.strength

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"gain": 1.0 + self.sign * self.strength}

    def place(self, robot: Robot) -> Place:
        joints = [robot.joints[j] for j in self._joints(robot.n)]
        return {"joints": joints, "links": [], "other": None, "region": None}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"tau_{robot.joints[j]}" for j in self._joints(robot.n)]


@dataclass
class TorqueSaturation(Effect):
    """Beyond a limit the recorded torque grows by 1 + slope times as much as the acting one; -1 clips it.

    The limit is exp(-strength) times the largest load of the motion.
    """

    id = "torque_saturation"
    slope: float
    peak: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> TorqueSaturation:
        peak = float(np.abs(x.load[:, joint]).max())
        return cls(joint, 0.5, -1.0 if rng.random() < 0.5 else float(rng.uniform(0.5, 1.5)), peak)

    @property
    def _limit(self) -> float:
        return self.peak * float(np.exp(-self.strength))

    def _beyond(self, tau: np.ndarray) -> np.ndarray:
        return self.slope * (tau - np.clip(tau, -self._limit, self._limit))

    def torque(self, x: Motion) -> np.ndarray:
        return self.at_joint(x, self._beyond(x.load[:, self.joint]))

    def limit(self, x: Motion) -> float:
        return float(np.log(self.peak / np.median(np.abs(x.load[:, self.joint]))))

    def sense(self, record: Record) -> None:
        record.tau[:, self.joint] += self._beyond(record.tau[:, self.joint])

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"limit": self._limit, "slope": self.slope}

    def depends_on(self, robot: Robot) -> list[str]:
        return [f"tau_{robot.joints[self.joint]}"]


@dataclass
class TimeDelay(TorqueScale):
    """The torque is recorded later than the motion, or earlier; strength is the time."""

    id = "time_delay"
    whole_robot = True

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> TimeDelay:
        return cls(joint if rng.random() < 0.5 else -1, 0.02, float(rng.choice([1.0, 1.0, -1.0])))

    def torque(self, x: Motion) -> np.ndarray:
        tau, joints = np.zeros_like(x.load), self._joints(x.robot.n)
        tau[:, joints] = _late(x.t, x.load[:, joints], self.sign * self.strength) - x.load[:, joints]
        return tau

    def limit(self, x: Motion) -> float:
        return 0.08

    def sense(self, record: Record) -> None:
        joints = self._joints(record.tau.shape[1])
        record.tau[:, joints] = _late(record.t, record.tau[:, joints], self.sign * self.strength)

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"delay": self.sign * self.strength}

    def same_as(self, robot: Robot) -> list[Place]:
        return [named("actuator_lag", robot, self._joints(robot.n))]


@dataclass
class EncoderOffset(Effect):
    """The recorded position is the true one plus a constant."""

    id = "encoder_offset"
    whole_robot = True
    sign: float

    @classmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> EncoderOffset:
        return cls(joint, 0.02, float(rng.choice([-1.0, 1.0])))

    def torque(self, x: Motion) -> np.ndarray:
        true = x.q.copy()
        true[:, self.joint] -= self.sign * self.strength
        return x.robot.torque(true, x.qd, x.qdd) - x.load

    def limit(self, x: Motion) -> float:
        return 0.2

    def sense(self, record: Record) -> None:
        record.q[:, self.joint] += self.sign * self.strength

    def parameters(self, x: Motion) -> dict[str, float]:
        return {"offset": self.sign * self.strength}

    def same_as(self, robot: Robot) -> list[Place]:
        return [named("geometry_error", robot, [self.joint])]
