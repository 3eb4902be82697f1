"""The coefficient vector x = [pi, w] of a robot with candidate terms, and the feature columns that multiply it.

    tau_j = Y_j pi + sum_k phi_jk w_jk

A joint's torque depends on the bodies that it moves and on its own features only, so joint j has the columns
``of_joint[j]`` of x and no others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchrbd.physics import Effect, JointScale, JointState, Shape, effect
from torchrbd.recordings import States
from torchrbd.robot import RobotModel

# Below this many standard deviations of its noise a velocity has no direction.
_REST_NOISE, _REST_PART, _LEAST_REST = 2.0, 1e-3, 1e-6
URDF_FRICTION = {"viscous_friction": "damping", "coulomb_friction": "friction"}


@dataclass(frozen=True)
class Candidate:
    """An effect at a joint with its shape parameters fixed: a set of columns."""

    effect: Effect
    joint: int
    shape: Shape = field(hash=False)
    labels: tuple[str, ...]


class Columns:
    """The layout of x for one robot, a set of effects and the ranges that the recordings cover.

    Args:
        robot: the robot.
        effects: effects to have columns for, at every joint.
        scales: per joint, what the recordings cover.

    Attributes:
        effects, scales: as given.
        n: length of x.
        labels: per joint, labels of its features.
        of_joint: per joint, indices in x of its columns: inertial ones of the bodies it moves, then its features.
        candidates: every effect at every joint with every shape.
        urdf_friction: the terms that the URDF's <dynamics> tags can hold, at every joint.
    """

    def __init__(self, robot: RobotModel, effects: Iterable[Effect], scales: Sequence[JointScale]) -> None:
        self.robot, self.effects, self.scales = robot, tuple(effects), tuple(scales)
        self.urdf_friction = tuple(
            Candidate(effect(name), joint, {}, tuple(effect(name).features(_probe(scale), {})))
            for joint, scale in enumerate(self.scales)
            for name in URDF_FRICTION
        )
        wanted = {e.id: e for e in self.effects}
        candidates: list[Candidate] = []
        labels: list[tuple[str, ...]] = []
        for joint, scale in enumerate(self.scales):
            own = dict.fromkeys(c.labels[0] for c in self.urdf_friction if c.joint == joint)
            for e in wanted.values():
                for shape in e.shapes(scale):
                    candidate = Candidate(e, joint, shape, tuple(e.features(_probe(scale), shape)))
                    candidates.append(candidate)
                    own.update(dict.fromkeys(candidate.labels))
            labels.append(tuple(own))
        self.candidates, self.labels = tuple(candidates), tuple(labels)
        self._first = [robot.n_params]
        for own_labels in labels:
            self._first.append(self._first[-1] + len(own_labels))
        self.n = self._first[-1]
        self.inertial = [robot.columns(joint) for joint in range(robot.n_dof)]
        self.of_joint = tuple(
            torch.cat((self.inertial[joint], torch.arange(self._first[joint], self._first[joint + 1])))
            for joint in range(robot.n_dof)
        )

    def at_scales(self, scales: Sequence[JointScale]) -> Columns:
        """Return columns of the same effects for other scales."""
        return Columns(self.robot, self.effects, scales)

    def taken_from(self, other: Columns, x: Tensor) -> Tensor:
        """Return x (n,) with the inertial parameters and friction of another layout's x, other terms at zero."""
        taken = self.reference()
        taken[: self.robot.n_params] = x[: self.robot.n_params]
        for own, theirs in zip(self.urdf_friction, other.urdf_friction, strict=True):
            taken[self.of(own)] = x[other.of(theirs)]
        return taken

    def index(self, joint: int, label: str) -> int:
        """Return where in x a joint's feature stands."""
        return self._first[joint] + self.labels[joint].index(label)

    def of(self, candidate: Candidate) -> list[int]:
        """Return where in x the columns of a candidate stand."""
        return [self.index(candidate.joint, label) for label in candidate.labels]

    def reference(self) -> Tensor:
        """Return x0 (n,): the inertial parameters and the <dynamics> friction of the URDF."""
        x = torch.zeros(self.n, dtype=torch.float64)
        x[: self.robot.n_params] = self.robot.pi
        for friction in self.urdf_friction:
            (k,) = self.of(friction)
            x[k] = self.urdf_value(friction)
        return x

    def urdf_value(self, candidate: Candidate) -> float:
        """Return what the URDF's <dynamics> say of a term, zero where they have no word for it."""
        attribute = URDF_FRICTION.get(candidate.effect.id)
        return float(getattr(self.robot, attribute)[candidate.joint]) if attribute else 0.0

    def features(self, states: States, joint: int) -> Tensor:
        """Evaluate a joint's features.

        Args:
            states: a tile of N samples.
            joint: index of the joint.

        Returns:
            (K, N) in the order of ``labels[joint]``.
        """
        state = JointState(states.q[joint], states.qd[joint], states.qdd[joint], self.scales[joint].rest_width)
        found: dict[str, Tensor] = {}
        for candidate in (*self.urdf_friction, *self.candidates):
            if candidate.joint == joint and not set(candidate.labels) <= found.keys():
                found.update(candidate.effect.features(state, candidate.shape))
        return torch.stack([found[label] for label in self.labels[joint]])


def joint_scales(speed_max: Tensor, velocity_noise: Tensor) -> tuple[JointScale, ...]:
    """Return the scales of joints that reach speeds (n_dof,), known to a noise of standard deviation (n_dof,)."""
    least = torch.full_like(speed_max, _LEAST_REST)
    rest = torch.maximum(torch.maximum(_REST_NOISE * velocity_noise, _REST_PART * speed_max), least)
    return tuple(JointScale(*map(float, values)) for values in zip(speed_max, rest, strict=True))


def _probe(scale: JointScale) -> JointState:
    """Return one sample at rest, enough to ask an effect for its labels."""
    return JointState(*torch.zeros(3, 1, dtype=torch.float64), rest_width=scale.rest_width)
