"""Many motions at once, from given states under given torques, where friction may be stiff.

A step of the implicit-explicit Runge-Kutta method ARS(2,2,2), of second order: the rigid body E = M^-1 (tau - c(q, qd))
is explicit, the terms F = -M^-1 f(q, qd) are implicit and L-stable, so that what sticks stays. With g = 1 - 1/sqrt(2)
and d = 1 - 1/(2 g):

    q_1 = q + g h qd                       qd_1 = qd + g h (E + F_1)
    q_2 = q + h (d qd + (1 - d) qd_1)      qd_2 = qd + h (d E + (1 - d) E_1) + h ((1 - g) F_1 + g F_2)

Joints whose torque is not known are moved as they were recorded: their rows of M are those of the unit matrix, with the
recorded acceleration at the right.

Source: Ascher, Ruuth, Spiteri, "Implicit-explicit Runge-Kutta methods for time-dependent partial differential
    equations", Applied Numerical Mathematics 1997, sec. 2.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchrbd.model.stepping import balanced_velocity
from torchrbd.simulation.plant import Conditions, Plant

_GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
_DELTA = 1.0 - 0.5 / _GAMMA
# Beyond it a motion is lost [rad/s, m/s]: nothing on a robot is as fast.
_FASTEST = 1e4


@dataclass(frozen=True)
class Commands:
    """Set-points that position drives follow, tau = clip(kp (q_ref - q) - kd qd, -limit, limit).

    Attributes:
        q_ref: (W, K + 1, n_dof) at the steps' ends [rad, m], linear in between; what stands at other joints does not
            matter.
        kp, kd, limit: (n_dof,) see ``torchrbd.recordings.drives.Drive``; kp and kd are zero at joints without a drive.
    """

    q_ref: Tensor
    kp: Tensor
    kd: Tensor
    limit: Tensor

    def steps(self, first: int, last: int) -> Commands:
        """Return the steps from the first to before the last."""
        return replace(self, q_ref=self.q_ref[:, first : last + 1])

    def torque(self, k: int, part: float, q: Tensor, qd: Tensor) -> Tensor:
        """Return the drives' torque (..., W, n_dof), a part of step k after its begin; zero at joints without one."""
        return self.of(torch.lerp(self.q_ref[:, k], self.q_ref[:, k + 1], part), q, qd)

    def of(self, q_ref: Tensor, q: Tensor, qd: Tensor) -> Tensor:
        """Return the drives' torque (..., n_dof) for set-points and states (..., n_dof)."""
        torque = self.kp * (q_ref - q) - self.kd * qd
        return torch.where(self.kp > 0, torque.clamp(-self.limit, self.limit), 0.0)


@dataclass(frozen=True)
class Drive:
    """What drives W windows through K steps.

    Attributes:
        h: length of a step [s].
        tau: (W, K, n_dof) mean torque of each step [N m or N]; what stands at joints that are moved does not matter.
        moved: (n_dof,) bool, joints that are moved as recorded.
        q, qd, qdd: (W, K + 1, n_dof) of the recorded motion at the steps' ends.
        t: (W,) times of their begin [s].
        temperature: (W, K + 1, n_dof) [deg C], or None.
        recording: its name, or None.
        commands: set-points of the joints with a position drive; its torque adds to ``tau``. None without.
    """

    h: float
    tau: Tensor
    moved: Tensor
    q: Tensor
    qd: Tensor
    qdd: Tensor
    t: Tensor
    temperature: Tensor | None = None
    recording: str | None = None
    commands: Commands | None = None

    def steps(self, first: int, last: int) -> Drive:
        """Return the steps from the first to before the last."""
        ends = slice(first, last + 1)
        warm = None if self.temperature is None else self.temperature[:, ends]
        cut = {name: getattr(self, name)[:, ends] for name in ("q", "qd", "qdd")}
        commands = None if self.commands is None else self.commands.steps(first, last)
        t = self.t + first * self.h
        return replace(self, **cut, tau=self.tau[:, first:last], t=t, temperature=warm, commands=commands)

    def held(self, mass: Tensor) -> Tensor:
        """Return mass matrices with the unit matrix's rows at joints that are moved."""
        if not bool(self.moved.any()):
            return mass
        return torch.where(self.moved.unsqueeze(-1), torch.eye(len(self.moved), dtype=mass.dtype), mass)

    def conditions(self, step: int, part: float = 0.0) -> Conditions:
        """Return what holds a part of a step after its begin."""
        warm = None if self.temperature is None else self.temperature[:, step]
        return Conditions(self.t + (step + part) * self.h, warm, self.recording)


