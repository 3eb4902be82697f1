"""A joint that gives way: a spring between motor and link, as in harmonic drives, long shafts and belts.

The motor's position q is recorded; the link lags behind it by what the spring yields, q_link = q - tau_s / k, with
tau_s the torque that winds it: that of the link's motion, and of the joint's friction f where that is the link's,

    tau_s = tau_load + f + A x + B dx/dt + M d2x/dt2,  x = -tau_s / k of the joint, all other joints as recorded

with A, M the derivatives of the rigid body's torque with respect to the joint's q and qdd, and B that with respect to
qd, and the link's viscous friction. To first order in the compliance 1/k load and friction wind the spring. Whose the
friction is, the motor's or the link's, the data says: viscous friction of the link makes what accelerates it
late by its coefficient over k.
Higher orders are those of a series, tau_s put into its own right side twice, which is worked out for a compliance that
is a shape: it follows the coefficient 1/k. Near the resonance sqrt(k / M) the series ends too early; there the link
rings by itself, which is not contained, nor is damping beside the spring. Solving for the ringing instead would amplify
there what the positions' noise and wrong inertias make of the load. A spring that yields by more than .2 rad or m is
none that this could tell. What the motor's own inertia takes is rotor inertia, an effect of its own.

The load comes from accelerations, and is differentiated twice more: what noise there is in the positions would drown
the motion. So x is seen below a bandwidth that the data chooses as a shape, within the motion's band: through a
Butterworth filter, since one that fades earlier makes stiffness seem less than it is.

Source: Spong, "Modeling and control of elastic joint robots", ASME J. Dyn. Syst. Meas. Control 1987, for the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.band_limits import BANDWIDTHS_HZ, flat_below
from torchrbd.effects.base import CoefficientPrior, Effect, Shape
from torchrbd.effects.link_friction import PARTS, link_part
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site


class JointElasticity(Effect):
    """tau = tau_load(q - tau_s / k), linear in 1/k, with k > 0."""

    id = "joint_elasticity"
    family = "transmission"
    prevalence = "common"
    words = "joint elasticity"
    equation = "tau_load(q - tau_s/k) - tau_load(q)"
    shown_by = (
        "Fast oscillations under large loads: the link lags or leads the motor by an angle in proportion to torque."
    )
    units: ClassVar[Mapping[str, str]] = {
        "stiffness": "{tau}/{q}",
        "bandwidth": "Hz",
        "compliance": "{q}/({tau})",
        "link_friction": "1",
    }
    kinds: ClassVar[Mapping[str, Mapping[float, str]]] = {"link_friction": PARTS}
    whole_robot = True
    uses_load = True
    has_memory = True
    sees_friction = True
    follows = ("compliance",)
    reciprocals = ("stiffness",)
    of_the_data = ("bandwidth",)
    prior = CoefficientPrior("A spring yields in the direction that it is loaded in.", positive=(0,))
    export_note = "a second joint on the axis, with this stiffness, between the rotor (a body of its own) and the link"
    _FURTHEST, _ORDERS = 0.2, 3

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        kinds = ({"compliance": 0.0, "link_friction": link} for link in PARTS)
        return tuple({"bandwidth": hz, **kind} for kind in kinds for hz in BANDWIDTHS_HZ)

    def agreeing(self, coefficients: Tensor, shape: Shape) -> Shape:
        return {**shape, "compliance": max(0.0, float(coefficients[0]))}

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        t, joint = signals.sequence(), site.joint
        assert joint is not None
        dt, band, compliance = float(t[1] - t[0]), shape["bandwidth"], shape["compliance"]
        link, alone = link_part(shape), signals.load[joint]
        if link:
            alone = torch.lerp(alone, signals.supplied[joint], link)

        def added(winding: Tensor) -> Tensor:
            x = flat_below(-winding, dt, band)
            torque = signals.deviating(joint, x)
            if link and signals.friction is not None:
                torque[joint] += link * signals.friction[joint, 0] * signals.rate(x)
            return torque

        torque = added(alone)
        for _ in range(self._ORDERS - 1 if compliance else 0):
            torque = added(alone + compliance * torque[joint])
        return {f"elastic({band:.6g} Hz, {compliance:.6g}, {link:.3g}) {site.name(signals.robot)}": torque}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        values = {"bandwidth": 0.0, "compliance": 0.0, **shape, "link_friction": link_part(shape)}
        shapes = {name: coefficients.new_tensor(value) for name, value in values.items()}
        return {"stiffness": 1.0 / coefficients[0], **shapes}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        """Return them; without a compliance, that of the stiffness; without ``link_friction``, that of a motor."""
        compliance = 1.0 / parameters["stiffness"]
        return (compliance,), {
            "bandwidth": parameters["bandwidth"],
            "compliance": parameters.get("compliance", compliance),
            "link_friction": parameters.get("link_friction", 0.0),
        }

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        stiffness = parameters["stiffness"]
        return stiffness > 0 and (scale.load_max or 0.0) <= self._FURTHEST * stiffness
