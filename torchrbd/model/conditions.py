"""Conditions of a recording that change its torque column: clock offset, actuator lag, a known load.

    tau_recorded(t) = tau(t - delay) + lag d tau / dt (t - delay)

Clock offset and lag are not forces on the robot, so a model without a recording's name ignores them. Models store the
conditions by recording, because the fit and its reported error depend on them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchrbd.effects.actuator_lag import acting
from torchrbd.effects.time_delay import delayed
from torchrbd.errors import InputError
from torchrbd.recordings import LowPass

OTHERS = ""
"""Key of the condition of all recordings that a model does not know."""


@dataclass(frozen=True)
class Condition:
    """The conditions of one recording.

    Attributes:
        delay_s: delay of its torque relative to its motion [s]; negative if the torque is early.
        lag_s: time constant of the actuators, if its torque is their command [s].
        load: (n_params,) inertial parameters of the known load that the robot carried; None without one.
        simulated: name of the simulator's recording whose torque beyond the URDF is not in the model; empty without
            one.
        held_out_s: windows (from, to) of its time that are held out [s].
    """

    delay_s: float = 0.0
    lag_s: float = 0.0
    load: Tensor | None = None
    simulated: str = ""
    held_out_s: tuple[tuple[float, float], ...] = ()

    @property
    def moves_torque(self) -> bool:
        """Whether its torque column is delayed or a command."""
        return bool(self.delay_s or self.lag_s)

    def recorded(self, torque: Tensor, dt: float) -> Tensor:
        """Return the torque column for an acting torque (..., N), at an interval dt [s]."""
        if self.lag_s:
            torque = torque + self.lag_s * torch.gradient(torque, spacing=dt, dim=-1)[0]
        return delayed(torque, self.delay_s / dt) if self.delay_s else torque

    def acting(self, torque: Tensor, dt: float) -> Tensor:
        """Return the acting torque for a torque column (..., N): the inverse of ``recorded``."""
        torque = delayed(torque, -self.delay_s / dt) if self.delay_s else torque
        return acting(torque, self.lag_s / dt) if self.lag_s else torque

    def held_out(self, t: Tensor) -> Tensor:
        """Return which times (N,) [s] are held out."""
        inside = torch.zeros(t.shape, dtype=torch.bool)
        for first, last in self.held_out_s:
            inside |= (t >= first) & (t <= last)
        return inside

    def without_clock(self) -> Condition:
        """Return the same condition without delay and lag."""
        return replace(self, delay_s=0.0, lag_s=0.0)


NO_CONDITION = Condition()


@dataclass(frozen=True)
class Reported:
    """The error that was reported for a model when it was fitted, see ``replay``.

    Attributes:
        cutoff_hz: band limit of the torques [Hz].
        nmse: by joint, on held-out rows.
        low_pass: what recorded torques had passed before; None if nothing.
    """

    cutoff_hz: float
    nmse: dict[str, float]
    low_pass: LowPass | None = None

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> Reported:
        """Return what a file holds."""
        passed = content.get("low_pass")
        return cls(content["cutoff_hz"], content["nmse"], None if passed is None else LowPass(**passed))


def condition_of(conditions: Mapping[str, Condition], recording: str | None) -> Condition:
    """Return the condition of a recording: its own, that of unknown recordings, or an empty one without a name."""
    if recording is None:
        return NO_CONDITION
    return conditions.get(recording) or conditions.get(OTHERS, NO_CONDITION)


def interval(t: Tensor | None, recording: str | None) -> float:
    """Return the interval of a sequence of times [s].

    Raises:
        InputError: the times are not a sequence.
    """
    if t is None or t.ndim != 1 or len(t) < 2:
        raise InputError(
            f"the torque of recording '{recording}' is not that of the same instant: give t (N,), evenly spaced "
            "seconds, with q, qd and qdd (*batch, N, n_dof); or leave out recording, for the torque that acts"
        )
    return float(t[1] - t[0])


def to_content(conditions: Mapping[str, Condition]) -> dict[str, Any]:
    """Return conditions as content for JSON, by recording."""
    found = {}
    for name, one in conditions.items():
        load = None if one.load is None else one.load.tolist()
        found[name] = asdict(replace(one, load=None)) | {"load": load}
    return found


def from_content(content: Mapping[str, Any]) -> dict[str, Condition]:
    """Return conditions from the result of ``to_content``."""
    found = {}
    for name, one in content.items():
        load = None if one["load"] is None else torch.tensor(one["load"], dtype=torch.float64)
        spans = tuple((float(first), float(last)) for first, last in one["held_out_s"])
        found[name] = Condition(one["delay_s"], one["lag_s"], load, one["simulated"], spans)
    return found
