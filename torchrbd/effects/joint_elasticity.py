"""Joint elasticity: a spring between motor and link, as in harmonic drives, long shafts and belts.

The motor's position q is recorded. The link lags behind it by the deflection of the spring, q_link = q - tau_s / k. The
torque tau_s in the spring moves the link, and overcomes the joint's friction f if that acts on the link:

    tau_s = tau_load + f + A x + B dx/dt + M d2x/dt2,  x = -tau_s / k of the joint, all other joints as recorded

A and M are the derivatives of the rigid-body torque with respect to the joint's q and qdd. B is that with respect to qd
plus the link's viscous friction. To first order in the compliance 1/k, load and friction deflect the spring. The data
decide whether the friction acts on the motor or on the link. Viscous friction on the link delays the torque that
accelerates it by its coefficient over k.

Higher orders are a series: tau_s is inserted into its own right side twice. They are computed at a given compliance, a
shape parameter that follows the coefficient 1/k. Near the resonance sqrt(k / M) the series is too short. There the link
oscillates freely, which is not modelled; nor is damping of the spring. To solve for the oscillation instead would
amplify the errors of the load there: noise of the positions and wrong inertias. A spring that deflects by more than .2
rad or m is outside the model. The torque for the motor's own inertia is rotor inertia, a separate effect.

The load comes from accelerations and is differentiated twice more, which amplifies the noise of the positions beyond
the motion. So x is low-pass filtered, within the motion's band; the data choose the cut-off frequency, a shape
parameter. The filter is a Butterworth: one that attenuates earlier makes the stiffness seem too small.

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
    """tau += tau_load(q - tau_s / k) - tau_load(q), linear in the compliance 1/k, with stiffness k > 0.

    q is the motor's position, q - tau_s / k the link's. tau_s is the torque in the spring: the rigid-body torque, and
    the joint's friction if that acts on the link (``link_friction`` = 1). ``bandwidth`` is the frequency below which
    the deflection is computed.
    """

    id = "joint_elasticity"
    family = "transmission"
    prevalence = "common"
    words = "joint elasticity"
    equation = "tau_load(q - tau_s/k) - tau_load(q)"
    shown_by = (
        "Fast oscillations under large loads: the link lags or leads the motor by an angle in proportion to torque."
    )
    is_gear_spring = True
    own_signals = ("q",)
    of_drives = True
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
    prior = CoefficientPrior("A spring deflects in the direction of its load.", positive=(0,))
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
        """Return w and the shape; defaults: the compliance of the given stiffness, friction that acts on the motor."""
        compliance = 1.0 / parameters["stiffness"]
        return (compliance,), {
            "bandwidth": parameters["bandwidth"],
            "compliance": parameters.get("compliance", compliance),
            "link_friction": parameters.get("link_friction", 0.0),
        }

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        stiffness = parameters["stiffness"]
        return stiffness > 0 and (scale.load_max or 0.0) <= self._FURTHEST * stiffness
