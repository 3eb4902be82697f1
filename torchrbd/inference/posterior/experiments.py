"""Short motions that could be added to a recording, and the information of each.

A motion is a handful of states, worth ``SECONDS`` of recording at the present noise; its information about x is

    H = sum_j w_j sum_states a_j a_j',   w_j = seconds rate / (states sigma_j^2)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from torchrbd.display import Remark
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.posterior.predictive import torque_rows
from torchrbd.robot import RobotModel

Kind = Literal["slow", "accelerate", "fast", "all"]
KINDS: tuple[Kind, ...] = ("slow", "accelerate", "fast")
"""One joint through its range: at rest (gravity), accelerating back and forth, at constant speed (centrifugal)."""

SECONDS = 10.0
_STATES = 16
# [rad/s, rad/s^2, rad] and [m/s, m/s^2, m]: what most arms can do; less where the limits say so.
_REVOLUTE, _PRISMATIC = (2.0, 3.0, math.pi), (0.3, 1.0, 0.3)
_OF_LIMIT = 0.5


@dataclass(frozen=True)
class Motion:
    """A motion to add.

    Attributes:
        kind: how the joint moves; "all" moves all joints at once, at changing speed.
        joint: index of the joint that moves, or None.
        varied: indices of the joints that stand still in several postures meanwhile; the others keep one.
    """

    kind: Kind
    joint: int | None
    varied: tuple[int, ...]


def extent(robot: RobotModel, joint: int) -> tuple[float, float, float, float]:
    """Return a moderate speed and acceleration of a joint, and the lower and upper end of a range inside its limits."""
    speed, acceleration, reach = _PRISMATIC if bool(robot.prismatic[joint]) else _REVOLUTE
    lower, upper, velocity = (float(v[joint]) for v in (robot.lower, robot.upper, robot.velocity))
    if velocity > 0.0:
        speed = min(speed, _OF_LIMIT * velocity)
    low, high = max(lower, -reach), min(upper, reach)
    if low >= high:  # The range does not hold zero, or is a single point.
        low, high = (lower, upper) if math.isfinite(lower + upper) else (lower, lower + reach)
        low, high = (low, high) if math.isfinite(low + high) else (upper - reach, upper)
    return speed, acceleration, 0.95 * low + 0.05 * high, 0.05 * low + 0.95 * high


def states(robot: RobotModel, motion: Motion) -> tuple[Tensor, Tensor, Tensor]:
    """Return q, qd, qdd (states, n_dof) of a motion."""
    speed, acceleration, low, high = torch.tensor([extent(robot, j) for j in range(robot.n_dof)], dtype=torch.float64).T
    u = torch.quasirandom.SobolEngine(3 * robot.n_dof, scramble=True, seed=0).draw(_STATES, dtype=torch.float64)
    spread, turn, push = u.chunk(3, 1)
    q = torch.zeros(_STATES, robot.n_dof, dtype=torch.float64).clamp(low, high)
    qd, qdd = torch.zeros_like(q), torch.zeros_like(q)
    moving = range(robot.n_dof) if motion.joint is None else (motion.joint, *motion.varied)
    for j in moving:
        q[:, j] = low[j] + (high[j] - low[j]) * spread[:, j]
    if motion.joint is None:
        return q, speed * (2.0 * turn - 1.0), acceleration * (2.0 * push - 1.0)
    sign = torch.ones(_STATES, dtype=torch.float64)
    sign[1::2] = -1.0
    if motion.kind == "fast":
        qd[:, motion.joint] = sign * speed[motion.joint]
    if motion.kind == "accelerate":
        qdd[:, motion.joint] = sign * acceleration[motion.joint]
    return q, qd, qdd


def information(model: FittedModel, motion: Motion, T: Tensor, rate_hz: float) -> Tensor:
    """Return the information of a motion on the free coefficients in coordinates T, (n_free, n_free).

    Args:
        model: the fit, which gives the noise.
        motion: the motion.
        T: (n_free, n_free), coefficients = T y.
        rate_hz: independent samples a second, twice the cut-off.
    """
    columns = model.columns
    place = torch.full((columns.n,), -1, dtype=torch.long)
    place[model.free] = torch.arange(len(model.free))
    q, qd, qdd = (v.T.contiguous() for v in states(columns.robot, motion))
    found = torch.zeros_like(T)
    for variance, (index, a) in zip(model.noise_variance.tolist(), torque_rows(model, q, qd, qdd), strict=True):
        if math.isinf(variance):
            continue
        at = place[index]
        own = T[at[at >= 0]]
        # A joint has no information on bodies that it does not move.
        seen = torch.nonzero(own.any(0)).flatten()
        row = (SECONDS * rate_hz / (a.shape[1] * variance)) ** 0.5 * (own[:, seen].T @ a[at >= 0])
        found[seen.unsqueeze(1), seen] += row @ row.T
    return found


def described(robot: RobotModel, motion: Motion) -> Remark:
    """Return what to do, with names and sizes."""
    if motion.joint is None:
        return Remark("motion", {"kind": motion.kind})
    speed, acceleration, *_ = extent(robot, motion.joint)
    values = {
        "kind": motion.kind,
        "joint": robot.joint_names[motion.joint],
        "unit": "m" if bool(robot.prismatic[motion.joint]) else "rad",
        "speed": speed,
        "acceleration": acceleration,
        "varied": [robot.joint_names[k] for k in motion.varied],
        "others": robot.n_dof - 1,
    }
    return Remark("motion", values)
