"""One driving joint and its actuator in MJCF: what several terms say of them is added up.

A torque in a recording may be ``gain`` times the one that acts, and friction was recorded with that gain:

    tau = gain load + f + offset    recorded, with f what springs, friction and the rotor take
    load + f / gain                 what acts: the joint's numbers in the file are those of f / gain
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from torchrbd.export.xml_text import Value

_JOINT = {"damping", "frictionloss", "armature", "stiffness", "springref", "ref"}
_ACTUATOR = {"biastype": "affine", "dyntype": "filterexact"}


@dataclass
class Drive:
    """The numbers of a joint and its actuator, in the joint's units.

    Attributes:
        damping, drag: torque per speed, and per speed times its size.
        frictionloss, armature: dry friction, and the rotor's inertia.
        stiffness, at_zero: torque of the springs per position, and at position zero.
        ref: what the encoder reads where the true position is zero.
        offset: constant torque that is recorded and does not act.
        gain: recorded torque over the one that acts.
        lag, delay, late: of the actuator (first order, dead time) and of the torque's reading [s].
        limit, clipped: largest torque of the actuator, and of the reading.
    """

    damping: float = 0.0
    drag: float = 0.0
    frictionloss: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    at_zero: float = 0.0
    ref: float = 0.0
    offset: float = 0.0
    gain: float = 1.0
    lag: float = 0.0
    delay: float = 0.0
    late: float = 0.0
    limit: float = math.inf
    clipped: float = math.inf

    def add_joint(self, attributes: Mapping[str, Value]) -> bool:
        """Add attributes of <joint>; say whether all of them are known, and add nothing if not."""
        if not attributes.keys() <= _JOINT or any(isinstance(value, str) for value in attributes.values()):
            return False
        given = {name: value if isinstance(value, tuple) else (value,) for name, value in attributes.items()}
        linear, quadratic, *more = (*given.pop("damping", (0.0,)), 0.0)
        if any(more) or any(len(value) > 1 for value in given.values()):
            return False
        one = {name: float(value[0]) for name, value in given.items()}  # type: ignore[arg-type]
        self.damping += float(linear)
        self.drag += float(quadratic)
        self.at_zero -= one.get("stiffness", 0.0) * one.pop("springref", 0.0)
        for name, value in one.items():
            setattr(self, name, getattr(self, name) + value)
        return True

    def add_actuator(self, attributes: Mapping[str, Value]) -> bool:
        """Add attributes of <general>; say whether all of them are known, and add nothing if not."""
        types = {name: value for name, value in attributes.items() if isinstance(value, str)}
        given = {
            name: value if isinstance(value, tuple) else (value,)
            for name, value in attributes.items()
            if not isinstance(value, str)
        }
        known = {"biasprm", "gainprm", "dynprm", "delay", "forcerange"}
        if not types.items() <= _ACTUATOR.items() or not given.keys() <= known or any(given.get("biasprm", ())[1:]):
            return False
        self.offset -= given.get("biasprm", (0.0,))[0]
        self.gain /= given.get("gainprm", (1.0,))[0]
        self.lag += given.get("dynprm", (0.0,))[0]
        self.delay += given.get("delay", (0.0,))[0]
        self.limit = min(self.limit, given.get("forcerange", (-math.inf, math.inf))[-1])
        return True

    def add_reading(self, attributes: Mapping[str, Value]) -> bool:
        """Add attributes of the sensor <actuatorfrc>; say whether all of them are known, and add nothing if not."""
        if not attributes.keys() <= {"delay", "cutoff"}:
            return False
        self.late += float(attributes.get("delay", 0.0))  # type: ignore[arg-type]
        self.clipped = min(self.clipped, float(attributes.get("cutoff", math.inf)))  # type: ignore[arg-type]
        return True

    def act(self) -> None:
        """Turn what was recorded with the gain into what acts."""
        recorded = ("damping", "drag", "frictionloss", "armature", "stiffness", "at_zero", "offset", "limit", "clipped")
        for name in recorded:
            setattr(self, name, getattr(self, name) / self.gain)
