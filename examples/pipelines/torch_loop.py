"""A plain torch loop trains a robot's inertia and friction on a recording: the module is a layer like any other.

The bundled arm's URDF has its masses wrong by up to 10 % and knows no friction; the recorded arm has 2.4 N m of it at
joint3. Whatever the optimiser does, the inertia stays that of a body. ``torchrbd.identify`` does this better and says
how sure it is; a loop is for what is trained beside a model, or by another loss.

    python examples/pipelines/torch_loop.py
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.signal import savgol_filter
from torch import Tensor

import torchrbd

DEMO = Path(torchrbd.__file__).with_name("demo")
EFFECTS = ["viscous_friction", "coulomb_friction"]
WINDOW, DEGREE = 25, 4  # of the local polynomials that smooth and differentiate: a tenth of a second
EVERY = 10  # samples, of 250 a second
SLOW = 0.05  # rad/s
STEPS = 300


def recorded(robot: torchrbd.RobotModel, name: str) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return q, qd, qdd and tau (N, n_dof) of a bundled recording, all through one filter without delay."""
    chunks = list(torchrbd.open_recording(DEMO / f"{name}.parquet", robot.joint_names).chunks())
    q, tau = (np.concatenate([getattr(chunk, signal) for chunk in chunks]) for signal in ("q", "tau"))
    dt = float(chunks[0].t[1] - chunks[0].t[0])
    found = [savgol_filter(q, WINDOW, DEGREE, deriv=order, delta=dt, axis=0) for order in range(3)]
    found.append(savgol_filter(tau, WINDOW, DEGREE, axis=0))
    q, qd, qdd, tau = (torch.from_numpy(np.ascontiguousarray(x[WINDOW:-WINDOW:EVERY])) for x in found)
    return q, qd, qdd, tau


def errors(model: Callable[..., Tensor], data: Sequence[Tensor], variance: Tensor | None = None) -> Tensor:
    """Return squared torque errors (N, n_dof) over the variance of the joints' torques, if not that of the data."""
    q, qd, qdd, tau = data
    return (model(q, qd, qdd) - tau).square() / (tau.var(0) if variance is None else variance)


def loss(model: Callable[..., Tensor], data: Sequence[Tensor], variance: Tensor | None = None) -> Tensor:
    """Return the mean error in motion: around a reversal the filter smears what dry friction does."""
    return (errors(model, data, variance) * (data[1].abs() > SLOW)).mean()


def optimiser_of(model: torchrbd.RigidBodyDynamics) -> torch.optim.Optimizer:
    """Return Adam with a rate of its own for friction [N m], as the coordinates of inertia are of another size."""
    friction = [term.coefficients for term in model.terms]
    return torch.optim.Adam([{"params": [model.raw_inertia], "lr": 0.01}, {"params": friction, "lr": 0.2}])


def dry_friction(model: torchrbd.RigidBodyDynamics, joint: str) -> float:
    """Return the Coulomb friction at a joint [N m]."""
    (term,) = (t for t in model.terms if t.effect.id == "coulomb_friction" and t.site.name(model.robot) == joint)
    return term.parameters_by_name()["coulomb"]


def main() -> float:
    """Train, and return the held-out error as a part of the URDF's."""
    model = torchrbd.RigidBodyDynamics.from_urdf(DEMO / "arm.urdf", effects=EFFECTS)
    training, held_out = (recorded(model.robot, name) for name in ("fit", "holdout"))
    before = errors(model, held_out).mean().item()
    optimiser = optimiser_of(model)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS)
    for _ in range(STEPS):
        optimiser.zero_grad()
        loss(model, training).backward()
        optimiser.step()
        schedule.step()
    after = errors(model, held_out).mean().item()
    print(f"held-out nmse: {before:.4f} with the URDF, {after:.5f} after {STEPS} steps")
    print(f"Coulomb friction at joint3: {dry_friction(model, 'joint3'):.2f} N m, 2.4 in truth")
    return after / before


if __name__ == "__main__":
    main()
