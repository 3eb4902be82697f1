"""Actuator lag: the recorded command leads the acting torque, because the actuator responds as a first-order system."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from torchrbd.effects.band_limits import BANDWIDTHS_HZ, UNLIMITED_HZ, below
from torchrbd.effects.base import CoefficientPrior, Effect, Mjcf, Shape
from torchrbd.effects.recurrence import recurrence
from torchrbd.effects.signals import JointScale, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.effects.time_delay import at_site, joints_and_all
from torchrbd.robot import RobotModel

# In time constants: after so long the initial state no longer matters.
_FORGOTTEN = 20.0


class ActuatorLag(Effect):
    """tau += T d(tau_s)/dt, to first order in T; from T d(tau_acting)/dt + tau_acting = tau_command.

    tau_s is the torque that the actuator supplies to the rigid body and to friction. Friction jumps where the velocity
    changes sign; the command has a pulse there.

    A negative T is not allowed: a recorded torque that is late behind a filter is a time delay (``time_delay``).

    The derivative of the rigid-body torque amplifies the noise of the positions. It is therefore low-pass filtered
    (``below``); the data choose the cut-off frequency ``bandwidth``, a shape parameter.

    The effect acts at one joint, or at all joints with one time constant.
    """

    id = "actuator_lag"
    family = "actuator and sensor"
    words = "actuator lag"
    equation = "T dtau_s/dt"
    shown_by = "Quick changes of torque: the command runs ahead of the motion, by a torque in proportion to its rate."
    of_drives = True
    units: ClassVar[Mapping[str, str]] = {"time_constant": "s", "bandwidth": "Hz"}
    whole_robot = True
    uses_load = True
    has_memory = True
    sees_friction = True
    shifts_clocks = True
    lags = True
    of_the_data = ("bandwidth",)
    prior = CoefficientPrior(
        "An actuator follows its command within hundredths of a second.", positive=(0,), std=(0.05,)
    )
    export_note = "of the actuator of one joint or, for the whole robot, of all"
    _LONGEST_S = 0.2

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return joints_and_all(robot)

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return tuple({"bandwidth": hz} for hz in BANDWIDTHS_HZ)

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        t, band = signals.sequence(), shape["bandwidth"]
        dt = float(t[1] - t[0])
        of_load = at_site(signals.load, site, lambda x: below(signals.rate(x), dt, band))
        slope = of_load + at_site(signals.friction_torque, site, signals.rate)
        return {f"dtau/dt({band:.6g} Hz) {site.name(signals.robot)}": slope}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"time_constant": coefficients[0], "bandwidth": coefficients.new_tensor(shape["bandwidth"])}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["time_constant"],), {"bandwidth": parameters.get("bandwidth", UNLIMITED_HZ)}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return 0 <= parameters["time_constant"] <= self._LONGEST_S

    def of_clock_offset(self, delay_s: float) -> dict[str, float] | None:
        """Return the time constant of torques that are early: a command runs ahead of what it makes."""
        return {"time_constant": -delay_s} if delay_s < 0 else None

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        return {"general": {"dyntype": "filterexact", "dynprm": (parameters["time_constant"],)}}


def acting(command: Tensor, steps: float) -> Tensor:
    """Return the torque (..., N) of an actuator with a time constant of ``steps`` samples, for a command (..., N).

    The command is linear between samples. Before the first sample it is continued by reflection through that sample.
    """
    before = min(command.shape[-1] - 1, math.ceil(_FORGOTTEN * steps))
    longer = torch.cat((2 * command[..., :1] - command[..., 1 : before + 1].flip(-1), command), -1)
    decay = math.exp(-1.0 / steps)
    # Weights of the two ends of a command that is a straight line between two samples.
    last = 1.0 - steps * (1.0 - decay)
    first = 1.0 - decay - last
    drive = first * longer[..., :-1] + last * longer[..., 1:]
    return recurrence(longer[..., 0], torch.full_like(drive, decay), drive)[..., before:]
