"""Computed torque by two models of one arm: the rigid body that its URDF says, and that with the friction it has.

    tau = model(q, qd_ref, qdd_ref + K_d (qd_ref - qd) + K_p (q_ref - q))

The true arm is a model with friction too, moved by ``model.step``: its implicit friction allows a step of 5 ms although
the sign of dry friction changes within a thousandth of a radian a second. Friction is compensated at the velocity that
is wanted: at the measured one it would chatter about standstill.

    python examples/pipelines/computed_torque.py
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

import torchrbd

DEMO = Path(torchrbd.__file__).with_name("demo")
DRY = [4.0, 6.0, 2.4, 0.4, 0.4, 0.05]  # N m
VISCOUS = [2.0, 3.0, 1.0, 0.1, 0.1, 0.02]  # N m s/rad
DT, SECONDS = 0.005, 1.0
KP, KD = 100.0, 20.0  # 1/s^2, 1/s


def with_friction() -> torchrbd.RigidBodyDynamics:
    """Return the arm with friction at every joint."""
    model = torchrbd.RigidBodyDynamics.from_urdf(DEMO / "arm.urdf", effects=["coulomb_friction", "viscous_friction"])
    with torch.no_grad():
        for term, value in zip(model.terms, DRY + VISCOUS, strict=True):
            term.coefficients.fill_(value)
    return model


def reference(t: float) -> tuple[Tensor, Tensor, Tensor]:
    """Return q, qd and qdd (6,) of the motion that is wanted: to and fro, each joint at its own frequency."""
    pose = torch.tensor([0.0, -0.6, 1.0, 0.0, 0.5, 0.0], dtype=torch.float64)
    omega = 2.0 * torch.pi * torch.tensor([0.5, 0.6, 0.7, 0.8, 0.9, 1.0], dtype=torch.float64)
    angle = omega * t
    return pose + 0.3 * (1.0 - angle.cos()), 0.3 * omega * angle.sin(), 0.3 * omega**2 * angle.cos()


@torch.no_grad()
def tracking_error(controller: torchrbd.RigidBodyDynamics, arm: torchrbd.RigidBodyDynamics) -> Tensor:
    """Return the RMS position error of each joint (6,) [rad]."""
    q, qd, _ = reference(0.0)
    squares = torch.zeros_like(q)
    steps = round(SECONDS / DT)
    for k in range(steps):
        q_ref, qd_ref, qdd_ref = reference(k * DT)
        squares += (q_ref - q).square() / steps
        tau = controller(q, qd_ref, qdd_ref + KD * (qd_ref - qd) + KP * (q_ref - q))
        q, qd = arm.step(q, qd, tau, DT)
    return squares.sqrt()


def main() -> float:
    """Return the largest of the joints' errors with friction in the controller, as a part of that without."""
    arm = with_friction()
    without = tracking_error(torchrbd.RigidBodyDynamics.from_urdf(DEMO / "arm.urdf"), arm)
    with_ = tracking_error(with_friction(), arm)
    for name, errors in (("without", without), ("with", with_)):
        told = ", ".join(f"{1e3 * e:.2f}" for e in errors.tolist())
        print(f"RMS tracking error {name} friction in the controller: {told} mrad")
    return (with_ / without).max().item()


if __name__ == "__main__":
    main()
