"""Samples for locating: signals that a residual may depend on, and torques of loads and forces on bodies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from torchrbd.dataset.rows import Tile
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.rows.samples import Samples
from torchrbd.robot import RobotModel


@dataclass(frozen=True)
class Scene:
    """M samples of a robot with n joints, joints first and time last.

    Attributes:
        samples: the samples.
        load: (n, M) torque of the rigid body with fitted parameters.
    """

    samples: Samples
    load: np.ndarray

    @staticmethod
    def of(fit: Fit) -> Scene:
        """Return the scene of a fit."""
        return Scene(fit.rows.samples, fit.rows.samples.rigid @ fit.pi.numpy())

    @property
    def robot(self) -> RobotModel:
        """The robot."""
        return self.samples.columns.robot

    @cached_property
    def seen(self) -> tuple[int, ...]:
        """Joints whose torque is measured."""
        return tuple(int(j) for j in np.flatnonzero(self.samples.measured.any(1)))

    @cached_property
    def dt(self) -> float:
        """Time between two samples [s]."""
        steps = np.diff(self.samples.t)[np.diff(self.samples.run) == 0]
        return float(np.median(steps)) if len(steps) else 1.0

    def since(self, t: np.ndarray) -> np.ndarray:
        """Return a step at time zero as the filter leaves it."""
        return np.interp(t, *self.samples.rise)

    @cached_property
    def load_rate(self) -> np.ndarray:
        """Change of the load in time, (n, M) [N m/s] or [N/s]: what a late torque leaves."""
        rate = np.zeros_like(self.load)
        for one in np.unique(self.samples.run):
            here = self.samples.run == one
            if here.sum() > 2:
                rate[:, here] = np.gradient(self.load[:, here], self.dt, axis=1)
        return rate

    def last_body(self, joint: int) -> int:
        """Return the last of the bodies that a joint moves."""
        return int(self.robot.columns(joint)[-1]) // 10

    @cached_property
    def carried(self) -> np.ndarray:
        """Torque that a unit mass at each body's origin takes, and unit first moments, (n_bodies, n, 4, M)."""
        n, M, _ = self.samples.rigid.shape
        return np.ascontiguousarray(self.samples.rigid.reshape(n, M, -1, 10)[..., :4].transpose(2, 0, 3, 1))

    @cached_property
    def pressed(self) -> np.ndarray:
        """Torque against a unit force and moment at each body's origin, in the base's axes, (n_bodies, n, 6, M)."""
        bodies = []
        for body in range(self.robot.n_bodies):
            parts = [
                self._seen_by(tile, -self.robot.jacobian(tile.states.q.mT, body).movedim(0, -1))
                for tile in self.samples.tiles
            ]
            bodies.append(np.concatenate(parts, axis=-1).swapaxes(0, 1))
        return np.stack(bodies)

    @cached_property
    def outermost(self) -> int:
        """The last of the bodies that most joints move."""
        moved = [sum(body in self.robot.columns(j) // 10 for j in self.seen) for body in range(self.robot.n_bodies)]
        return int(np.flatnonzero(np.array(moved) == max(moved))[-1])

    @cached_property
    def held(self) -> np.ndarray:
        """Torque that holds a unit mass at each body's origin, and that a first moment adds, per axis of a force.

        (n_bodies, n, 4, 3, M): entry [..., 0, k, :] is J' e_k, the torque against a force of -1 N along the base's axis
        k at the body's origin; [..., 1 + i, k, :] what it grows by for each metre of the point of attack along the
        body's axis i.
        """
        parts = []
        for tile in self.samples.tiles:
            q = tile.states.q
            still = torch.zeros_like(q)
            for axis in torch.eye(3, dtype=torch.float64):
                Y = self.robot.regressor_batch_last(q, still, still, -axis).unflatten(1, (-1, 10))[:, :, :4]
                parts.append(self._seen_by(tile, Y))
        axes = [np.concatenate(parts[k::3], axis=-1) for k in range(3)]
        return np.ascontiguousarray(np.stack(axes, axis=3).swapaxes(0, 1))

    @staticmethod
    def _seen_by(tile: Tile, x: torch.Tensor) -> np.ndarray:
        return tile.states.decimate(x.contiguous())[..., tile.kept].numpy()
