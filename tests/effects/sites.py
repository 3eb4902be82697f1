"""Signals of a small robot, and places on it, to try effects at."""

from __future__ import annotations

import numpy as np
import torch
from robot.random_robots import random_urdf
from torch import Tensor

from torchrbd.effects import Effect, JointScale, Signals, Site, Window
from torchrbd.robot import RobotModel

ROBOT = RobotModel.from_urdf(random_urdf(5, 3, kinds=("revolute",), branching=0.0, massless=0.0))
SCALE = JointScale(
    speed_max=3.0, rest_width=0.02, q_low=-2.0, q_high=1.5, load_max=8.0, duration_s=30.0, temperature=(20.0, 50.0)
)
WINDOW = Window("rec", 0.1, 0.35)
STEP_S = 0.01


def states(*batch: int, seed: int = 1) -> tuple[Tensor, Tensor, Tensor]:
    """Return q, qd and qdd (n, *batch): smooth along the last dimension, which is time."""
    rng = np.random.default_rng(seed)
    t = STEP_S * np.arange(batch[-1] if batch else 1)
    shape = (ROBOT.n_dof, *batch[:-1], 4, 1)
    omega, phase, size = rng.uniform(3, 15, shape), rng.uniform(0, 6, shape), rng.uniform(0.1, 0.4, shape)
    q, qd, qdd = (
        (size * omega**k * np.sin(omega * t + phase + k * np.pi / 2)).sum(-2).reshape(ROBOT.n_dof, *batch)
        for k in range(3)
    )
    return torch.from_numpy(q), torch.from_numpy(qd), torch.from_numpy(qdd)


def signals(q: Tensor, qd: Tensor, qdd: Tensor, rest_width: float = SCALE.rest_width) -> Signals:
    """Return signals of the robot in a recording that the window is of; time only where there is a last dimension."""
    width = torch.full((ROBOT.n_dof,), rest_width, dtype=torch.float64)
    t = STEP_S * torch.arange(q.shape[-1], dtype=torch.float64) if q.ndim > 1 else None
    return Signals(ROBOT, q, qd, qdd, width, t=t, recording="rec", temperature=30.0 + 5.0 * q if q.ndim > 1 else None)


def site_of(effect: Effect) -> Site:
    """Return a place where the effect may sit: the middle one of those that there are, or the last of links.

    That link all joints move, so that all of a load or a force shows.
    """
    sites = effect.sites(ROBOT, (WINDOW,))
    return sites[-1] if sites[0].body is not None else sites[len(sites) // 2]
