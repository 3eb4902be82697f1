"""Backlash: play between motor and link, in worn gears, splines and couplings.

The motor's position q is recorded. While the gear transmits torque, the link rests against one side of the play. The
motor then leads it by b/2 in the direction of that torque: q_link = q - b/2 sign(tau_link + f). When the torque changes
sign, the link leaves that side. It moves under its load and its friction f alone until it meets a side again. To
first order in x = q_link - q

    tau_link = tau_load + A x + B dx/dt + M d2x/dt2
    tau_link + f = 0 from rest at x = -+b/2,  held at x = +-b/2
    f = d dq_link/dt + c sign(dq_link/dt) + o;  at rest (q_link held) where f can balance the rest

A, B and M are the derivatives of the rigid-body torque with respect to the joint's q, qd and qdd. The motor's torque
grows by tau_link - tau_load. It also changes by the link's friction minus that of a link which moves with the motor:
while the link rests within its play, the motor turns on without it.

A hanging link swings in its play like a pendulum. The time of flight grows with the cube root of the play, so it
matters for small play too. Without it, the modelled torque is wrong in direction around its zeros. The data decide
whose friction it is: the link's, which it then holds inside the play, or the motor's.

Not modelled: friction on both sides at once, and bouncing. Impacts are short: a torque sampled without an anti-aliasing
filter misses them.

Source: Nordin, Gutman, "Controlling mechanical systems with backlash: a survey", Automatica 2002, for the dead-zone
    model with a stiff contact; worked out to first order here.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd._runtime.compiling import ADDRESS, INTEGER, NUMBER, Source, is_plain, library
from torchrbd.effects.base import CoefficientPrior, Effect, Shape
from torchrbd.effects.link_friction import PARTS, link_part
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site

# As a fraction of the largest inertia in a motion.
_LEAST_INERTIA = 1e-6
# Number of integrations over the whole sequence; each starts from the result of the one before.
_FEEDBACKS = 3
COMPILED = Source(
    Path(__file__).parent,
    ("backlash.c",),
    {"deviation": (INTEGER, INTEGER, ADDRESS, NUMBER, NUMBER, NUMBER, INTEGER, ADDRESS)},
)
"""`deviation` in C, used where no derivative is needed."""


class Backlash(Effect):
    """tau += tau_load(q + x) - tau_load(q): the link is at q + x, -b/2 <= x <= b/2, for a play of width b.

    The coefficient is b. The motion x is computed for a given play, the shape parameter ``flight``, and scaled with b.
    The two agree where the joint does have backlash.

    The shape parameter ``link_friction`` is the share of the joint's friction that acts on the link: 0 or 1.
    """

    id = "backlash"
    family = "transmission"
    words = "backlash"
    equation = "tau_load(q + x) - tau_load(q), abs(x) <= b/2"
    shown_by = "Slow motion in which the load changes sign, with enough acceleration that the link crosses the play."
    own_signals = ("q",)
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"backlash": "{q}", "flight": "{q}", "link_friction": "1"}
    kinds: ClassVar[Mapping[str, Mapping[float, str]]] = {"link_friction": PARTS}
    whole_robot = True
    uses_load = True
    has_memory = True
    sees_friction = True
    prior = CoefficientPrior("A play is not negative, and mostly below a degree.", positive=(0,), std=(0.01,))
    export_note = (
        "a second joint on the axis, with range +-backlash/2, between the rotor (a body of its own) and the link"
    )
    _SMALLEST, _LARGEST, _GRID_POINTS = 2e-4, 1.2e-1, 22
    # Times of flight may be off by a factor of 1.5: gears yield, and the link's inertia is not known well.
    _MOST_APART = 1.5**3

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        # Shapes differ by the time of flight, which grows with the cube root of the play.
        roots = np.linspace(np.cbrt(self._SMALLEST), np.cbrt(self._LARGEST), self._GRID_POINTS)
        return tuple({"flight": float(b), "link_friction": f} for f in PARTS for b in roots**3)

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        t, play, joint = signals.sequence(), shape["flight"], site.joint
        assert joint is not None
        slopes = signals.load_slopes[:, joint, joint]
        of_link = link_part(shape)
        friction = slopes.new_zeros(3) if signals.friction is None else of_link * signals.friction[joint]
        motion = signals.qd[joint], signals.qdd[joint], signals.joint(joint).direction()
        x, turned = deviation(signals.load[joint], slopes, motion, friction, float(t[1] - t[0]), play)
        torque = signals.deviating(joint, x)
        torque[joint] += friction[0] * signals.rate(x) + turned
        return {f"backlash({play:.6g}, {of_link:.3g}) {site.name(signals.robot)}": torque / play}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        flight, link = (coefficients.new_tensor(v) for v in (shape["flight"], link_part(shape)))
        return {"backlash": coefficients[0], "flight": flight, "link_friction": link}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["backlash"],), {name: parameters[name] for name in ("flight", "link_friction")}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["flight"] / self._MOST_APART <= parameters["backlash"] <= self._MOST_APART * self._LARGEST


def deviation(
    load: Tensor,
    slopes: Tensor,
    motion: tuple[Tensor, Tensor, Tensor],
    friction: Tensor,
    dt: float,
    play: float,
) -> tuple[Tensor, Tensor]:
    """Return the link's position relative to the middle of its play, and its Coulomb friction minus the motor's.

    The second is the friction that differs from that of a link which moves with the motor: in flight the link slides in
    its own direction, or rests.

    Args:
        load: (*batch, N) torque on the link if it moves with the motor [N m, N].
        slopes: (3, *batch, N) its derivatives A, B, M with respect to the link's position, velocity and acceleration.
        motion: velocity, acceleration and softened direction of the motor, (*batch, N) each.
        friction: (3,) viscous and Coulomb coefficient and offset of the link.
        dt: [s]. play: full width [rad, m].

    Returns:
        x (*batch, N) [rad, m] and torques (*batch, N) [N m, N].
    """
    # In double precision: a flight is a small difference of integrals over the whole sequence.
    tau, qd, qdd, direction, A, B, M = (v.double() for v in (load, *motion, *slopes))
    # Parameters that no body can have may give an inertia <= 0: such a link crosses its play at once.
    M = torch.maximum(M, _LEAST_INERTIA * M.abs().max() + torch.finfo(load.dtype).eps)
    viscous, coulomb, offset = friction.double()
    coulomb = coulomb.clamp_min(0.0)
    driven, B = tau + viscous * qd + offset, B + viscous
    held = driven - M * qdd - B * qd
    signals = torch.stack((driven, M, A, B, qd, held, direction))
    if is_plain(signals) and (compiled := library(COMPILED)) is not None:
        x, more = _underived(compiled.deviation, signals, coulomb.item(), dt, play)
        return x.to(load), more.to(load)
    rows = signals[:6].detach().cpu().reshape(6, -1, tau.shape[-1]).unbind(1)
    courses = [_course(*row.numpy(), coulomb=coulomb.item(), dt=dt, play=play) for row in rows]
    course = torch.from_numpy(np.array(courses)).to(tau)
    side, left, begun, rests, way, stuck, x, rate = (column.reshape(tau.shape) for column in course.unbind(1))
    free, left, begun = left >= 0, left.clamp_min(0).long(), begun.long()
    # The course already has x; the loop repeats its feedback on itself so that derivatives are right.
    for _ in range(_FEEDBACKS):
        speed = _integral(-(driven + A * x + B * rate + coulomb * way) / M, dt)
        speed = speed - speed.gather(-1, begun) - rests * qd.gather(-1, begun)
        rate = torch.where(stuck > 0, -qd, speed)
        gone = _integral(rate, dt)
        x = (torch.where(free, gone - gone.gather(-1, left), 0.0) - side * play / 2).clamp(-play / 2, play / 2)
        rate = torch.where(free, rate, 0.0)
    own = torch.where(stuck > 0, -(held + A * x).clamp(-coulomb, coulomb), coulomb * way)
    return x.to(load), torch.where(free, own - coulomb * direction, 0.0).to(load)


def _underived(compiled: Callable[..., int], signals: Tensor, coulomb: float, dt: float, play: float) -> Tensor:
    """Return deviation and friction (2, *batch, N) of signals (7, *batch, N) by the compiled function.

    The signals are the arguments of `_course`, and the direction of the motor.

    Raises:
        MemoryError: the function could not allocate memory.
    """
    given = signals.contiguous()
    found = torch.empty_like(given[:2])
    samples = found.shape[-1]
    rows = found.numel() // (2 * samples)
    if compiled(rows, samples, given.data_ptr(), coulomb, dt, play, _FEEDBACKS, found.data_ptr()):
        raise MemoryError("no memory for the flights of a play")
    return found


def _integral(x: Tensor, dt: float) -> Tensor:
    return torch.nn.functional.pad(torch.cumulative_trapezoid(x, dx=dt, dim=-1), (1, 0))


def _course(
    driven: np.ndarray,
    inertia: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
    speed: np.ndarray,
    held: np.ndarray,
    *,
    coulomb: float,
    dt: float,
    play: float,
) -> np.ndarray:
    """Follow a link through its play.

    Args:
        driven: (N,) load and friction without the Coulomb part, of a link that moves with the motor.
        inertia, stiffness, damping: (N,) derivatives M, A and B of ``driven``.
        speed: (N,) of the motor.
        held: (N,) ``driven`` of a link at rest.
        coulomb: level.
        dt: [s]. play: full width.

    Returns:
        (8, N): side of the present or last contact, sample at which the link left it (-1 in contact), sample at which
            the link began to slide, whether it began from rest (1, 0), direction in which it slides, whether it rests
            (1, 0), distance from the middle, and speed.
    """
    N, half, turned = len(driven), play / 2, np.copysign(1.0, speed)
    course = np.stack((turned, np.full(N, -1.0), *np.zeros((2, N)), turned, *np.zeros((3, N))))
    # Samples at which the load does not hold the link against a side of the play.
    pressed = driven + coulomb * turned
    ends = {s: [*np.flatnonzero(s * pressed < half * stiffness).tolist(), N] for s in (-1.0, 1.0)}
    side, k = math.copysign(1.0, pressed[0]), 0
    pulls, masses, springs, drags, speeds, rests = (
        x.tolist() for x in (driven, inertia, stiffness, damping, speed, held)
    )

    def acceleration(k: int, x: float, rate: float, way: float) -> float:
        return -(pulls[k] + springs[k] * x + drags[k] * rate + coulomb * way) / masses[k]

    while k < N:
        start = ends[side][bisect_left(ends[side], k)]
        course[0, k:start], course[6, k:start] = side, -side * half
        if start == N:
            break
        k, begin, rest, way, rate, sticks = start, start, 0.0, float(turned[start]), 0.0, False
        x, flight = -side * half, []
        pull = acceleration(k, x, rate, way)
        while abs(x) < half or k == start:
            flight.append((side, start, begin, rest, way, sticks, x, rate))
            k += 1
            if k == N:
                break
            holds, before = abs(rests[k] + springs[k] * x) <= coulomb, rate
            if not sticks:
                following = acceleration(k, x + dt * rate, rate + dt * pull, way)
                rate, pull = rate + 0.5 * dt * (pull + following), following
            turns = coulomb > 0 and (rate + speeds[k]) * way < 0
            if sticks or (turns and holds):
                # A link at rest stays at rest, or begins to slide in the direction in which it is dragged.
                sticks, rate, rest, begin = holds, -speeds[k], 1.0, k
                way = math.copysign(1.0, -rests[k] - springs[k] * x)
                pull = acceleration(k, x, rate, way)
            elif turns:
                way, rate = -way, rate + dt * coulomb * way / masses[k]
                pull = acceleration(k, x, rate, way)
            x += 0.5 * dt * (before + rate)
        course[:, start:k] = np.array(flight, dtype=float).T
        side = -math.copysign(1.0, x)
    return course
