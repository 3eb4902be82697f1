"""Motion of all bodies in the world frame, batch last.

Tensors are component-major; the samples are the last, contiguous dimension. The numbers that a body needs at one time
are then adjacent, and every operation covers a whole tile of samples.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchrbd._runtime.compiling import is_plain
from torchrbd.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class Geometry:
    """A tree's constants on one device, in one dtype.

    Attributes:
        parents, ends, drivers: as in `Tree`.
        prismatic: whether each body is on a prismatic joint.
        rotation: (3, 3, n_bodies, 3, 1) A, B, C of the local rotations `E(q) = A + B sin q + C cos q`.
        translation: (3, n_bodies, 1) a body's origin at `q = 0` in its parent's frame [m].
        axis: (3, n_bodies, 1) unit axis in the body's frame (the joint's own motion does not change it).
        turns, slides: (n_bodies, 1) 1 for revolute and 1 for prismatic joints, 0 for the others.
        above: (n_bodies, n_bodies) 1 where the column's body is the row's or one of its ancestors: sums along the tree.
        coupling: (n_bodies, n_dof) `q_bodies = coupling q + offset`; the identity without mimic joints.
        offset: (n_bodies, 1).
    """

    parents: tuple[int, ...]
    ends: tuple[int, ...]
    drivers: tuple[int, ...]
    prismatic: tuple[bool, ...]
    rotation: Tensor
    translation: Tensor
    axis: Tensor
    turns: Tensor
    slides: Tensor
    above: Tensor
    coupling: Tensor
    offset: Tensor

    @property
    def is_coupled(self) -> bool:
        """Whether there are mimic joints."""
        return len(self.parents) > self.coupling.shape[1]

    def to(self, dtype: torch.dtype, device: torch.device) -> Geometry:
        """Return the same constants in another dtype or on another device."""
        moved = {k: v.to(dtype=dtype, device=device) for k, v in vars(self).items() if isinstance(v, Tensor)}
        return Geometry(**{**vars(self), **moved})


def build_geometry(tree: Tree) -> Geometry:
    """Collect a tree's constants, in float64 on the CPU."""
    n = len(tree.moving)
    axis = torch.stack([joint.axis for joint in tree.moving])
    prismatic = torch.tensor([joint.kind == "prismatic" for joint in tree.moving])
    eye = torch.eye(3, dtype=axis.dtype)
    # Rodrigues: E = P (1 + sin q K + (1 - cos q) K^2); a prismatic joint keeps P.
    K, P = torch.linalg.cross(axis[:, None], eye[None]).mT, tree.poses[:, :3, :3]
    K[prismatic] = 0
    parts = torch.stack((P @ (eye + K @ K), P @ K, -P @ K @ K))
    above = torch.zeros(n, n, dtype=axis.dtype)
    for body, end in enumerate(tree.ends):
        above[body:end, body] = 1
    coupling = torch.zeros(n, len(tree.driving), dtype=axis.dtype)
    coupling[range(n), tree.drivers] = torch.tensor(tree.multipliers, dtype=axis.dtype)
    return Geometry(
        parents=tree.parents,
        ends=tree.ends,
        drivers=tree.drivers,
        prismatic=tuple(prismatic.tolist()),
        rotation=parts.transpose(1, 2)[..., None].contiguous(),
        translation=tree.poses[:, :3, 3].T[..., None].contiguous(),
        axis=axis.T[..., None].contiguous(),
        turns=(~prismatic).to(axis.dtype)[:, None],
        slides=prismatic.to(axis.dtype)[:, None],
        above=above,
        coupling=coupling,
        offset=torch.tensor(tree.offsets, dtype=axis.dtype)[:, None],
    )


class Pose(NamedTuple):
    """Poses of the bodies.

    Attributes:
        R: (3, n_bodies, 3, N) rotation of a body's frame in the world; the columns are in the third dimension.
        p: (3, n_bodies, N) its origin [m].
        r: (3, n_bodies, N) its origin relative to the parent's, world axes [m].
        z: (3, n_bodies, N) the joint's axis.
    """

    R: Tensor
    p: Tensor
    r: Tensor
    z: Tensor


class Motion(NamedTuple):
    """Velocities and accelerations of the bodies.

    Attributes:
        omega, alpha: (3, n_bodies, N) angular velocity and acceleration [rad/s, rad/s^2].
        turn: (3, n_bodies, 3, N) `alpha x + omega x omega x`: the acceleration of a point at d is `a + turn d` [1/s^2].
        a: (3, n_bodies, N) acceleration of the origin, gravity subtracted [m/s^2].
    """

    omega: Tensor
    alpha: Tensor
    turn: Tensor
    a: Tensor


