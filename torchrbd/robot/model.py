"""The robot model: names, inertial parameters, inverse and forward dynamics."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchrbd.display import brief, few
from torchrbd.errors import InputError
from torchrbd.robot import compiled, dynamics, eager, kinematics
from torchrbd.robot.acceleration import accelerations
from torchrbd.robot.batching import batch_first, batch_last, is_ordinary, tiled
from torchrbd.robot.description import Description
from torchrbd.robot.gravity import STANDARD_GRAVITY, checked_gravity
from torchrbd.robot.inertia import PARAMETERS
from torchrbd.robot.reading import read_robot
from torchrbd.robot.tree import FoldedLink, build_tree, parent_axes

if TYPE_CHECKING:
    from torchrbd.robot.chain import Chain

EXACT = (torch.float64, torch.device("cpu"))
"""Dtype and device of the original constants; those of other dtypes and devices are converted from these."""

_BY_JOINT = ("damping", "friction", "armature", "stiffness", "rest", "lower", "upper", "velocity", "effort")


class RobotModel:
    """A fixed-base tree of rigid bodies.

    A body is the child link of a moving joint with all links that are fixed to it. The torque `Y pi` is linear in the
    bodies' inertial parameters. Bodies and joints are numbered depth-first, in the description's order: refer to them
    by name. Methods follow the dtype and device of their inputs, and are twice differentiable in all of them. On the
    CPU they run in compiled kernels if there is a C compiler, which builds them on first use.

    Attributes:
        name: the robot's name.
        joint_names: (n_dof,) the driving joints; mimic joints follow them and are not degrees of freedom.
        body_names: (n_bodies,) the child link of every moving joint.
        parameter_names: (n_params,) such as "mcx_link1".
        pi: (n_params,) inertial parameters [m, mcx, mcy, mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] of each body about its
            origin, in its axes, including links behind fixed joints [kg, kg m, kg m^2].
        folded: the links of each body, its own link first.
        joint_bodies: (n_dof,) the index of the body that each driving joint carries.
        prismatic: (n_dof,) bool.
        damping, friction: (n_dof,) viscous and Coulomb friction of the description; no method here includes it.
        armature, stiffness, rest: (n_dof,) rotors and springs of the description; only ``known_torque`` includes them.
        lower, upper, velocity, effort: (n_dof,) limits, infinite where not given.
        gravity: (3,) [m/s^2].
        urdf: the URDF text, if the robot came from one.
    """

    damping: Tensor
    friction: Tensor
    armature: Tensor
    stiffness: Tensor
    rest: Tensor
    lower: Tensor
    upper: Tensor
    velocity: Tensor
    effort: Tensor

    def __init__(self, description: Description, *, gravity: Sequence[float] | Tensor | None = None) -> None:
        tree = build_tree(description)
        self.description = description
        self.name = description.name
        self.urdf = description.urdf
        self.joint_names = tuple(joint.name for joint in tree.driving)
        self.body_names = tuple(joint.child for joint in tree.moving)
        self.parameter_names = tuple(f"{name}_{body}" for body in self.body_names for name in PARAMETERS)
        self.folded: dict[str, tuple[FoldedLink, ...]] = dict(zip(self.body_names, tree.folded, strict=True))
        self.joint_bodies = tuple(tree.moving.index(joint) for joint in tree.driving)
        self.pi = tree.pi
        self.gravity = checked_gravity((description.gravity or STANDARD_GRAVITY) if gravity is None else gravity)
        self.prismatic = torch.tensor([joint.kind == "prismatic" for joint in tree.driving])
        for name in _BY_JOINT:
            setattr(self, name, torch.tensor([getattr(joint, name) for joint in tree.driving], dtype=torch.float64))
        geometry = kinematics.build_geometry(tree)
        single = torch.float32, EXACT[1]
        self._geometries = {EXACT: geometry, single: geometry.to(*single)}
        self._tables = compiled.build_tables(geometry)
        self._chain: Chain | None = None

    def __repr__(self) -> str:
        return brief(self, name=self.name, joints=few(self.joint_names), mass=float(self.pi[:: len(PARAMETERS)].sum()))

    @classmethod
    def from_urdf(cls, source: str | Path | bytes, *, gravity: Sequence[float] | Tensor | None = None) -> RobotModel:
        """Read a robot from a URDF file or URDF text, or from MJCF, which MuJoCo compiles.

        Args:
            source: a path, or the text itself.
            gravity: (3,) in the base's axes [m/s^2]. Default: that of the MJCF, or 0 0 -9.81 for a URDF.

        Raises:
            RobotError: the file cannot be used; the message names the joint or link, and the remedy.
            OptionError: it is MJCF and MuJoCo is not installed, or gravity is invalid.
        """
        return cls(read_robot(source), gravity=gravity)

    @classmethod
    def from_chain(
        cls,
        chain: Chain,
        inertials: Mapping[str, Tensor],
        *,
        gravity: Sequence[float] | Tensor = STANDARD_GRAVITY,
    ) -> RobotModel:
        """Take the kinematics from a pytorch-kinematics chain; its offsets are exact to float32 only (about 1e-6).

        Args:
            chain: the chain; it has no inertials, friction or mimic joints.
            inertials: (10,) inertial parameters about the link's origin by link name; other links are massless.
            gravity: (3,) in the base's axes [m/s^2].

        Raises:
            RobotError: an inertial names no link of the chain.
        """
        from torchrbd.robot.chain import read_chain  # pytorch-kinematics takes long to import

        robot = cls(read_chain(chain, inertials), gravity=gravity)
        robot._chain = chain
        return robot

    def to_chain(self, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu") -> Chain:
        """Return the kinematics as a pytorch-kinematics chain; a mimic joint becomes a free joint.

        A robot that was made from a chain returns that chain unchanged.
        """
        from torchrbd.robot.chain import write_chain  # pytorch-kinematics takes long to import

        return self._chain or write_chain(self.description, dtype, device)

    @property
    def n_dof(self) -> int:
        """Number of driving joints."""
        return len(self.joint_names)

    @property
    def n_bodies(self) -> int:
        """Number of bodies: one for each moving joint, mimic joints included."""
        return len(self.body_names)

    @property
    def n_params(self) -> int:
        """Number of inertial parameters, `10 n_bodies`."""
        return len(self.parameter_names)

    @property
    def leaves(self) -> tuple[str, ...]:
        """Names of the bodies that carry no other body."""
        ends = self._geometries[EXACT].ends
        return tuple(name for k, name in enumerate(self.body_names) if ends[k] == k + 1)

    def known_torque(self, q: Tensor, qdd: Tensor) -> Tensor:
        """Return the torque of the description's rotors and springs: `armature qdd + stiffness (q - rest)`.

        Args:
            q, qdd: (*batch, n_dof) [rad, m] and per second squared.

        Returns:
            (*batch, n_dof), [N m] or [N].
        """
        armature, stiffness, rest = (x.to(q) for x in (self.armature, self.stiffness, self.rest))
        return armature * qdd + stiffness * (q - rest)

    def columns(self, joint_index: int) -> Tensor:
        """Return the indices of the parameters that can change a joint's torque: those of the bodies it moves."""
        geometry = self._geometries[EXACT]
        moved = set[int]()
        for body, (driver, end) in enumerate(zip(geometry.drivers, geometry.ends, strict=True)):
            if driver == range(self.n_dof)[joint_index]:
                moved.update(range(body, end))
        return (10 * torch.tensor(sorted(moved))[:, None] + torch.arange(10)).flatten()

    def regressor(self, q: Tensor, qd: Tensor, qdd: Tensor, gravity: Tensor | None = None) -> Tensor:
        """Return the regressor Y of the inverse dynamics: `tau = Y(q, qd, qdd) pi`.

        Args:
            q, qd, qdd: (*batch, n_dof) position, velocity, acceleration [rad or m, per s, per s^2].
            gravity: (3,) instead of the robot's own [m/s^2].

        Returns:
            (*batch, n_dof, n_params), a permuted view: the samples are contiguous in memory.
        """
        self.check(q, qd, qdd)
        gravity = self._gravity(gravity)
        found = compiled.call(compiled.REGRESSOR, self._tables, q, qd, qdd, gravity)
        return eager.regressor(self._geometry(q), q, qd, qdd, gravity.to(q)) if found is None else found

    def regressor_batch_last(self, q: Tensor, qd: Tensor, qdd: Tensor, gravity: Tensor | None = None) -> Tensor:
        """Return the regressor with the samples last, as it is computed: fastest, for use in loops.

        Args:
            q, qd, qdd: (n_dof, N).
            gravity: (3,) instead of the robot's own [m/s^2].

        Returns:
            (n_dof, n_params, N).
        """
        self.check(q, qd, qdd, dimension=0)
        gravity = self._gravity(gravity)
        found = compiled.call(compiled.REGRESSOR, self._tables, q.mT, qd.mT, qdd.mT, gravity)
        if found is not None:
            return found.movedim(0, -1)
        q, qd, qdd = q.contiguous(), qd.contiguous(), qdd.contiguous()
        return eager.regressor_batch_last(self._geometry(q), q, qd, qdd, gravity.to(q))

    def inverse_dynamics(
        self, q: Tensor, qd: Tensor, qdd: Tensor, pi: Tensor | None = None, gravity: Tensor | None = None
    ) -> Tensor:
        """Return the torques of the rigid body, by recursion: `tau = M(q) qdd + c(q, qd) + g(q)`.

        Args:
            q, qd, qdd: (*batch, n_dof) position, velocity, acceleration [rad or m, per s, per s^2].
            pi: (n_params,) instead of the robot's own.
            gravity: (3,) instead of the robot's own [m/s^2].

        Returns:
            (*batch, n_dof) torque of revolute, force of prismatic joints [N m, N].
        """
        self.check(q, qd, qdd)
        pi, gravity = self._parameters(pi), self._gravity(gravity)
        found = compiled.call(compiled.INVERSE_DYNAMICS, self._tables, q, qd, qdd, pi, gravity)
        if found is not None:
            return found
        return eager.inverse_dynamics(self._geometry(q), q, qd, qdd, pi.to(q), gravity.to(q))

    def physical_torque(self, q: Tensor, qd: Tensor, qdd: Tensor, theta: Tensor) -> Tensor | None:
        """Return ``inverse_dynamics`` for log-Cholesky coordinates theta (n_bodies, 10), in one compiled call.

        None for all but float64 on the CPU, and where a derivative is needed.
        """
        self.check(q, qd, qdd)
        return compiled.call_physical_torque(self._tables, q, qd, qdd, theta, self._gravity(None))

    def mass_matrix(self, q: Tensor, pi: Tensor | None = None) -> Tensor:
        """Return the joint-space mass matrix M: kinetic energy is `qd' M qd / 2`.

        Args:
            q: (*batch, n_dof) [rad or m].
            pi: (n_params,) instead of the robot's own.

        Returns:
            (*batch, n_dof, n_dof), symmetric; positive definite if the bodies are physical.
        """
        self.check(q)
        pi = self._parameters(pi)
        found = compiled.call(compiled.MASS_MATRIX, self._tables, q, pi)
        return eager.mass_matrix(self._geometry(q), q, pi.to(q)) if found is None else found

    def forward_dynamics(
        self, q: Tensor, qd: Tensor, tau: Tensor, pi: Tensor | None = None, gravity: Tensor | None = None
    ) -> Tensor:
        """Return the accelerations under given torques: `qdd = M(q)^-1 (tau - c(q, qd) - g(q))`.

        Args:
            q, qd: (*batch, n_dof) position and velocity [rad or m, per s].
            tau: (*batch, n_dof) torque of revolute, force of prismatic joints [N m, N].
            pi: (n_params,) instead of the robot's own.
            gravity: (3,) instead of the robot's own [m/s^2].

        Returns:
            (*batch, n_dof) [rad/s^2 or m/s^2].

        Raises:
            PhysicalError: the mass matrix is not positive definite.
        """
        self.check(q, qd, tau)
        bias = self.inverse_dynamics(q, qd, torch.zeros_like(q), pi, gravity)
        return self.accelerate(self.mass_matrix(q, pi), tau - bias)

    def accelerate(self, mass: Tensor, tau: Tensor) -> Tensor:
        """Return the accelerations `M^-1 tau`, (*batch, n_dof).

        Args:
            mass: (*batch, n_dof, n_dof) mass matrices.
            tau: (*batch, n_dof) torque available for acceleration.

        Raises:
            PhysicalError: a mass matrix is not positive definite.
        """
        return accelerations(mass, tau, self.name, self.joint_names)

    def body_poses(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Return the poses of the bodies' frames in the base's frame.

        Args:
            q: (*batch, n_dof) [rad or m].

        Returns:
            rotations (*batch, n_bodies, 3, 3) and origins (*batch, n_bodies, 3) [m].
        """
        self.check(q)
        (q,), batch = batch_last(q)
        pose = kinematics.body_poses(self._geometry(q), *kinematics.body_coordinates(self._geometry(q), q))
        return batch_first(pose.R.transpose(0, 1), batch), batch_first(pose.p.transpose(0, 1), batch)

    def jacobian(self, q: Tensor, body: int) -> Tensor:
        """Return the Jacobian of a body's origin: `[v, omega] = J(q) qd`; a wrench has the torque `J' [f, n]`.

        Args:
            q: (*batch, n_dof) [rad or m].
            body: its index.

        Returns:
            (*batch, 6, n_dof), in the base's axes.
        """
        self.check(q)
        (q,), batch = batch_last(q)
        geometry = self._geometry(q)
        return batch_first(tiled(lambda q: dynamics.jacobian(geometry, q, body), q), batch)

    def torque_slopes(self, q: Tensor, qd: Tensor, qdd: Tensor, pi: Tensor | None = None) -> Tensor:
        """Return the derivatives of the inverse dynamics with respect to q, qd and qdd.

        Args:
            q, qd, qdd: (*batch, n_dof) position, velocity, acceleration [rad or m, per s, per s^2].
            pi: (n_params,) instead of the robot's own.

        Returns:
            (*batch, 3, n_dof, n_dof): of each torque by each joint's q, qd and qdd.
        """
        self.check(q, qd, qdd)
        pi, gravity = self._parameters(pi), self._gravity(None)
        found = compiled.call_torque_slopes(self._tables, q, qd, qdd, pi, gravity)
        return eager.torque_slopes(self._geometry(q), q, qd, qdd, pi.to(q), gravity.to(q)) if found is None else found

    def origin_slopes(self, q: Tensor, qd: Tensor, qdd: Tensor, pi: Tensor | None = None) -> Tensor:
        """Return the derivatives of the inverse dynamics with respect to the <origin> of each driving joint.

        Shifts and turns are in the parent link's axes; for a joint that is fixed to the base, in the root link's.

        Args:
            q, qd, qdd: (*batch, n_dof) position, velocity, acceleration [rad or m, per s, per s^2].
            pi: (n_params,) instead of the robot's own.

        Returns:
            (*batch, n_dof, n_dof, 6): of each torque by each joint's shift along x, y, z [m] and turn about them [rad].
        """
        self.check(q, qd, qdd)
        pi, gravity = self._parameters(pi).to(q), self.gravity.to(q)
        by_body = eager.origin_slopes(self._geometry(q), q, qd, qdd, pi, gravity)[..., self.joint_bodies, :]
        axes = torch.stack([parent_axes(self.description, self.folded, name) for name in self.joint_names]).to(by_body)
        return torch.einsum("...djsx,jxk->...djsk", by_body.unflatten(-1, (2, 3)), axes).flatten(-2)

    def with_gravity(self, gravity: Sequence[float] | Tensor) -> RobotModel:
        """Return the same robot with another gravity vector (3,) [m/s^2], for example on a tilted base."""
        robot = copy.copy(self)
        robot.gravity = torch.as_tensor(gravity, dtype=self.gravity.dtype, device=self.gravity.device)
        return robot

    def to(self, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> RobotModel:
        """Return the same robot with its tensors in another dtype or on another device."""
        robot = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, Tensor):
                setattr(robot, name, value.to(device=device, dtype=dtype if value.is_floating_point() else None))
        return robot

    def check(self, *coordinates: Tensor, dimension: int = -1) -> None:
        """Check that tensors have n_dof entries along a dimension.

        Raises:
            InputError: one does not.
        """
        for x in coordinates:
            if x.ndim == 0 or x.shape[dimension] != self.n_dof:
                shape = f"(..., {self.n_dof})" if dimension else f"({self.n_dof}, N)"
                raise InputError(
                    f"got a tensor of shape {tuple(x.shape)}, expected {shape}: robot '{self.name}' has joints "
                    f"{', '.join(self.joint_names)}"
                )

    def _geometry(self, like: Tensor) -> kinematics.Geometry:
        """Return the geometry in the dtype and on the device of `like`."""
        key = (like.dtype, like.device)
        geometry = self._geometries.get(key) or self._geometries[EXACT].to(*key)
        if is_ordinary(geometry.axis):
            self._geometries[key] = geometry
        return geometry

    def _gravity(self, gravity: Tensor | None) -> Tensor:
        """Return the gravity to use."""
        gravity = self.gravity if gravity is None else gravity
        if gravity.shape != (3,):
            raise InputError(f"gravity has shape {tuple(gravity.shape)}, expected (3,): x, y, z in the base's axes")
        return gravity

    def _parameters(self, pi: Tensor | None) -> Tensor:
        """Return the inertial parameters to use."""
        pi = self.pi if pi is None else pi
        if pi.shape != (self.n_params,):
            raise InputError(
                f"pi has shape {tuple(pi.shape)}, expected ({self.n_params},): 10 for each of "
                f"{', '.join(self.body_names)}"
            )
        return pi
