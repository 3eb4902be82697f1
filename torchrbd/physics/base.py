"""The one contract of everything a rigid body leaves out.

An effect at joint j adds to the torque that the actuator must supply

    tau_j += sum_k w_k phi_k(q_j, qd_j, qdd_j; shape)

It is linear in its coefficients w, so that block statistics suffice to fit it, and has at most a few nonlinear shape
parameters, each tried on a grid. An ``Effect`` describes the physics and holds no numbers; a ``Term`` is an effect at
a joint with numbers, as a module.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

Shape = Mapping[str, float]


@dataclass(frozen=True)
class JointState:
    """The signals of one joint that an effect may depend on; q, qd and qdd have one common shape.

    ``rest_width`` is the speed [rad/s, m/s] below which the direction of motion is not told: sign(qd) is tanh(qd /
    rest_width).
    """

    q: Tensor
    qd: Tensor
    qdd: Tensor
    rest_width: float

    def direction(self) -> Tensor:
        """Return sign(qd), softened where the recording cannot tell it."""
        return torch.tanh(self.qd / self.rest_width)


@dataclass(frozen=True)
class JointScale:
    """What a recording covers at one joint: the range in which shapes are sought and parameters are plausible."""

    speed_max: float
    rest_width: float


class Effect(ABC):
    """Describe one kind of missing physics.

    Class attributes:
        id: the name in diagnosis.json.
        words: the name in a sentence.
        equation: the torque added, in field symbols.
        units: of the physical parameters, with ``{tau}`` and ``{q}`` for the joint's own (N m and rad, or N and m).
        complexity: number of coefficients and shape parameters, for parsimony.
        dissipative: True if tau qd >= 0 for plausible parameters.
    """

    id: ClassVar[str]
    words: ClassVar[str]
    equation: ClassVar[str]
    units: ClassVar[Mapping[str, str]]
    complexity: ClassVar[int]
    dissipative: ClassVar[bool] = False

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        """Return the shape parameters to try in the range that a recording covers."""
        return ({},)

    @abstractmethod
    def features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        """Return phi_k by label. Equal labels mean equal features, whichever effect they belong to."""

    @abstractmethod
    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        """Return the physical parameters, one for each entry of ``units``, differentiable in w (K,)."""

    @abstractmethod
    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        """Return w and the shape of given physical parameters: the inverse of ``parameters``."""

    @abstractmethod
    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        """Say whether the physics allows these values (signs, order, ranges that the recording covers)."""

    def urdf_dynamics(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """Return what the term adds to the attributes of the URDF's <dynamics>; empty if URDF has no word for it."""
        return {}

    def unit(self, parameter: str, *, prismatic: bool) -> str:
        """Return the SI unit of a physical parameter at a revolute or prismatic joint."""
        return self.units[parameter].format(**({"tau": "N", "q": "m"} if prismatic else {"tau": "N m", "q": "rad"}))


class Term(nn.Module):
    """An effect at one joint, with numbers: ``term(q, qd, qdd)`` of that joint is the torque it adds.

    Args:
        effect: the physics.
        joint: index of the joint.
        coefficients: w, (K,).
        shape: values of the nonlinear parameters.
        rest_width: see ``JointState``.
    """

    coefficients: nn.Parameter

    def __init__(self, effect: Effect, joint: int, coefficients: Tensor, shape: Shape, rest_width: float) -> None:
        super().__init__()
        self.effect, self.joint, self.shape, self.rest_width = effect, joint, dict(shape), rest_width
        self.coefficients = nn.Parameter(coefficients.detach().clone())

    def forward(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return sum_k w_k phi_k, of the shape of q, [N m] or [N]."""
        features = self.effect.features(JointState(q, qd, qdd, self.rest_width), self.shape)
        return sum(w * phi for w, phi in zip(self.coefficients.to(q.dtype), features.values(), strict=True))  # type: ignore[return-value]

    def parameters_by_name(self) -> dict[str, float]:
        """Return the physical parameters in SI units."""
        return {k: float(v) for k, v in self.effect.parameters(self.coefficients.detach(), self.shape).items()}

    def extra_repr(self) -> str:
        """Show effect, joint and parameters."""
        values = ", ".join(f"{k}={v:.4g}" for k, v in self.parameters_by_name().items())
        return f"{self.effect.id}, joint={self.joint}, {values}"
