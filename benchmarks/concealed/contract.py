"""The contract of concealed effects: the torque they add along a known motion, and how they act in a simulation.

Both are written apart: ``torque`` by numpy and Pinocchio over whole arrays, the hooks by what MuJoCo does step by step.
A test holds one against the other.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no type stubs)

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeAlias

import mujoco
import numpy as np
from typing_extensions import Self

from .motion import Motion
from .robots import Robot

Place = dict[str, Any]


@dataclass
class Now:
    """One step of a simulation: what effects see, and the arrays they add to.

    Attributes:
        file, t, q, qd, load, temperature: as in ``Motion``, (n,); load is that of the step before.
        h: length of a step [s].
        push: torque against the actuator [N m].
        level: Coulomb friction [N m].
        damping: viscous friction [N m s/rad].
        applied: force and moment on the links at their centres of mass, (n, 6).
        origin, centre: the links' origins and centres of mass in the world, (n, 3) [m].
        seen_q, seen_qd: what the encoders see, and the controller.
    """

    file: str
    h: float
    q: np.ndarray
    qd: np.ndarray
    load: np.ndarray
    temperature: np.ndarray
    applied: np.ndarray
    origin: np.ndarray
    centre: np.ndarray
    t: float = 0.0
    push: np.ndarray = field(init=False)
    level: np.ndarray = field(init=False)
    damping: np.ndarray = field(init=False)
    seen_q: np.ndarray = field(init=False)
    seen_qd: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.push, self.level, self.damping = np.zeros((3, len(self.q)))
        self.seen_q, self.seen_qd = self.q, self.qd


State: TypeAlias = Motion | Now
"""What joint torques may depend on: along a whole motion, or at one step, without the dimension of time."""


@dataclass
class Record:
    """What an ideal recorder writes, at every step: t (N,), q and tau (N, n); sensors change it in place."""

    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray


@dataclass(frozen=True)
class Window:
    """When an effect acts: in one recording, from start to end [s]."""

    file: str
    start: float
    end: float

    def holds(self, x: State) -> Any:
        """Return whether it acts, (N,) or one value."""
        return (x.t >= self.start) & (x.t < self.end) & (x.file == self.file)


@dataclass
class Effect(ABC):
    """One concealed effect.

    Class attributes:
        id: its name in the truth.
        beside_friction: its size is what is left after projection on friction columns too; False for friction that has
            the columns' own form.
        over_coulomb: parameters that count the Coulomb friction that the joint has anyway.
        by_difference: its torque in a simulation is what all else leaves over, rather than ``torque`` of the motion.
        whole_robot: it does not belong to one joint.
    """

    id: ClassVar[str]
    beside_friction: ClassVar[bool] = True
    over_coulomb: ClassVar[tuple[str, ...]] = ()
    by_difference: ClassVar[bool] = False
    whole_robot: ClassVar[bool] = False

    joint: int
    strength: float
    window: Window | None = field(default=None, init=False)

    @classmethod
    @abstractmethod
    def draw(cls, rng: np.random.Generator, x: Motion, joint: int) -> Effect:
        """Draw an effect's shape for the range that a motion covers; its strength is 1."""

    @abstractmethod
    def torque(self, x: Motion) -> np.ndarray:
        """Return what it adds to the recorded torque of a motion, (N, n) [N m]."""

    @abstractmethod
    def parameters(self, x: Motion) -> dict[str, float]:
        """Return the physical parameters in SI units, named as in torchrbd where it has the effect."""

    def of_strength(self, strength: float) -> Self:
        """Return the same effect, stronger or weaker."""
        other = copy.copy(self)
        other.strength = strength
        return other

    def limit(self, x: Motion) -> float:
        """Return the largest plausible strength."""
        return np.inf

    def place(self, robot: Robot) -> Place:
        """Return joints, links, the other joint and the region where it acts."""
        return {"joints": [robot.joints[self.joint]], "links": [], "other": None, "region": None}

    def depends_on(self, robot: Robot) -> list[str]:
        """Return the signals its torque depends on."""
        return [f"q_{robot.joints[self.joint]}"]

    def same_as(self, robot: Robot) -> list[Mapping[str, Any]]:
        """Return other names and places of the same torque."""
        return []

    def companions(self) -> Sequence[Effect]:
        """Return effects that come with it by construction."""
        return ()

    def change(self, model: mujoco.MjModel) -> None:  # noqa: B027
        """Change the real robot, for the effect's window or for good."""

    def begin(self, now: Now) -> None:  # noqa: B027
        """Start its hidden state."""

    def act(self, now: Now) -> None:  # noqa: B027
        """Add to ``now.push``, ``now.level`` or ``now.damping``."""

    def drive(self, now: Now, acting: np.ndarray) -> None:  # noqa: B027
        """Change, in place, the torques that act where others were commanded."""

    def see(self, now: Now) -> None:  # noqa: B027
        """Change, in place, what the encoders see."""

    def sense(self, record: Record) -> None:  # noqa: B027
        """Change what is recorded, in place."""

    def at_joint(self, x: Motion, torque: np.ndarray) -> np.ndarray:
        """Return (N, n) with a torque (N,) at its joint."""
        tau = np.zeros_like(x.load)
        tau[:, self.joint] = torque
        return tau


def named(effect: str, robot: Robot, joints: Sequence[int] = (), links: Sequence[int] = ()) -> Place:
    """Return an alternative name for the truth."""
    return {
        "effect": effect,
        "joints": [robot.joints[j] for j in joints],
        "links": [robot.links[k] for k in links],
    }


def rms(x: np.ndarray) -> Any:
    """Return the root mean square over time."""
    return np.sqrt(np.mean(x**2, axis=0))


def inner(rng: np.random.Generator, x: np.ndarray, low: float = 0.2, high: float = 0.8) -> float:
    """Draw a value between two quantiles of a signal."""
    return float(np.quantile(x, rng.uniform(low, high)))


def another(rng: np.random.Generator, n: int, joint: int) -> int:
    """Draw another joint."""
    return int(rng.choice([j for j in range(n) if j != joint]))
