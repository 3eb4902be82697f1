"""The one model: a rigid body with trainable, always physical inertial parameters, and terms for what a rigid body
leaves out.

    tau = Y(q, qd, qdd) pi(theta) + sum_terms sum_k w_k phi_k

It is what a fit returns, what findings extend, what is exported, and what a learning pipeline differentiates through.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn

from torchrbd.display import brief, few
from torchrbd.effects import Signals, Term
from torchrbd.effects.plain_friction import plain_friction
from torchrbd.errors import InputError, OptionError
from torchrbd.model.conditions import NO_CONDITION, Condition, Reported, condition_of, interval
from torchrbd.model.files import read_model, write_model
from torchrbd.model.plain_terms import is_plain, placing, plain_torque
from torchrbd.model.starting import REST_WIDTH, described_terms, starting_terms
from torchrbd.model.stepping import implicit_velocity, runge_kutta
from torchrbd.parameters import PARAMETERS_PER_BODY, from_log_cholesky, is_physical, to_log_cholesky
from torchrbd.recordings import Drives, States
from torchrbd.robot import RobotModel

METHODS = ("semi_implicit", "runge_kutta")
"""Integration methods of ``step``."""


class RigidBodyDynamics(nn.Module):
    """Inverse dynamics as a module: ``tau = model(q, qd, qdd)``.

        model = RigidBodyDynamics.from_urdf("robot.urdf", effects=["viscous_friction", "coulomb_friction"])
        loss = (model(q, qd, qdd) - tau).square().mean()

    States are (*batch, n_dof) tensors whose batches broadcast, in float32 or float64, on any device; results have the
    same dtype and device. Methods are differentiable in states and parameters. They compose with ``torch.func``,
    ``torch.compile`` and ``torch.export``. The robot stays physical for all values of the trained parameters.

    Args:
        robot: kinematics, gravity and names.
        pi: (n_params,) inertial parameters; the robot's own by default.
        terms: effects that add to the torque.
        rest_width: (n_dof,) speed below which the direction of motion is uncertain; ``REST_WIDTH`` by default.
        conditions: of recordings, by name: their clocks, known loads and held-out rows. The key "" is for recordings
            without an entry.
        reported: the error that was reported for the model, see ``torchrbd.replay``.
        drives: position drives of the robot, whose gains simulators need; None if torques were recorded.

    Attributes:
        raw_inertia: (n_physical, 10) log-Cholesky coordinates; any values give a physical robot.
        constant_pi: (n_bodies, 10) parameters of bodies without such coordinates (massless ones), zero elsewhere.
        physical: (n_bodies,) bool, which bodies have such coordinates.
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
        conditions: Mapping[str, Condition] | None = None,
        reported: Reported | None = None,
        drives: Drives | None = None,
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
        self.conditions, self.reported, self.drives = dict(conditions or {}), reported, drives
        self._terms = nn.ModuleList(terms)
        # Most terms are baseline friction: they are evaluated together. Each is registered once, above.
        self._plain = tuple(term for term in self.terms if is_plain(term))
        self._others = tuple(term for term in self.terms if not is_plain(term))
        self._has_terms = bool(self.terms)
        self._placing = placing(robot.n_dof, self._plain)
        # A list: indexing by a tensor would neither batch nor trace.
        self._trained = physical.nonzero().flatten().tolist()
        self._all_trained = len(self._trained) == robot.n_bodies

    def __repr__(self) -> str:
        terms = [f"{term.effect.id} at {term.site.name(self.robot)}" for term in self.terms]
        return brief(self, robot=self.robot.name, joints=few(self.robot.joint_names), terms=few(terms))

    @classmethod
    def from_urdf(
        cls,
        source: str | Path | bytes,
        *,
        gravity: Sequence[float] | Tensor | None = None,
        effects: Sequence[str] = (),
    ) -> RigidBodyDynamics:
        """Read a URDF or MJCF, as ``RobotModel.from_urdf``, including friction, rotors and springs.

        Args:
            source, gravity: as for ``RobotModel.from_urdf``.
            effects: terms to train, initially zero: "viscous_friction" at all its places, "joint_spring@joint2" at one;
                ``torchrbd.known_effects()`` lists them. Nonlinear shape parameters are in the middle of the range that
                the URDF's limits allow.

        Raises:
            RobotError: the file cannot be used.
            OptionError: an unknown effect or place.
        """
        robot = RobotModel.from_urdf(source, gravity=gravity)
        return cls(robot, terms=[*described_terms(robot), *starting_terms(robot, effects)])

    @classmethod
    def from_diagnosis(cls, diagnosis: Any) -> RigidBodyDynamics:
        """Return the model of a result: a ``Diagnosis``, an ``Identification``, or the folder that a command wrote.

        The model of an object is not copied.

        Raises:
            InputError: there is no model in it.
        """
        if isinstance(diagnosis, (str, Path)):
            return cls.load(diagnosis)
        model = getattr(getattr(diagnosis, "identification", diagnosis), "model", None)
        if not isinstance(model, RigidBodyDynamics):
            raise InputError(
                f"expected a Diagnosis, an Identification or a folder of results, got {type(diagnosis).__name__}"
            )
        return model

    @classmethod
    def load(cls, path: str | Path) -> RigidBodyDynamics:
        """Read a model that ``save`` wrote; in a folder of results it is model.safetensors.

        Raises:
            InputError: there is no such file, or it is not a model of torchrbd.
        """
        found = read_model(path)
        about = {"conditions": found.conditions, "reported": found.reported, "drives": found.drives}
        model = cls(found.robot, found.pi, found.terms, **about)
        model.load_state_dict(found.state)
        return model

    def save(self, path: str | Path) -> None:
        """Write the model to a safetensors file: numbers, URDF and terms, no code.

        Raises:
            RobotError: the robot was not made from a URDF.
        """
        about = {"conditions": self.conditions, "reported": self.reported, "drives": self.drives}
        write_model(path, self.robot, self.terms, self.state_dict(), **about)

    @property
    def terms(self) -> tuple[Term, ...]:
        """Effects that add to the torque of the rigid body."""
        return tuple(term for term in self._terms if isinstance(term, Term))

    @property
    def pi(self) -> Tensor:
        """Inertial parameters (n_params,), differentiable in ``raw_inertia``."""
        pi = from_log_cholesky(self.raw_inertia)
        if self._all_trained:
            return pi.flatten()
        bodies, trained = list(self.constant_pi.unbind(0)), pi.unbind(0)
        for body, pi in zip(self._trained, trained, strict=True):
            bodies[body] = pi
        return torch.cat(bodies)

    def forward(
        self,
        q: Tensor,
        qd: Tensor,
        qdd: Tensor,
        t: Tensor | None = None,
        temperature: Tensor | None = None,
        recording: str | None = None,
    ) -> Tensor:
        """Return the torque that the actuators must supply, or, with ``recording``, that recording's torque column.

        A recording's torque may be delayed, a command of actuators with lag, or include a known load: see
        ``conditions``. A recording without an entry has no load, and the clock of the fitted recordings if they agree
        (``conditions[""]``).

        Args:
            q, qd, qdd: (*batch, n_dof), [rad, m] and per second, per second squared.
            t: (N,) evenly spaced times of the last batch dimension [s], or one time. Only effects with memory or that
                depend on time, and recordings with a clock offset, need it.
            temperature: (*batch, n_dof) of the joints [deg C]; without it thermal effects are zero.
            recording: name of the recording whose condition applies. Without it, effects of single recordings are zero,
                and torque and motion are simultaneous.

        Returns:
            (*batch, n_dof), [N m] or [N].
        """
        condition, torque = self.condition(recording), self._acting(q, qd, qdd, t, temperature, recording)
        if not condition.moves_torque:
            return torque
        return condition.recorded(torque.movedim(-1, 0), interval(t, recording)).movedim(0, -1)

    inverse_dynamics = forward

    def condition(self, recording: str | None) -> Condition:
        """Return the condition of a recording: from ``conditions``, that of unknown recordings, or an empty one."""
        return condition_of(self.conditions, recording) if self.conditions else NO_CONDITION

    def acting_torque(self, tau: Tensor, t: Tensor, recording: str | None) -> Tensor:
        """Return the torque that acts at the time of the motion, given the recorded one.

        A delayed torque is shifted in time; a command is passed through the actuators' lag. ``forward_dynamics`` and
        ``step`` take the result.

        Args:
            tau: (*batch, N, n_dof) as recorded [N m, N].
            t: (N,) evenly spaced times [s].
            recording: its name; without one, the torque is returned unchanged.
        """
        condition = self.condition(recording)
        if not condition.moves_torque:
            return tau
        return condition.acting(tau.movedim(-1, 0), interval(t, recording)).movedim(0, -1)

    def along(self, states: States) -> Tensor:
        """Return the model's prediction of the torque column for a tile, (n_dof, N), at the tile's full rate."""
        warm = None if states.temperature is None else states.temperature.T
        signals = states.q.T, states.qd.T, states.qdd.T, states.t, warm, states.recording
        torque, condition = self._acting(*signals, states.turned).T, self.condition(states.recording)
        return condition.recorded(torque, states.dt) if condition.moves_torque else torque

    def _acting(
        self,
        q: Tensor,
        qd: Tensor,
        qdd: Tensor,
        t: Tensor | None,
        temperature: Tensor | None,
        recording: str | None,
        turned: tuple[Tensor, ...] = (),
    ) -> Tensor:
        """Return the torque that acts at the time of the motion; arguments as in ``forward``."""
        with _full_precision(q):
            rigid = self.robot.physical_torque(q, qd, qdd, self.raw_inertia) if self._all_trained else None
            if rigid is None:
                rigid = self.robot.inverse_dynamics(q, qd, qdd, self.pi)
            load = self.condition(recording).load
            if load is not None:
                rigid = rigid + self.robot.inverse_dynamics(q, qd, qdd, load.to(q))
            if not self._has_terms:
                return rigid
            return rigid + self._term_torque(q, qd, qdd, t, temperature, recording, turned)

    def _carried(self, recording: str | None) -> Tensor:
        """Return the inertial parameters (n_params,) of the robot with its known load."""
        load = self.condition(recording).load
        return self.pi if load is None else self.pi + load.to(self.pi)

    def term_torque(
        self,
        q: Tensor,
        qd: Tensor,
        qdd: Tensor,
        t: Tensor | None = None,
        temperature: Tensor | None = None,
        recording: str | None = None,
    ) -> Tensor:
        """Return the torque of the terms, (*batch, n_dof); arguments as in ``forward``."""
        self.robot.check(q, qd, qdd)
        with _full_precision(q):
            return self._term_torque(q, qd, qdd, t, temperature, recording)

    def _term_torque(
        self,
        q: Tensor,
        qd: Tensor,
        qdd: Tensor,
        t: Tensor | None,
        temperature: Tensor | None,
        recording: str | None,
        turned: tuple[Tensor, ...] = (),
    ) -> Tensor:
        q, qd, qdd = torch.broadcast_tensors(q, qd, qdd)
        plain = plain_torque(self._plain, self._placing, qd, self.rest_width)
        if not self._others:
            return plain
        q, qd, qdd = (x.movedim(-1, 0) for x in (q, qd, qdd))
        warm = None if temperature is None else temperature.movedim(-1, 0)
        constant = ((term.effect, term.site.joint, term.coefficients) for term in self.terms if term.site.always)
        friction = plain_friction(self.robot.n_dof, constant)
        known = (self.rest_width, self._carried(recording), t, recording, warm, friction, turned)
        signals = Signals(self.robot, q, qd, qdd, *known)
        torques = list(plain.unbind(-1))
        for term in self._others:
            added = term(signals)
            for j in range(len(torques)) if term.effect.whole_robot else (term.site.joint,):
                assert j is not None
                torques[j] = torques[j] + (added[j] if term.effect.whole_robot else added)
        return torch.stack(torques, -1)

    def mass_matrix(self, q: Tensor, t: Tensor | None = None, recording: str | None = None) -> Tensor:
        """Return the joint-space mass matrix (*batch, n_dof, n_dof), rotors included.

        Args:
            q: (*batch, n_dof) [rad, m].
            t, recording: as in ``forward``.
        """
        return self._at_rest(q, torch.zeros_like(q), t, None, recording)[0]

    def bias_forces(
        self,
        q: Tensor,
        qd: Tensor,
        t: Tensor | None = None,
        temperature: Tensor | None = None,
        recording: str | None = None,
    ) -> Tensor:
        """Return the torque (*batch, n_dof) at zero acceleration: gravity, Coriolis forces and terms."""
        return self._acting(q, qd, torch.zeros_like(qd), t, temperature, recording)

    def gravity(self, q: Tensor) -> Tensor:
        """Return the torque (*batch, n_dof) that holds the rigid body against gravity."""
        still = torch.zeros_like(q)
        with _full_precision(q):
            return self.robot.inverse_dynamics(q, still, still, self.pi)

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

        The terms are treated as linear in qdd.

        Args:
            q, qd, tau: (*batch, n_dof); the torque that acts, see ``acting_torque``.
            t: (N,) times of the last batch dimension, or one time [s]; only effects that depend on time need it.
            temperature, recording: as in ``forward``.

        Raises:
            InputError: a term has memory: its torque depends on past states.
            PhysicalError: the mass matrix is not positive definite (a moving body without mass or rotor inertia).
        """
        self.robot.check(q, qd, tau)
        mass, rigid, added = self._at_rest(q, qd, t, temperature, recording)
        return self.robot.accelerate(mass, tau - rigid - added)

    def step(
        self,
        q: Tensor,
        qd: Tensor,
        tau: Tensor,
        dt: float | Tensor,
        t: Tensor | None = None,
        *,
        method: Literal["semi_implicit", "runge_kutta"] = "semi_implicit",
        temperature: Tensor | None = None,
        recording: str | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return position and velocity a time dt later, under a constant torque.

        "semi_implicit" solves for the velocity at the end of the step at which all forces balance. It is stable, and
        its derivatives are bounded, for any stiffness of friction. "runge_kutta" (fourth order) is for smooth forces.

        Args:
            q, qd, tau: (*batch, n_dof).
            dt: [s].
            t: at the start of the step [s]; only effects that depend on time need it.
            temperature, recording: as in ``forward``.

        Raises:
            InputError: a term has memory: its torque depends on past states.
            OptionError: an unknown method.
            PhysicalError: the mass matrix is not positive definite.
        """
        self.robot.check(q, qd, tau)
        if method not in METHODS:
            raise OptionError(f"method is '{method}'; expected one of {', '.join(METHODS)}")
        if method == "runge_kutta":
            return runge_kutta(lambda q, qd: self.forward_dynamics(q, qd, tau, t, temperature, recording), q, qd, dt)
        q, qd, tau = torch.broadcast_tensors(q, qd, tau)
        still, instants = torch.zeros_like(q), _instants(t)

        def added(v: Tensor) -> Tensor:
            return self._term_torque(q, v, still, instants, temperature, recording)

        with _full_precision(q):
            mass, rigid, _ = self._at_rest(q, qd, t, temperature, recording)
            try:
                v = implicit_velocity(mass, rigid, added, qd, tau, dt, self.rest_width)
            except torch.linalg.LinAlgError:  # pyright: ignore[reportPrivateImportUsage]
                # Raises an error that names the joint.
                self.robot.accelerate(mass, tau)
                raise
        return q + dt * v, v

    def _at_rest(
        self, q: Tensor, qd: Tensor, t: Tensor | None, temperature: Tensor | None, recording: str | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the mass matrix, the terms' part of it, and the torques of rigid body and terms at no acceleration."""
        self.robot.check(q, qd)
        q, qd = torch.broadcast_tensors(q, qd)
        with _full_precision(q):
            # At zero and at each unit acceleration.
            unit = torch.eye(self.robot.n_dof, dtype=q.dtype, device=q.device)
            tries = torch.cat((torch.zeros_like(unit[:1]), unit)).reshape(-1, *[1] * (q.ndim - 1), len(unit))
            still, *moved = self._term_torque(q, qd, tries, _instants(t), temperature, recording)
            pi = self._carried(recording)
            mass = self.robot.mass_matrix(q, pi) + torch.stack([one - still for one in moved], -1)
            return mass, self.robot.inverse_dynamics(q, qd, torch.zeros_like(q), pi), still


def _full_precision(q: Tensor) -> AbstractContextManager[object]:
    """Compute in full precision, even inside a network's autocast, which does not change float64."""
    return nullcontext() if q.dtype is torch.float64 else torch.autocast(q.device.type, enabled=False)


def _instants(t: Tensor | None) -> Tensor | None:
    """Return times in the shape for states that are not a sequence, (1, N)."""
    return t.unsqueeze(0) if t is not None and t.ndim else t
