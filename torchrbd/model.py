"""The one model: a rigid body with trainable, always physical inertial parameters, and terms for what a rigid body
leaves out.

    tau = Y(q, qd, qdd) pi(theta) + sum_terms sum_k w_k phi_k

It is what a fit returns, what findings extend, what is exported, and what a learning pipeline differentiates through.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from torchrbd.errors import PhysicalError
from torchrbd.parameters import PARAMETERS_PER_BODY, from_log_cholesky, is_physical, to_log_cholesky
from torchrbd.physics import Signals, Site, Term, effect
from torchrbd.physics.plain_friction import plain_friction
from torchrbd.robot import STANDARD_GRAVITY, RobotModel

REST_WIDTH = 1e-3
"""Softness of the sign of velocity [rad/s, m/s] where no recording has told it."""


class RigidBodyDynamics(nn.Module):
    """Inverse dynamics as a module: ``tau = model(q, qd, qdd)``.

    Args:
        robot: kinematics, gravity and names.
        pi: (n_params,) inertial parameters; the robot's own by default.
        terms: what else adds to the torque.
        rest_width: (n_dof,) speed below which the direction of motion is not told; ``REST_WIDTH`` by default.

    Attributes:
        raw_inertia: (n_physical, 10) log-Cholesky coordinates; any values give a physical robot.
        constant_pi: (n_bodies, 10) the parameters of bodies that have no such coordinates (massless ones), zero
            elsewhere.
    """

    raw_inertia: nn.Parameter
    constant_pi: Tensor
    physical: Tensor
    rest_width: Tensor

    def __init__(
        self,
        robot: RobotModel,
        pi: Tensor | None = None,
        terms: Iterable[Term] = (),
        rest_width: Tensor | None = None,
    ) -> None:
        super().__init__()
        self.robot = robot
        bodies = (robot.pi if pi is None else pi).detach().reshape(-1, PARAMETERS_PER_BODY).to(torch.float64)
        physical = is_physical(bodies)
        self.register_buffer("physical", physical)
        self.register_buffer("constant_pi", torch.where(physical.unsqueeze(1), torch.zeros_like(bodies), bodies))
        self.raw_inertia = nn.Parameter(to_log_cholesky(bodies[physical]))
        width = torch.full((robot.n_dof,), REST_WIDTH, dtype=torch.float64) if rest_width is None else rest_width
        self.register_buffer("rest_width", width.clone())
        self._terms = nn.ModuleList(terms)

    @classmethod
    def from_urdf(
        cls, source: str | Path | bytes, *, gravity: Sequence[float] | Tensor = STANDARD_GRAVITY
    ) -> RigidBodyDynamics:
        """Read a URDF, as ``RobotModel.from_urdf``, with the friction of its <dynamics> tags: what a simulator runs."""
        robot = RobotModel.from_urdf(source, gravity=gravity)
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

    def forward(
        self,
        q: Tensor,
        qd: Tensor,
        qdd: Tensor,
        t: Tensor | None = None,
        temperature: Tensor | None = None,
        recording: str | None = None,
    ) -> Tensor:
        """Return the torque that the actuators must supply.

        Args:
            q, qd, qdd: (*batch, n_dof), [rad, m] and per second, per second squared.
            t: (N,) evenly spaced times of the last batch dimension [s], or one time; only effects with memory or that
                depend on time need it.
            temperature: (*batch, n_dof) of the joints [deg C]; without it thermal effects are zero.
            recording: the one in whose condition the robot is; without it, what acts in some only is zero.

        Returns:
            (*batch, n_dof), [N m] or [N].
        """
        added = self.term_torque(q, qd, qdd, t, temperature, recording)
        return self.robot.inverse_dynamics(q, qd, qdd, self.pi.to(q)) + added

    def term_torque(
        self,
        q: Tensor,
        qd: Tensor,
        qdd: Tensor,
        t: Tensor | None = None,
        temperature: Tensor | None = None,
        recording: str | None = None,
    ) -> Tensor:
        """Return what the terms add, (*batch, n_dof); arguments as in ``forward``."""
        q, qd, qdd = (x.movedim(-1, 0) for x in torch.broadcast_tensors(q, qd, qdd))
        warm = None if temperature is None else temperature.movedim(-1, 0)
        plain = ((term.effect.id, term.site.joint, term.coefficients) for term in self.terms if term.site.always)
        friction = plain_friction(self.robot.n_dof, plain)
        known = (self.rest_width, self.pi, t, recording, warm, friction)
        signals = Signals(self.robot, q, qd, qdd, *known)
        torques = list(torch.zeros_like(signals.q).unbind(0))
        for term in self.terms:
            added = term(signals)
            for j in range(len(torques)) if term.effect.whole_robot else (term.site.joint,):
                assert j is not None
                torques[j] = torques[j] + (added[j] if term.effect.whole_robot else added)
        return torch.stack(torques, -1)

    def forward_dynamics(
        self,
        q: Tensor,
        qd: Tensor,
        tau: Tensor,
        t: Tensor | None = None,
        temperature: Tensor | None = None,
        recording: str | None = None,
    ) -> Tensor:
        """Return the acceleration qdd (*batch, n_dof) that a torque causes.

            qdd = (M(q) + d tau_terms / d qdd)^-1 (tau - tau(q, qd, 0))

        The terms are taken as linear in qdd.

        Args:
            q, qd, tau: (*batch, n_dof).
            t: (N,) times of the last batch dimension, or one time [s]; only effects that depend on time need it.
            temperature, recording: as in ``forward``.

        Raises:
            InputError: a term has memory: its torque is not one of the present state.
            PhysicalError: the mass matrix is not positive definite (a moving body without mass or rotor inertia).
        """
        # At rest and with each unit acceleration. Times of (1, N) are no sequence: every state is one of its own.
        unit = torch.eye(self.robot.n_dof, dtype=q.dtype, device=q.device)
        tries = torch.cat((torch.zeros_like(unit[:1]), unit)).reshape(-1, *[1] * (q.ndim - 1), len(unit))
        instants = t.unsqueeze(0) if t is not None and t.ndim else t
        still, *moved = self.term_torque(q, qd, tries, instants, temperature, recording)
        mass = self.robot.mass_matrix(q, self.pi.to(q)) + torch.stack([one - still for one in moved], -1)
        factor, info = torch.linalg.cholesky_ex(mass)
        if bool((info != 0).any()):
            raise PhysicalError(
                f"the mass matrix of robot '{self.robot.name}' is not positive definite: "
                "give the last moving links a mass, or the joints a rotor inertia"
            )
        rest = self.robot.inverse_dynamics(q, qd, torch.zeros_like(q), self.pi.to(q)) + still
        return torch.cholesky_solve((tau - rest).unsqueeze(-1), factor).squeeze(-1)


def urdf_friction(robot: RobotModel) -> list[Term]:
    """Return the terms that a URDF's <dynamics> tags stand for: damping is viscous, friction Coulomb friction."""
    terms = []
    for joint in range(robot.n_dof):
        for name, value in (("viscous_friction", robot.damping[joint]), ("coulomb_friction", robot.friction[joint])):
            if value:
                terms.append(Term(effect(name), Site(joint), value.reshape(1), {}))
    return terms
