"""The geometry that the torques suggest: joints moved in their parent links, bodies and friction re-fitted.

With r the residual, and E the change of the torques as the joints move by B_k and the re-fitted coefficients follow, a
Gauss-Newton step of the moves' sizes s with the prior N(0, width^2) is

    (E' W E + 1/width^2) ds = E' W r - s/width^2,   E = D - A (A' W A + prior)^-1 A' W D

with D the derivatives by the moves (``RobotModel.origin_slopes``), A the regressor with friction's features, W the
weight of the samples over the variance of their noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.suspicions.samples import Samples
from torchrbd.inference.suspicions.writing import Writing
from torchrbd.robot import RobotModel, with_moved_origins

# Links of a variant that are a half longer or shorter are settled in three steps.
_STEPS = 3


@dataclass(frozen=True)
class Moved:
    """A robot whose joints have been moved.

    Attributes:
        robot: the robot.
        size: (K,) s.
        precision: (K, K) of s.
        effect: (n_dof, K, M) E, before the last step.
        left: (n_dof, M) r, as far as the last step is linear.
        weight: (n_dof, M) W; zero for joints that are not judged.
        noise: variances of the torques (n_dof,) at the URDF's geometry, and at that of the last step.
    """

    robot: RobotModel
    size: Tensor
    precision: Tensor
    effect: Tensor
    left: Tensor
    weight: Tensor
    noise: tuple[Tensor, Tensor]

    def squares(self, change: Tensor) -> Tensor:
        """Return the weighted squared residual (n_dof,) as the sizes change by (K,)."""
        own, cross, alone = self._products
        return (alone + (own @ change + 2.0 * cross) @ change).clamp_min(0.0)

    @cached_property
    def _products(self) -> tuple[Tensor, Tensor, Tensor]:
        """E' W E (n_dof, K, K), E' W r (n_dof, K) and r' W r (n_dof,)."""
        weighed = self.effect * self.weight.unsqueeze(1)
        cross = (weighed @ self.left.unsqueeze(-1))[..., 0]
        return weighed @ self.effect.mT, cross, (self.weight * self.left.square()).sum(1)


def move_joints(
    samples: Samples,
    now: Writing,
    moves: Tensor,
    width: float,
    within: tuple[float, float],
    further_effects: Sequence[str],
) -> Moved:
    """Return the robot with its joints where the torques suggest.

    Args:
        samples: of the table.
        now: how it is read.
        moves: (K, n_dof, 6) B, shifts [m] and rotation vectors [rad] in the parent links' axes.
        width: prior standard deviation of s.
        within: least and largest s.
        further_effects: effects that every joint has as well, as of ``Samples.explained``.
    """
    robot, size = samples.robot, torch.zeros(len(moves), dtype=torch.float64)
    before, effect, left, precision, weight = size, *(torch.empty(0),) * 4
    noise: list[Tensor] = []
    for step in range(_STEPS):
        # On the way the noise that has been learnt will do.
        known = noise[-1] if 0 < step < _STEPS - 1 else None
        model, left = samples.fitted(now, robot, further_effects, known)
        noise.append(model.noise_variance)
        weight = samples.weight / model.noise_variance.unsqueeze(1)
        weight = torch.where(samples.judged.unsqueeze(1), weight, 0.0)
        effect = _effect(samples, now, robot, model, moves, weight)
        precision = torch.einsum("jkm,jm,jlm->kl", effect, weight, effect) + torch.eye(len(moves)) / width**2
        slope = torch.einsum("jkm,jm,jm->k", effect, weight, left) - size / width**2
        before, size = size, (size + torch.linalg.solve(precision, slope)).clamp(*within)
        robot = with_moved_origins(samples.robot, torch.einsum("k,kjx->jx", size, moves))
    left = left - torch.einsum("jkm,k->jm", effect, size - before)
    return Moved(robot, size, precision, effect, left, weight, (noise[0], noise[-1]))


def _effect(
    samples: Samples, now: Writing, robot: RobotModel, model: FittedModel, moves: Tensor, weight: Tensor
) -> Tensor:
    """Return E (n_dof, K, M)."""
    parts = []
    for states in samples.tiles:
        q, qd, qdd = now.moved(*states.motion_out)
        slopes = robot.origin_slopes(q.T, qd.T, qdd.T, model.pi)
        parts.append(torch.einsum("mjkx,lkx->jlm", slopes, moves))
    D, columns = torch.cat(parts, -1), model.columns
    rows = samples.rows(now, robot)
    mixed = torch.zeros(columns.n, len(moves), dtype=torch.float64)
    for row, w, own, slope in zip(rows, weight, columns.of_joint, D, strict=True):
        mixed[own] += (row * w) @ slope.T
    follow = torch.zeros_like(mixed)
    follow[model.free] = model.laplace @ mixed[model.free]
    return torch.stack([d - follow[own].T @ row for d, own, row in zip(D, columns.of_joint, rows, strict=True)])
