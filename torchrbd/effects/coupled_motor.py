"""Coupled motor: a motor turns with a sum of two joints' motions, as in a differential or hollow wrist.

Its friction and its rotor's inertia act along theta = q + r q_other. By virtual work, they act on both joints:

    tau = f,   tau_other = r f,   f = d omega + c sign(omega) + I_r domega/dt,   omega = qd + r qd_other

The two motors of a differential have r = 1 and r = -1. So has a motor that drives its joint through the joint before,
by concentric shafts with bevel gears of one size.

Only axes that cross are searched, as in wrists. Where two axes are parallel, as in a parallelogram, rotors at both
joints and other link inertias have the same effect: I (qdd - qdd_other) + I (qdd + qdd_other) = 2 I qdd.

Source: Janot, Vandanjon, Gautier, "A Generic Instrumental Variable Approach for Industrial Robot Identification",
    IEEE Transactions on Control Systems Technology 2014, on the wrist of the Staubli TX40.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, Effect, Mjcf, Shape
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window, carrier
from torchrbd.robot import RobotModel

# Sine of the angle below which two axes count as parallel.
_PARALLEL = 0.1


class CoupledMotor(Effect):
    """tau += f, tau_other += r f, with f = d omega + c sign(omega) + I_r domega/dt and omega = qd + r qd_other.

    d, c and I_r are the motor's viscous and Coulomb friction and its rotor's inertia, all >= 0; r is 1 or -1. A site is
    a revolute joint and the joint that carries it, with axes that are not parallel.
    """

    id = "coupled_motor"
    family = "transmission"
    words = "friction and rotor of a motor that moves two joints"
    equation = "d omega + c sign(omega) + I_r domega/dt, omega = qd + r qd_other; r times that at the other"
    shown_by = (
        "Both joints move with equal and with opposite speeds: friction follows the speed of the motor, not of a joint."
    )
    other_signal = "qd"
    own_signals = ("qd",)
    units: ClassVar[Mapping[str, str]] = {
        "viscous": "{tau} s/{q}",
        "coulomb": "{tau}",
        "rotor_inertia": "{tau} s^2/{q}",
        "ratio": "1",
    }
    whole_robot = True
    kinds: ClassVar[Mapping[str, Mapping[float, str]]] = {"ratio": {}}
    several = True
    prior = CoefficientPrior("A motor's friction resists its motion, and its inertia is not negative.", (0, 1, 2))

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        pairs = ((joint, carrier(robot, joint)) for joint in range(robot.n_dof))
        return tuple(
            Site(joint, other=below) for joint, below in pairs if below is not None and _cross(robot, joint, below)
        )

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return {"ratio": 1.0}, {"ratio": -1.0}

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        assert site.joint is not None
        assert site.other is not None
        own, other, r = signals.joint(site.joint), signals.joint(site.other), shape["ratio"]
        omega = own.qd + r * other.qd
        direction = torch.tanh(omega / (own.rest_width**2 + (r * other.rest_width) ** 2) ** 0.5)
        of_motor = {"omega": omega, "sign(omega)": direction, "domega/dt": own.qdd + r * other.qdd}
        place = f"{site.name(signals.robot)} ({r:.6g})"
        return {f"{label} {place}": self._at_both(phi, site, r, signals) for label, phi in of_motor.items()}

    @staticmethod
    def _at_both(phi: Tensor, site: Site, ratio: float, signals: Signals) -> Tensor:
        """Return the torques (n, *batch) of a force phi (*batch) along the motor's motion."""
        share = {site.joint: 1.0, site.other: ratio}
        return torch.stack([share.get(j, 0.0) * phi for j in range(signals.robot.n_dof)])

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return dict(zip(self.units, (*coefficients, coefficients.new_tensor(shape["ratio"])), strict=True))

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        viscous, coulomb, inertia, ratio = (parameters[name] for name in self.units)
        return (viscous, coulomb, inertia), {"ratio": ratio}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return all(parameters[name] >= 0 for name in ("viscous", "coulomb", "rotor_inertia"))

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        viscous, coulomb, inertia, ratio = (parameters[name] for name in self.units)
        along = {"damping": viscous, "frictionloss": coulomb, "armature": inertia}
        return {"fixed": {**along, "coef": (1.0, ratio)}}


def _cross(robot: RobotModel, joint: int, other: int) -> bool:
    """Return whether both joints are revolute with axes that are not parallel; no motion changes that."""
    if bool(robot.prismatic[joint] | robot.prismatic[other]):
        return False
    axes = robot.jacobian(torch.zeros(robot.n_dof, dtype=torch.float64), robot.joint_bodies[joint])[3:]
    return float(torch.linalg.cross(axes[:, joint], axes[:, other]).norm()) > _PARALLEL