@torch.no_grad()
def rollout(plant: Plant, q: Tensor, qd: Tensor, drive: Drive) -> tuple[Tensor, Tensor]:
    """Return positions and velocities at all ends of steps, (W, K + 1, n_dof); NaN once a motion is lost.

    Args:
        plant: what moves.
        q, qd: (W, n_dof) where it begins.
        drive: what drives it.

    Raises:
        PhysicalError: the mass matrix is not positive definite.
    """
    mass = plant.mass(q, drive.conditions(0))
    # Says at which joint, if it is not one that can be accelerated.
    plant.robot.accelerate(mass, q)
    mass, lost, path = drive.held(mass), torch.zeros(len(q), 1, dtype=torch.bool), [(q, qd)]
    for k in range(drive.tau.shape[1]):
        end, v, mass = _step(plant, drive, k, q, qd, mass)
        lost = lost | ~((v.abs() < _FASTEST) & end.isfinite()).all(-1, keepdim=True)
        q = torch.where(drive.moved | lost, drive.q[:, k + 1], end)
        qd = torch.where(drive.moved | lost, drive.qd[:, k + 1], v)
        path.append((torch.where(lost, torch.nan, q), torch.where(lost, torch.nan, qd)))
    positions, velocities = zip(*path, strict=True)
    return torch.stack(positions, 1), torch.stack(velocities, 1)


def _step(plant: Plant, drive: Drive, k: int, q: Tensor, qd: Tensor, mass: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return position, velocity and mass matrix (W, ...) at the end of step k; ``mass`` is that at its begin."""
    h, dt = drive.h, _GAMMA * drive.h
    first = _explicit(plant, drive, k, q, qd, mass)
    middle, at = q + dt * qd, drive.conditions(k, _GAMMA)
    mass, free = drive.held(plant.mass(middle, at)), qd + dt * first
    v = _implicit(plant, drive, (k, _GAMMA), middle, free, qd, mass, at)
    second, braked = _explicit(plant, drive, k, middle, v, mass), (v - free) / dt
    end, at = q + h * (_DELTA * qd + (1.0 - _DELTA) * v), drive.conditions(k + 1)
    mass = drive.held(plant.mass(end, at))
    free = qd + h * (_DELTA * first + (1.0 - _DELTA) * second + (1.0 - _GAMMA) * braked)
    return end, _implicit(plant, drive, (k, 1.0), end, free, v, mass, at), mass


def _explicit(plant: Plant, drive: Drive, k: int, q: Tensor, qd: Tensor, mass: Tensor) -> Tensor:
    """Return the acceleration E of the rigid body, the recorded one of joints that are moved."""
    recorded = 0.5 * (drive.qdd[:, k] + drive.qdd[:, k + 1])
    right = torch.where(drive.moved, recorded, drive.tau[:, k] - plant.rigid(q, qd))
    return torch.linalg.solve(mass, right.unsqueeze(-1)).squeeze(-1)


def _implicit(
    plant: Plant,
    drive: Drive,
    when: tuple[int, float],
    q: Tensor,
    free: Tensor,
    near: Tensor,
    mass: Tensor,
    at: Conditions,
) -> Tensor:
    """Return the velocity v = free + g h F(q, v), beginning the search at one nearby; ``when`` is step and part."""
    commands = drive.commands
    if plant.is_bare and commands is None:
        return free

    torque = plant.terms(q, at)

    def force(v: Tensor) -> Tensor:
        own = torque(v) if commands is None else torque(v) - commands.torque(*when, q, v)
        return torch.where(drive.moved, 0.0, own)

    impulse = (mass @ free.unsqueeze(-1)).squeeze(-1)
    return balanced_velocity(mass, impulse, force, near, _GAMMA * drive.h, plant.slowest)
