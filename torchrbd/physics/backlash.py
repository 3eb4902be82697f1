"""Backlash: play between motor and link, in worn gears, splines and couplings.

The motor's position q is recorded. While the gear transmits torque, the link sits at one side of the play and the
motor is ahead of it by b/2 in the direction of that torque: q_link = q - b/2 sign(tau_load). When the torque changes
sign, the link leaves its side and flies freely, dragged by its load alone, until it meets the other one:

    x = q_link - q,  M_jj d2x/dt2 = -tau_load from rest at x = -+b/2,  held at x = +-b/2

The link's motion tells the torque: to first order in x

    tau += A x + B dx/dt + M d2x/dt2

with A, B, M the derivatives of the rigid body's torque with respect to the joint's q, qd, qdd. The time of flight grows
with the cube root of the play, so that it matters for small play too: without it, what the torque does around its zeros
is the wrong way round. Not contained: bouncing, friction of the link, which holds it inside the play, torque that turns
back before the flight has ended. Impacts are short: a torque sampled without an anti-aliasing filter misses them.

Source: Nordin, Gutman, "Controlling mechanical systems with backlash: a survey", Automatica 2002, for the dead-zone
    model with a stiff contact; worked out to first order here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchrbd.physics.base import CoefficientPrior, Effect, Shape
from torchrbd.physics.joint_elasticity import slope_along
from torchrbd.physics.signals import JointScale, Signals, Site

# Of the largest inertia of a motion.
_LEAST_INERTIA = 1e-6


class Backlash(Effect):
    """tau = tau_load(q + x), x from side to side of the play, linear in its width b.

    The coefficient is b; the play for which flights are worked out is a shape, and equal to b where the name is right.
    """

    id = "backlash"
    words = "backlash"
    equation = "tau_load(q + x) - tau_load(q), abs(x) <= b/2"
    units: ClassVar[Mapping[str, str]] = {"backlash": "{q}", "flight": "{q}"}
    complexity = 2
    whole_robot = True
    uses_load = True
    prior = CoefficientPrior("A play is not negative, and below a degree.", positive=(0,), std=(0.01,))
    export_note = (
        "a second joint on the axis, with range +-backlash/2, between the rotor (a body of its own) and the link"
    )
    _SMALLEST, _LARGEST, _GRID_POINTS, _MOST_APART = 2e-4, 2e-2, 6, 3.0

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        # The time of flight, which is what they differ by, goes with the cube root.
        roots = np.linspace(np.cbrt(self._SMALLEST), np.cbrt(self._LARGEST), self._GRID_POINTS)
        return tuple({"flight": float(b)} for b in roots**3)

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        t, play, joint = signals.sequence(), shape["flight"], site.joint
        still, pushed = torch.zeros_like(signals.q), torch.zeros_like(signals.q)
        pushed[joint] = 1.0
        M = signals.load_slope(still, still, pushed)[joint]
        x = deviation(signals.load[joint], M, float(t[1] - t[0]), play)
        return {f"backlash({play:.6g}) {site.name(signals.robot)}": slope_along(signals, site, x / play)}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"backlash": coefficients[0], "flight": coefficients.new_tensor(shape["flight"])}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["backlash"],), {"flight": parameters["flight"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["flight"] / self._MOST_APART <= parameters["backlash"] <= self._MOST_APART * self._LARGEST


def deviation(load: Tensor, inertia: Tensor, dt: float, play: float) -> Tensor:
    """Return how far a link is from the middle of its play, x (*batch, N) [rad, m].

    Args:
        load: (*batch, N) torque that the link takes [N m, N].
        inertia: (*batch, N) that the joint moves while all others are held [kg m^2, kg].
        dt: [s]. play: full width [rad, m].
    """
    side, sample = torch.sign(load), torch.arange(load.shape[-1], device=load.device)
    turned = torch.diff(side, dim=-1, prepend=side[..., :1]) != 0
    left = torch.where(turned, sample, 0).cummax(-1).values
    # In double: the flight is a small difference of integrals over the whole sequence.
    # Parameters that no body has may leave an inertia of nothing or less: such a link is over at once.
    least = _LEAST_INERTIA * inertia.abs().max() + torch.finfo(load.dtype).eps
    pull = (-load / torch.maximum(inertia, least)).double()
    speed = torch.cumulative_trapezoid(pull, dx=dt, dim=-1)
    speed = torch.nn.functional.pad(speed, (1, 0))
    way = torch.nn.functional.pad(torch.cumulative_trapezoid(speed, dx=dt, dim=-1), (1, 0))
    flown = way - way.gather(-1, left) - speed.gather(-1, left) * ((sample - left) * dt)
    flown = flown.abs().clamp_max(play).to(load)
    return torch.where(left == 0, -side * play / 2, side * (play / 2 - flown))
