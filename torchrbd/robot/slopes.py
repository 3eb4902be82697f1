"""Derivatives of the torques with respect to motion and geometry, in closed form.

Screws (angular, linear) and wrenches (moment, force) are about the world's origin, in its axes. Let body b, with
all that it carries, be displaced by a small screw xi that is fixed in its parent p, and let m be the deeper one of i
and b. With V and A velocity and acceleration (gravity subtracted), I and F inertia and wrench of subtrees, s_i the
screw of joint i and u = V_p x xi,

    dtau_i = s_i . (D_m u - I_m (u x V_p + xi x A_p) + [xi x* F_b where i is above b]);   xi = s_j for dtau_i / dq_j
    dtau_i / dqd_j = s_i . (D_m s_j + 2 I_m u_j),   dtau_i / dqdd_j = s_i . I_m s_j

D is the derivative of the wrench of a subtree by its velocity. It depends on the angular part phi alone,
D (phi, .) = -2 (mc x (v x phi) + omega x S phi, p x phi), with S the second moment of mass and p the momentum.

Source: derived here; of the kind of Carpentier, Mansard, "Analytical derivatives of rigid body dynamics algorithms",
    RSS 2018, for displacements that need not be joints.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchrbd.robot.dynamics import masses, screws
from torchrbd.robot.kinematics import Geometry, Pose, body_coordinates, body_poses, cross, dot, product, skew


class Screw(NamedTuple):
    """A screw (angular, linear) or a wrench (moment, force), each (3, n_bodies, k, N)."""

    turn: Tensor
    move: Tensor

    def __matmul__(self, other: Screw) -> Screw:  # type: ignore[override]
        """Return the rate of change of another screw that moves with this velocity."""
        return Screw(_cross(self.turn, other.turn), _cross(self.turn, other.move) + _cross(self.move, other.turn))


class State(NamedTuple):
    """Inputs of the derivatives.

    Attributes:
        s: of the joints. V, A: of the parents.
        F: wrench; m, mc, J: inertia; p: momentum; K: of D; all of subtrees.
    """

    s: Screw
    V: Screw
    A: Screw
    F: Screw
    m: Tensor
    mc: Tensor
    J: Tensor
    p: Tensor
    K: Tensor


def torque_slopes(geometry: Geometry, q: Tensor, qd: Tensor, qdd: Tensor, pi: Tensor, gravity: Tensor) -> Tensor:
    """Return the derivatives of the torques with respect to q, qd and qdd.

    Args:
        q, qd, qdd, pi, gravity: as for `inverse_dynamics`.

    Returns:
        (3, n_dof, n_dof, N): of the torque in the second dimension by the joint in the third.
    """
    q, qd, qdd = body_coordinates(geometry, q, qd, qdd)
    state = _state(geometry, body_poses(geometry, q), qd, qdd, pi, gravity)
    s, u = state.s, state.V @ state.s
    by_q = _displaced(geometry, state, s)
    by_qd = _pairs(geometry, state, s.turn, Screw(-2 * u.turn, -2 * u.move))
    by_qdd = _pairs(geometry, state, torch.zeros_like(s.turn), Screw(-s.turn, -s.move))
    slopes, C = torch.cat((by_q, by_qd, by_qdd), 2), geometry.coupling
    return torch.einsum("bd,bckn,ce->kden", C, slopes, C) if geometry.is_coupled else slopes.movedim(2, 0)


def origin_slopes(geometry: Geometry, q: Tensor, qd: Tensor, qdd: Tensor, pi: Tensor, gravity: Tensor) -> Tensor:
    """Return the derivatives of the torques with respect to the pose of each body's joint in its parent body.

    Args:
        q, qd, qdd, pi, gravity: as for `inverse_dynamics`.

    Returns:
        (n_dof, n_bodies, 6, N): by shifts along the parent body's axes, then by turns about them.
    """
    q, qd, qdd = body_coordinates(geometry, q, qd, qdd)
    pose = body_poses(geometry, q)
    state = _state(geometry, pose, qd, qdd, pi, gravity)
    world = torch.eye(3, dtype=q.dtype, device=q.device)[:, :, None].expand(3, 3, q.shape[-1])
    axes = torch.stack([world if parent < 0 else pose.R[:, parent] for parent in geometry.parents], 1)
    # A prismatic joint turns about its origin at q = 0, not about its present position.
    origin = (pose.p - pose.z * (q * geometry.slides))[:, :, None]
    shift, turn = Screw(torch.zeros_like(axes), axes), Screw(axes, _cross(origin, axes))
    slopes = _displaced(geometry, state, Screw(*(torch.cat(pair, 2) for pair in zip(shift, turn, strict=True))))
    return torch.einsum("bd,bckn->dckn", geometry.coupling, slopes) if geometry.is_coupled else slopes


def _state(geometry: Geometry, pose: Pose, qd: Tensor, qdd: Tensor, pi: Tensor, gravity: Tensor) -> State:
    """Compute velocities, accelerations and wrenches about the world's origin."""
    above, below = geometry.above, geometry.above.T
    s = Screw(*(x[:, :, None] for x in screws(geometry, pose)))
    rates, accelerations = qd[:, None], qdd[:, None]

    def along(tree: Tensor, x: Tensor) -> Tensor:
        return torch.einsum("ab,ib...->ia...", tree, x)

    V = Screw(*(along(above, x * rates) for x in s))
    steps = [x * accelerations + y * rates for x, y in zip(s, V @ s, strict=True)]
    turned, moved = (along(above, step) for step in steps)
    A = Screw(turned, moved - gravity[:, None, None, None])
    m, mc, J = masses(pose, pi)
    m, mc = m[:, None], mc[:, :, None]
    S = 0.5 * _eye(J) * (J[0, :, 0] + J[1, :, 1] + J[2, :, 2])[:, None] - J
    p = V.move * m - _cross(mc, V.turn)
    spin, lead = _times(J, V.turn) + _cross(mc, V.move), _times(J, A.turn) + _cross(mc, A.move)
    force = A.move * m - _cross(mc, A.turn) + _cross(V.turn, p)
    moment = lead + _cross(V.turn, spin) + _cross(V.move, p)
    K = product(skew(mc[:, :, 0]), skew(V.move[:, :, 0])) + product(skew(V.turn[:, :, 0]), S)
    without = above - torch.eye(len(above), dtype=above.dtype, device=above.device)
    V = Screw(*(along(without, x * rates) for x in s))
    A = Screw(along(without, steps[0]), along(without, steps[1]) - gravity[:, None, None, None])
    F = Screw(along(below, moment), along(below, force))
    return State(s, V, A, F, (below @ m[:, 0])[:, None], *(along(below, x) for x in (mc, J, p, K)))


