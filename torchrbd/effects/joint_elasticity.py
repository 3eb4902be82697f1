"""A joint that gives way: a spring between motor and link, as in harmonic drives, long shafts and belts.

The motor's position q is recorded; the link lags behind it by what the spring yields, q_link = q - tau_load / k, and
the torque is that of the link's motion. To first order in the compliance 1/k

    tau += 1/k (A x + B dx/dt + M d2x/dt2),  x = -tau_load of the joint, all other joints as recorded

with A, B, M the derivatives of the rigid body's torque with respect to the joint's q, qd, qdd. The error grows with
1/k^2; a spring that yields by more than .2 rad or m is none that this could tell. Where the resonance sqrt(k / M) lies
above the band of the data, what is left is small (1 % of the stiffness, .1 % of the effect's power, for a pendulum);
inside the band the link rings by itself, which is not contained, nor is damping beside the spring. What the motor's own
inertia takes is rotor inertia, an effect of its own; its friction does not wind the spring, and the link's is left out.

The load comes from accelerations, and is differentiated twice more: what noise there is in the positions would drown
the motion. So x is seen below a bandwidth, with the response exp(-(f/b)^2 / 2), that the data chooses as a shape.

Source: Spong, "Modeling and control of elastic joint robots", ASME J. Dyn. Syst. Meas. Control 1987, for the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.base import CoefficientPrior, Effect, Shape
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site


class JointElasticity(Effect):
    """tau = tau_load(q - tau_load / k), linear in 1/k, with k > 0."""

    id = "joint_elasticity"
    family = "transmission"
    prevalence = "common"
    words = "joint elasticity"
    equation = "tau_load(q - tau_load/k) - tau_load(q)"
    units: ClassVar[Mapping[str, str]] = {"stiffness": "{tau}/{q}", "bandwidth": "Hz"}
    whole_robot = True
    uses_load = True
    has_memory = True
    prior = CoefficientPrior("A spring yields in the direction that it is loaded in.", positive=(0,))
    export_note = "a second joint on the axis, with this stiffness, between the rotor (a body of its own) and the link"
    _FURTHEST, _BANDWIDTHS_HZ = 0.2, (1.5, 3.0, 6.0, 12.0, 48.0)

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return tuple({"bandwidth": hz} for hz in self._BANDWIDTHS_HZ)

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        t, band = signals.sequence(), shape["bandwidth"]
        yielding = below(-signals.load[site.joint], float(t[1] - t[0]), band)
        return {f"elastic({band:.6g} Hz) {site.name(signals.robot)}": signals.deviating(site.joint, yielding)}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"stiffness": 1.0 / coefficients[0], "bandwidth": coefficients.new_tensor(shape["bandwidth"])}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (1.0 / parameters["stiffness"],), {"bandwidth": parameters["bandwidth"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        stiffness = parameters["stiffness"]
        return stiffness > 0 and (scale.load_max or 0.0) <= self._FURTHEST * stiffness


def below(x: Tensor, dt: float, hz: float) -> Tensor:
    """Return what of x (..., N) at intervals dt [s] lies below a frequency [Hz]; mirrored through its ends."""
    first, last = x[..., :1], x[..., -1:]
    longer = torch.cat((2 * first - x.flip(-1)[..., :-1], x, 2 * last - x.flip(-1)[..., 1:]), -1)
    f = torch.fft.rfftfreq(longer.shape[-1], dt, dtype=x.dtype, device=x.device)
    spectrum = torch.fft.rfft(longer) * torch.exp(-0.5 * (f / hz) ** 2)
    return torch.fft.irfft(spectrum, longer.shape[-1])[..., x.shape[-1] - 1 : 2 * x.shape[-1] - 1]