def dot(a: Iterable[Tensor], b: Iterable[Tensor], out: Tensor | None = None) -> Tensor:
    """Return the sum of products along the first dimension; the rest broadcasts."""
    first, *rest = zip(a, b, strict=True)
    total = torch.mul(*first, out=out)
    # Derivatives need every step of the sum, and vmap has no batched addcmul_.
    out = total if out is not None or (not torch.is_grad_enabled() and is_plain(total)) else None
    for x, y in rest:
        total = torch.addcmul(total, x, y, out=out)
    return total


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Return the cross product along the first dimension."""
    return torch.stack([torch.addcmul(a[i] * b[j], a[j], b[i], value=-1) for i, j in ((1, 2), (2, 0), (0, 1))])


def skew(v: Tensor) -> Tensor:
    """Return the matrix of `v x`: (3, ..., N) to (3, ..., 3, N)."""
    x, y, z = v
    o = torch.zeros_like(x)
    return torch.stack((o, -z, y, z, o, -x, -y, x, o)).unflatten(0, (3, 3)).movedim(1, -2)


def apply(R: Tensor, v: Tensor) -> Tensor:
    """Return `R v`: R (3, ..., 3, N), v (3, ..., N)."""
    return dot(R.unbind(-2), v)


def product(a: Tensor, b: Tensor) -> Tensor:
    """Return `a b`: a (3, ..., 3, N), b (3, ..., k, N), result (3, ..., k, N)."""
    return dot(a.unsqueeze(-2).unbind(-3), b)


def body_coordinates(geometry: Geometry, *coordinates: Tensor) -> tuple[Tensor, ...]:
    """Return q, and qd and qdd if given, of all bodies, (n_bodies, N) each, from those of the driving joints."""
    if not geometry.is_coupled:
        return coordinates
    q, *rates = (geometry.coupling @ x for x in coordinates)
    return (q + geometry.offset, *rates)


def body_poses(geometry: Geometry, q: Tensor) -> Pose:
    """Return the poses of the bodies: `R = R_p E(q)`, `p = p_p + R_p t [+ z q]`.

    Args:
        q: (n_bodies, N) coordinate of every body [rad, m].
    """
    A, B, C = geometry.rotation
    sines, cosines = q.sin(), q.cos()
    rotations: list[Tensor] = []
    steps: list[Tensor] = []
    for body, parent in enumerate(geometry.parents):
        t = geometry.translation[:, body]
        E = torch.addcmul(torch.addcmul(A[:, body], B[:, body], sines[body]), C[:, body], cosines[body])
        if parent < 0:
            rotations.append(E)
            steps.append(t.expand(3, q.shape[-1]))
        else:
            rotations.append(product(rotations[parent], E))
            steps.append(apply(rotations[parent], t))
    R, r = torch.stack(rotations, 1), torch.stack(steps, 1)
    z = apply(R, geometry.axis)
    if any(geometry.prismatic):
        r = r + z * (q * geometry.slides)
    return Pose(R, geometry.above @ r, r, z)


def body_motion(geometry: Geometry, pose: Pose, qd: Tensor, qdd: Tensor, gravity: Tensor) -> Motion:
    """Return the velocities and accelerations of the bodies.

    `omega = omega_p + z qd`, `alpha = alpha_p + z qdd + omega_p x z qd`, `a = a_p + alpha_p x r + omega_p x (omega_p x
    r) [+ 2 omega_p x z qd + z qdd]`, `a_0 = -g`; sums along the tree are products with `above`. For a revolute joint
    `omega_p x z = omega x z`; for a prismatic one `omega_p = omega`.

    Args:
        qd, qdd: (n_bodies, N) velocity and acceleration of every body's coordinate.
        gravity: (3,) [m/s^2].
    """
    slides = any(geometry.prismatic)
    spin = pose.z * (qd * geometry.turns if slides else qd)
    omega = geometry.above @ spin
    push = pose.z * (qdd * geometry.turns if slides else qdd)
    alpha = geometry.above @ (push + cross(omega, spin))
    turn = _turn(omega, alpha)
    step = apply(_of_parent(geometry.parents, turn), pose.r)
    if slides:
        step = step + cross(omega, pose.z * (2 * qd * geometry.slides)) + pose.z * (qdd * geometry.slides)
    return Motion(omega, alpha, turn, geometry.above @ step - gravity[:, None, None])


def _turn(omega: Tensor, alpha: Tensor) -> Tensor:
    """Return the matrix of `alpha x + omega x omega x`, `omega omega' - omega' omega + skew(alpha)`."""
    xx, yy, zz = omega * omega
    yz, zx, xy = omega[[1, 2, 0]] * omega[[2, 0, 1]]
    x, y, z = alpha
    entries = (-(yy + zz), xy - z, zx + y, xy + z, -(xx + zz), yz - x, zx - y, yz + x, -(xx + yy))
    return torch.stack(entries).unflatten(0, (3, 3)).transpose(1, 2)


def _of_parent(parents: tuple[int, ...], x: Tensor) -> Tensor:
    """Return every body's parent's value of x, (3, n_bodies, ...), zero at the base."""
    zero = torch.zeros_like(x[:, 0])
    return torch.stack([zero if parent < 0 else x[:, parent] for parent in parents], 1)