def _displaced(geometry: Geometry, state: State, xi: Screw) -> Tensor:
    """Return the derivatives with respect to displacements xi of the bodies: (n_bodies, n_bodies, k, N)."""
    V, A, F = state.V, state.A, state.F
    u = V @ xi
    w = Screw(*(x + y for x, y in zip(u @ V, xi @ A, strict=True)))
    carried = Screw(_cross(xi.turn, F.turn) + _cross(xi.move, F.move), _cross(xi.turn, F.move))
    return _pairs(geometry, state, u.turn, w, carried)


def _pairs(geometry: Geometry, state: State, phi: Tensor, w: Screw, carried: Screw | None = None) -> Tensor:
    """Return `s_i . (D_m phi_b - I_m w_b [+ carried_b])` of all bodies i and b that lie on one path, zero elsewhere."""
    s, m, mc, J, p, K = state.s, state.m, state.mc, state.J, state.p, state.K
    moment = -2 * _times(K, phi) - _times(J, w.turn) - _cross(mc, w.move)
    force = -2 * _cross(p, phi) - w.move * m + _cross(mc, w.turn)
    if carried is not None:
        moment, force = moment + carried.turn, force + carried.move
    # i above b: joint i takes the wrench of b's subtree. i = b or below: joint i is displaced with b.
    up = dot(s.turn[:, :, None], moment[:, None]) + dot(s.move[:, :, None], force[:, None])
    lever = -2 * (_times(K.transpose(0, 2), s.turn) + _cross(s.move, p))
    inertial = _times(J, s.turn) + _cross(mc, s.move), s.move * m - _cross(mc, s.turn)
    down = dot(lever[:, :, None], phi[:, None])
    down = down - dot(inertial[0][:, :, None], w.turn[:, None]) - dot(inertial[1][:, :, None], w.move[:, None])
    below = geometry.above[:, :, None, None]
    return up * (below.transpose(0, 1) * (1 - below)) + down * below


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return cross(*torch.broadcast_tensors(a, b))


def _times(M: Tensor, x: Tensor) -> Tensor:
    """Return `M x`: M (3, n_bodies, 3, N), x (3, n_bodies, k, N)."""
    return dot((column[:, :, None] for column in M.unbind(2)), x)


def _eye(like: Tensor) -> Tensor:
    return torch.eye(3, dtype=like.dtype, device=like.device)[:, None, :, None]
