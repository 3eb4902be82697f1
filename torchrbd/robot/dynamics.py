"""Inverse dynamics, its regressor and the mass matrix, batch last.

All moments are about the world's origin, so a joint's torque is a plain sum over its subtree, and a subtree is a slice.
`F` is the force and `N` the moment about the world's origin that move a subtree. Joint i then takes `z . N + (p x z) .
F` if revolute, `z . F` if prismatic.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchrbd.robot.inertia import inertia_matrix
from torchrbd.robot.kinematics import (
    Geometry,
    Motion,
    Pose,
    apply,
    body_coordinates,
    body_motion,
    body_poses,
    cross,
    dot,
    product,
)


def regressor(geometry: Geometry, q: Tensor, qd: Tensor, qdd: Tensor, gravity: Tensor) -> Tensor:
    """Return the regressor of the inverse dynamics, differentiable: `tau = Y pi`.

    Args:
        q, qd, qdd: (n_dof, N) [rad, rad/s, rad/s^2; m, m/s, m/s^2].
        gravity: (3,) [m/s^2].

    Returns:
        (n_dof, 10 n_bodies, N).
    """
    n = len(geometry.ends)
    rows = [
        pad(torch.cat((dot(*linear), dot(*angular)), 1), (0, 0, 0, 0, body, n - geometry.ends[body])).flatten(0, 1)
        for body, (linear, angular) in enumerate(_rows(geometry, q, qd, qdd, gravity))
    ]
    Y = torch.stack(rows)
    return torch.einsum("jd,jkn->dkn", geometry.coupling, Y) if geometry.is_coupled else Y


def write_regressor(geometry: Geometry, q: Tensor, qd: Tensor, qdd: Tensor, gravity: Tensor, out: Tensor) -> None:
    """Write the same regressor into `out`, (n_dof, 10 n_bodies, N), initially zero: structural zeros stay unwritten."""
    if geometry.is_coupled:
        out.copy_(regressor(geometry, q, qd, qdd, gravity))
        return
    blocks = out.unflatten(1, (-1, 10))
    for body, (linear, angular) in enumerate(_rows(geometry, q, qd, qdd, gravity)):
        block = blocks[body, body : geometry.ends[body]]
        dot(*linear, out=block[:, :4])
        dot(*angular, out=block[:, 4:])


Factors = tuple[Iterable[Tensor], Iterable[Tensor]]


def _rows(geometry: Geometry, q: Tensor, qd: Tensor, qdd: Tensor, gravity: Tensor) -> Iterator[tuple[Factors, Factors]]:
    """Yield each joint's row over its subtree as factors of `dot`: for [m, mc], (k, 4, N), and for I, (k, 6, N)."""
    q, qd, qdd = body_coordinates(geometry, q, qd, qdd)
    pose = body_poses(geometry, q)
    motion = body_motion(geometry, pose, qd, qdd, gravity)
    force, moment = _first_moment_columns(pose, motion)
    couple = _inertia_columns(pose, motion)
    lever = cross(pose.p, pose.z)
    for body, end in enumerate(geometry.ends):
        z, subtree = pose.z[:, body], slice(body, end)
        if geometry.prismatic[body]:
            # A moment does no work on a prismatic joint: zero, whatever the inertia.
            yield (force[:, subtree], z), (couple[:1, subtree], torch.zeros_like(z[:1]))
        else:
            wrench = (*moment[:, subtree], *force[:, subtree])
            yield (wrench, (*z, *lever[:, body])), (couple[:, subtree], z)


def _first_moment_columns(pose: Pose, motion: Motion) -> tuple[Tensor, Tensor]:
    """Return force and moment about the world's origin per [m, mcx, mcy, mcz], (3, n_bodies, 4, N) each.

    `F = m a + Rdd mc`, `N = p x F + (R mc) x a`, with `Rdd = turn R`.
    """
    force = torch.cat((motion.a[:, :, None], product(motion.turn, pose.R)), 2)
    moment = cross(pose.p[:, :, None], force)
    moment[:, :, 1:] -= cross(motion.a[:, :, None], pose.R)
    return force, moment


def _inertia_columns(pose: Pose, motion: Motion) -> Tensor:
    """Return the moment per [Ixx, Ixy, Iyy, Ixz, Iyz, Izz], (3, n_bodies, 6, N).

    `N = R I alpha_b + Rd I omega_b`, with alpha_b and omega_b in body axes.
    """
    R, Rd = pose.R, cross(motion.omega[:, :, None], pose.R)
    omega, alpha = _in_body(R, motion.omega), _in_body(R, motion.alpha)
    columns = []
    for i, k in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)):
        a, b = (R[:, :, i], Rd[:, :, i]), (alpha[k], omega[k])
        if i != k:
            a, b = (*a, R[:, :, k], Rd[:, :, k]), (*b, alpha[i], omega[i])
        columns.append(dot(a, b))
    return torch.stack(columns, 2)


def _in_body(R: Tensor, v: Tensor) -> Tensor:
    """Return `R' v`: (3, n_bodies, N)."""
    return dot(R, v[:, :, None]).transpose(0, 1)


