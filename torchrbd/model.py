"""The one model: a rigid body with trainable, always physical inertial parameters, and terms for what a rigid body
leaves out.

    tau = Y(q, qd, qdd) pi(theta) + sum_terms sum_k w_k phi_k

It is what a fit returns, what findings extend, what is exported, and what a learning pipeline differentiates through.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import torch
from torch import Tensor, nn

from torchrbd.errors import PhysicalError
from torchrbd.parameters import PARAMETERS_PER_BODY, from_log_cholesky, is_physical, to_log_cholesky
from torchrbd.physics import Term, effect
from torchrbd.robot import RobotModel

REST_WIDTH = 1e-3
"""Softness of the sign of velocity [rad/s, m/s] where no recording has told it."""


class RigidBodyDynamics(nn.Module):
    """Inverse dynamics as a module: ``tau = model(q, qd, qdd)``.

    Args:
        robot: kinematics, gravity and names.
        pi: (n_params,) inertial parameters; the robot's own by default.
        terms: what else adds to the torque.

    Attributes:
        raw_inertia: (n_physical, 10) log-Cholesky coordinates; any values give a physical robot.
        constant_pi: (n_bodies, 10) the parameters of bodies that have no such coordinates (massless ones), zero
            elsewhere.
    """

    raw_inertia: nn.Parameter
    constant_pi: Tensor
    physical: Tensor

    def __init__(self, robot: RobotModel, pi: Tensor | None = None, terms: Iterable[Term] = ()) -> None:
        super().__init__()
        self.robot = robot
        bodies = (robot.pi if pi is None else pi).detach().reshape(-1, PARAMETERS_PER_BODY).to(torch.float64)
        physical = is_physical(bodies)
        self.register_buffer("physical", physical)
        self.register_buffer("constant_pi", torch.where(physical.unsqueeze(1), torch.zeros_like(bodies), bodies))
        self.raw_inertia = nn.Parameter(to_log_cholesky(bodies[physical]))
        self._terms = nn.ModuleList(terms)

    @classmethod
    def from_urdf(cls, source: str | Path | bytes) -> RigidBodyDynamics:
        """Read a URDF with the friction of its <dynamics> tags: the model that a simulator of it runs."""
        robot = RobotModel.from_urdf(source)
        return cls(robot, terms=urdf_friction(robot))

    @property
    def terms(self) -> tuple[Term, ...]:
        """What adds to the rigid body's torque."""
        return tuple(term for term in self._terms if isinstance(term, Term))

    @property
    def pi(self) -> Tensor:
        """Inertial parameters (n_params,), differentiable in ``raw_inertia``."""
        trained = torch.zeros_like(self.constant_pi).index_put((self.physical,), from_log_cholesky(self.raw_inertia))
        return (self.constant_pi + trained).flatten()

    def forward(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return the torque that the actuators must supply.

        Args:
            q, qd, qdd: (*batch, n_dof), [rad, m] and per second, per second squared.

        Returns:
            (*batch, n_dof), [N m] or [N].
        """
        return self.robot.inverse_dynamics(q, qd, qdd, self.pi.to(q)) + self.term_torque(q, qd, qdd)

    def term_torque(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return what the terms add, (*batch, n_dof)."""
        q, qd, qdd = torch.broadcast_tensors(q, qd, qdd)
        torques = list(torch.zeros_like(q).unbind(-1))
        for term in self.terms:
            j = term.joint
            torques[j] = torques[j] + term(q[..., j], qd[..., j], qdd[..., j])
        return torch.stack(torques, -1)

    def forward_dynamics(self, q: Tensor, qd: Tensor, tau: Tensor) -> Tensor:
        """Return the acceleration qdd (*batch, n_dof) that a torque causes.

            qdd = (M(q) + diag(d tau_terms / d qdd))^-1 (tau - tau(q, qd, 0))

        Raises:
            PhysicalError: the mass matrix is not positive definite (a moving body without mass or rotor inertia).
        """
        still, unit = torch.zeros_like(q), torch.ones_like(q)
        armature = self.term_torque(q, qd, unit) - self.term_torque(q, qd, still)
        mass = self.robot.mass_matrix(q, self.pi.to(q)) + torch.diag_embed(armature)
        factor, info = torch.linalg.cholesky_ex(mass)
        if bool((info != 0).any()):
            raise PhysicalError(
                f"the mass matrix of robot '{self.robot.name}' is not positive definite: "
                "give the last moving links a mass, or the joints a rotor inertia"
            )
        return torch.cholesky_solve((tau - self(q, qd, still)).unsqueeze(-1), factor).squeeze(-1)


def urdf_friction(robot: RobotModel) -> list[Term]:
    """Return the terms that a URDF's <dynamics> tags stand for: damping is viscous, friction Coulomb friction."""
    terms = []
    for joint in range(robot.n_dof):
        for name, value in (("viscous_friction", robot.damping[joint]), ("coulomb_friction", robot.friction[joint])):
            if value:
                terms.append(Term(effect(name), joint, value.reshape(1), {}, REST_WIDTH))
    return terms
