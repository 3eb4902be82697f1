"""The part of a torque that the physics could explain itself.

The physics' torque moves with its inertial parameters pi and its terms' coefficients w as d tau = [Y, Phi] d(pi, w). Of
a torque at many samples, each joint weighed by its noise, the part in the span of these columns belongs to the physics.
A network that corrects it should supply only the rest.

Source: Györök et al., "Orthogonal projection-based regularization for efficient model augmentation", L4DC 2025, for
state-space models; here the columns are those of inverse dynamics, each joint weighed by its noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

# Of the longest column; what is shorter is zero but for rounding. And, at one length each, of the largest direction.
_LEAST_LENGTH, _LEAST_SINGULAR = 1e-7, 1e-5


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