def inverse_dynamics(geometry: Geometry, q: Tensor, qd: Tensor, qdd: Tensor, pi: Tensor, gravity: Tensor) -> Tensor:
    """Return the torques by direct recursion.

    `F = m a + Rdd mc`, `N = p x F + R mc x a + R I alpha_b + omega x R I omega_b`, summed over each joint's subtree.

    Args:
        q, qd, qdd: (n_dof, N) [rad, rad/s, rad/s^2; m, m/s, m/s^2].
        pi: (10 n_bodies,) inertial parameters.
        gravity: (3,) [m/s^2].

    Returns:
        (n_dof, N) [N m, N].
    """
    q, qd, qdd = body_coordinates(geometry, q, qd, qdd)
    pose = body_poses(geometry, q)
    omega, alpha, turn, a = body_motion(geometry, pose, qd, qdd, gravity)
    R = pose.R
    m, mc, inertia = _split(pi)
    c = apply(R, mc)
    F = a * m + apply(turn, c)
    spin = apply(R, apply(inertia, _in_body(R, omega)))
    N = cross(pose.p, F) + cross(c, a) + apply(R, apply(inertia, _in_body(R, alpha))) + cross(omega, spin)
    angular, linear = screws(geometry, pose)
    tau = dot(angular, geometry.above.T @ N) + dot(linear, geometry.above.T @ F)
    return geometry.coupling.T @ tau if geometry.is_coupled else tau


def screws(geometry: Geometry, pose: Pose) -> tuple[Tensor, Tensor]:
    """Return every joint's unit motion as angular velocity and velocity of the point at the world's origin."""
    z, lever = pose.z, cross(pose.p, pose.z)
    if not any(geometry.prismatic):
        return z, lever
    return z * geometry.turns, lever * geometry.turns + z * geometry.slides


def _split(pi: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return m (n_bodies, 1), mc (3, n_bodies, 1), inertia (3, n_bodies, 3, 1)."""
    pi = pi.unflatten(0, (-1, 10))
    return pi[:, :1], pi[:, 1:4].T[..., None], inertia_matrix(pi).transpose(0, 1)[..., None]


def jacobian(geometry: Geometry, q: Tensor, body: int) -> Tensor:
    """Return the Jacobian of a body's origin and rotation with respect to the joints: `[v, omega] = J qd`.

    Args:
        q: (n_dof, N) [rad, m].

    Returns:
        (6, n_dof, N), in the base's axes.
    """
    (q,) = body_coordinates(geometry, q)
    pose = body_poses(geometry, q)
    angular, linear = (screw * geometry.above[body, :, None] for screw in screws(geometry, pose))
    J = torch.cat((linear + cross(angular, pose.p[:, body, None].expand_as(angular)), angular))
    return torch.einsum("kbn,bd->kdn", J, geometry.coupling) if geometry.is_coupled else J


def mass_matrix(geometry: Geometry, q: Tensor, pi: Tensor) -> Tensor:
    """Return the mass matrix from composite inertias about the world's origin: `M_jk = s_j' Ic_k s_k`, j above k.

    Args:
        q: (n_dof, N) [rad, m].
        pi: (10 n_bodies,) inertial parameters.

    Returns:
        (n_dof, n_dof, N) [kg m^2, kg m, kg].
    """
    (q,) = body_coordinates(geometry, q)
    pose = body_poses(geometry, q)
    below = geometry.above.T
    m, u, about_world = masses(pose, pi)
    mass, first, second = below @ m, below @ u, (below @ about_world.flatten(2)).unflatten(2, (3, -1))
    angular, linear = screws(geometry, pose)
    momentum = linear * mass + cross(angular, first)
    spin = apply(second, angular) + cross(first, linear)
    M = dot(angular[:, :, None], spin[:, None]) + dot(linear[:, :, None], momentum[:, None])
    strictly = below.triu(1)
    M = M * below[..., None] + (M * strictly[..., None]).transpose(0, 1)
    return torch.einsum("jd,jkn,ke->den", geometry.coupling, M, geometry.coupling) if geometry.is_coupled else M


def masses(pose: Pose, pi: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return every body's mass, first moment and inertia matrix about the world's origin, in its axes.

    Returns:
        m (n_bodies, 1), mc (3, n_bodies, N), inertia (3, n_bodies, 3, N).
    """
    R, p = pose.R, pose.p
    m, mc, inertia = _split(pi)
    c = apply(R, mc)
    u = c + p * m
    eye = torch.eye(3, dtype=R.dtype, device=R.device)[:, None, :, None]
    rotated = sum(_outer(apply(R, inertia[:, :, k]), R[:, :, k]) for k in range(3))
    return m, u, rotated + eye * (dot(p, c) + dot(p, u))[:, None] - _outer(p, c) - _outer(u, p)


def _outer(a: Tensor, b: Tensor) -> Tensor:
    """Return `a b'` of (3, n_bodies, N) tensors: (3, n_bodies, 3, N)."""
    return a[:, :, None] * b.transpose(0, 1)
