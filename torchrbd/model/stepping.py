"""One time step: semi-implicit Euler with implicit friction, and the classical Runge-Kutta method.

Friction whose sign changes within a thousandth of a radian per second is stiff. An explicit step of a millisecond makes
the velocity jump from one side to the other, and derivatives through such steps grow without bound. Here v is the
velocity at the end of a step at which forces balance,

    r(v) = M (v - qd) + dt (c + f(v) - tau) = 0,    q' = q + dt v

with M and c = c(q, qd) of the rigid body and f(v) the torque of the terms. It is found by Newton's method with each
joint's own slope of f. A joint that would reverse within a step stops at rest, where friction is steepest, and
continues from there. If this does not converge, quadratic majorisation does: f is replaced by the line through f(0) and
f(v_k). Beyond v_k, friction that grows less than linearly is below that line, so no step is too long. One final Newton
step is differentiable, and has the derivatives of the implicit function, dv = -(dr/dv)^-1 dr.

Source: Hunter, Lange, "A tutorial on MM algorithms", The American Statistician 2004, sec. 3.2, for the majorisation.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Force = Callable[[Tensor], Tensor]
"""The terms' torque (*batch, n_dof) as a function of velocity."""
Acceleration = Callable[[Tensor, Tensor], Tensor]
"""As a function of position and velocity."""

_NEWTON_STEPS, _MAJORISED_STEPS = 12, 20
# As a fraction of ``rest_width``: at lower speeds, rounding dominates the line through f(0) and f(v).
_SLOWEST = 1e-2


def implicit_velocity(
    mass: Tensor, bias: Tensor, force: Force, qd: Tensor, tau: Tensor, dt: float | Tensor, rest_width: Tensor
) -> Tensor:
    """Return the velocity at the end of a step, differentiable in all arguments.

    Args:
        mass: (*batch, n, n). bias: (*batch, n) torque of the rigid body at zero acceleration.
        force: of the terms.
        qd, tau: (*batch, n).
        dt: [s].
        rest_width: (n,) speed below which friction's sign changes.
    """
    with torch.no_grad():
        free = (mass @ qd.unsqueeze(-1)).squeeze(-1) - dt * (bias - tau)
        v = balanced_velocity(mass, free, force, qd, dt, _SLOWEST * rest_width.to(qd))
        # The forces' derivatives by velocity, one row of the matrix per joint.
        units = torch.eye(v.shape[-1], dtype=v.dtype, device=v.device)
        _, by_velocity, *_ = torch.func.vjp(force, v)
        (rows,) = torch.vmap(lambda unit: by_velocity(unit.expand_as(v)), out_dims=-2)(units)
        slopes = mass + dt * rows
    residual = (mass @ (v - qd).unsqueeze(-1)).squeeze(-1) + dt * (bias + force(v) - tau)
    return v - _solve(slopes, residual)


def balanced_velocity(
    mass: Tensor, free: Tensor, force: Force, v: Tensor, dt: float | Tensor, slowest: Tensor
) -> Tensor:
    """Return v with M v + dt f(v) = free, to within ``slowest``; not differentiable.

    Args:
        mass: M, (*batch, n, n); its symmetric part must be positive definite where forces are.
        free: (*batch, n).
        force: f; accepts additional dimensions in front of the batch.
        v: initial value, (*batch, n).
        dt: [s].
        slowest: (n,) speed that counts as rest.
    """
    for _ in range(_NEWTON_STEPS):
        f, beyond = force(torch.stack((v, v + slowest)))
        slope = ((beyond - f) / slowest).clamp_min(0.0)
        before, v = v, _solve(mass + dt * torch.diag_embed(slope), free - dt * (f - slope * v))
        if _is_settled(before, v, slowest):
            return v
        v = torch.where(v * before < 0, torch.zeros_like(v), v)
    still = force(torch.zeros_like(v))
    for _ in range(_MAJORISED_STEPS):
        v = torch.where(v.abs() < slowest, torch.where(v < 0, -slowest, slowest), v)
        f = force(v)
        slope = ((f - still) / v).clamp_min(0.0)
        before, v = v, _solve(mass + dt * torch.diag_embed(slope), free - dt * (f - slope * v))
        if _is_settled(before, v, slowest):
            break
    return v


def runge_kutta(acceleration: Acceleration, q: Tensor, qd: Tensor, dt: float | Tensor) -> tuple[Tensor, Tensor]:
    """Return position and velocity after a classical fourth-order step; friction must not be stiff."""
    k1 = acceleration(q, qd)
    k2 = acceleration(q + 0.5 * dt * qd, qd + 0.5 * dt * k1)
    k3 = acceleration(q + 0.5 * dt * qd + 0.25 * dt**2 * k1, qd + 0.5 * dt * k2)
    k4 = acceleration(q + dt * qd + 0.5 * dt**2 * k2, qd + dt * k3)
    return q + dt * qd + dt**2 / 6.0 * (k1 + k2 + k3), qd + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def _is_settled(before: Tensor, v: Tensor, tolerance: Tensor) -> bool:
    """Return whether one Newton step suffices; always False where a graph is traced or batched."""
    if torch.compiler.is_compiling():
        return False
    try:
        return bool(((v - before).abs() < tolerance).all())
    except RuntimeError:
        return False


def _solve(matrix: Tensor, x: Tensor) -> Tensor:
    return torch.linalg.solve(matrix, x.unsqueeze(-1)).squeeze(-1)
