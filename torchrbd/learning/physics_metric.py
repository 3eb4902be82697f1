"""What of a torque the physics could have said itself.

The physics' torque moves with its inertial parameters pi and its terms' coefficients w as d tau = [Y, Phi] d(pi, w). Of
a torque at many samples, each joint weighed by its noise, the part in the span of these columns is physics' own; a
network beside it should say the rest only.

Source: Györök et al., "Orthogonal projection-based regularization for efficient model augmentation", L4DC 2025, for
state-space models; here the columns are those of inverse dynamics, each joint weighed by its noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.func import functional_call, vjp

from torchrbd.model import RigidBodyDynamics

# Of the longest column; what is shorter is zero but for rounding. And, at one length each, of the largest direction.
_LEAST_LENGTH, _LEAST_SINGULAR = 1e-7, 1e-5


class _Terms(nn.Module):
    """The terms' torque as a module's call, which ``functional_call`` needs."""

    def __init__(self, physics: RigidBodyDynamics) -> None:
        super().__init__()
        self.physics = physics

    def forward(self, q: Tensor, qd: Tensor, qdd: Tensor, **conditions: Any) -> Tensor:
        return self.physics.term_torque(q, qd, qdd, **conditions)


def physics_columns(physics: RigidBodyDynamics, q: Tensor, qd: Tensor, qdd: Tensor, **conditions: Any) -> Tensor:
    """Return d tau / d (pi, w), (N, n_dof, n_params + n_coefficients).

    Args:
        physics: rigid body and terms.
        q, qd, qdd: (N, n_dof), [rad, m] and per second, per second squared.
        **conditions: t, temperature and recording, as the physics' call takes them.
    """
    parts, terms = [physics.robot.regressor(q, qd, qdd)], _Terms(physics)
    w = {name: p.detach() for name, p in terms.named_parameters() if name.endswith(".coefficients")}
    if w:
        sizes = [len(one) for one in w.values()]

        def torque(flat: Tensor) -> Tensor:
            own = dict(zip(w, flat.split(sizes), strict=True))
            return functional_call(terms, own, (q, qd, qdd), conditions)

        # What is linear in u has J's columns for slopes: d/du (e_k . J' u).
        _, pull, *_ = vjp(torque, torch.cat(list(w.values())))
        _, push, *_ = vjp(lambda u: pull(u)[0], torch.zeros_like(q))
        units = torch.eye(sum(sizes), dtype=physics.pi.dtype, device=q.device)
        parts.append(torch.vmap(lambda unit: push(unit)[0], out_dims=-1)(units).to(q))
    return torch.cat(parts, -1).detach()


@dataclass(frozen=True, eq=False)
class PhysicsMetric:
    """The span of the physics' columns at a sample of states.

    Attributes:
        features: (S, n_features) of the sample.
        root_weight: (S, n_dof) one over the noise's standard deviation, 0 where no torque is measured.
        basis: (S, n_dof, r) orthonormal columns, weighed by ``root_weight``.
    """

    features: Tensor
    root_weight: Tensor
    basis: Tensor

    @classmethod
    def of(cls, features: Tensor, columns: Tensor, weight: Tensor) -> PhysicsMetric:
        """Make the basis of columns (S, n_dof, P) at features (S, n_features) with weights (S, n_dof)."""
        root = weight.to(torch.float64).sqrt()
        matrix = (columns.to(torch.float64) * root.unsqueeze(-1)).flatten(0, 1)
        lengths = matrix.norm(dim=0)
        there = lengths > _LEAST_LENGTH * lengths.amax()
        matrix = matrix[:, there] / lengths[there]
        left, size, _ = torch.linalg.svd(matrix, full_matrices=False)
        kept = left[:, size > _LEAST_SINGULAR * size.amax()] if size.numel() else left
        return cls(features, root.to(features), kept.reshape(*columns.shape[:2], -1).to(features))

    def to(self, device: torch.device | str) -> PhysicsMetric:
        """Return the same on another device."""
        return PhysicsMetric(*(x.to(device) for x in (self.features, self.root_weight, self.basis)))

    def said(self, tau: Tensor) -> Tensor:
        """Return the mean square () of the part of a torque (S, n_dof) that the physics can say, in units of noise."""
        whitened = tau.to(self.basis) * self.root_weight
        return torch.einsum("sjr,sj->r", self.basis, whitened).square().sum() / max(1, tau.numel())

    def share(self, tau: Tensor) -> Tensor:
        """Return that part over the whole torque's mean square, 0 to 1; 0 of no torque."""
        whole = (tau.to(self.basis) * self.root_weight).square().mean()
        return self.said(tau) / whole.clamp_min(torch.finfo(whole.dtype).tiny)
