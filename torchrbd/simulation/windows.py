"""Windows of recordings that are rolled forward, and what drives a model through them.

The torque of a step is the mean over it of the recorded torque, linear between samples: no impulse is lost or late, as
with a torque that is held from one sample to the next.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.interpolate import CubicHermiteSpline, make_interp_spline
from torch import Tensor

from torchrbd.dataset.block_statistics import Block
from torchrbd.recordings import States
from torchrbd.simulation.plant import Plant
from torchrbd.simulation.rollout import Drive

STEP_S = 5e-3
"""Of a rollout."""
# Blocks follow on each other if no more than this lies between them [s].
_GAP_S = 0.5


@dataclass(frozen=True)
class Start:
    """When windows begin, and how long those are that begin there, [s] from the recording's start."""

    recording: str
    t: float
    lengths: tuple[float, ...]


@dataclass(frozen=True)
class Windows:
    """Windows of recordings, all in steps of ``STEP_S``.

    Attributes:
        starts: (W,) where they begin.
        signals: "q", "qd", "qdd" and, if there is one, "temperature" at the ends of steps, (W, K + 1, n_dof); "tau" in
            each step (zero where it is not known) and, by a model's name, that of its terms along the recorded motion
            if it has such, (W, K, n_dof).
    """

    starts: tuple[Start, ...]
    signals: Mapping[str, Tensor]

    def joined(self, other: Windows) -> Windows:
        """Return windows with the same signals together."""
        signals = {name: torch.cat((x, other.signals[name])) for name, x in self.signals.items()}
        return Windows(self.starts + other.starts, signals)

    def drive(self, model: str, moved: Tensor, *, alike: bool) -> Drive:
        """Return what drives a model.

        Args:
            model: its name.
            moved: (n_dof,) bool, joints whose torque is not known.
            alike: whether the model is the same in all recordings.
        """
        x, at = self.signals, torch.tensor([start.t for start in self.starts], dtype=torch.float64)
        return Drive(
            h=STEP_S,
            tau=x["tau"] - x[model] if model in x else x["tau"],
            moved=moved,
            q=x["q"],
            qd=x["qd"],
            qdd=x["qdd"],
            t=at,
            temperature=x.get("temperature"),
            recording=None if alike else self.starts[0].recording,
        )


def steps(length: float) -> int:
    """Return the steps of a length [s]."""
    return round(length / STEP_S)


def starts(blocks: Sequence[Block], length: float, most: int) -> list[tuple[str, float]]:
    """Return where windows begin, by recording and time [s]: one after the other in each run of blocks.

    Args:
        blocks: that may be looked at, in the order of each recording.
        length: of the windows [s].
        most: of more windows, as many are taken, evenly.
    """
    found = [
        (recording, round(first + k * length, 6))
        for recording, first, last in runs(blocks)
        for k in range(math.floor((last - first) / length + 1e-9))
    ]
    evenly = np.linspace(0, len(found) - 1, min(len(found), most)).round().astype(int)
    return [found[k] for k in evenly]


def runs(blocks: Sequence[Block]) -> list[tuple[str, float, float]]:
    """Return runs of blocks of one recording: its name, begin and end [s]."""
    found: list[tuple[str, float, float]] = []
    for block in blocks:
        if found and found[-1][0] == block.recording and 0 <= block.start_s - found[-1][2] < _GAP_S:
            found[-1] = (block.recording, found[-1][1], block.end_s)
        else:
            found.append((block.recording, block.start_s, block.end_s))
    return found


def cut(tiles: Iterable[States], wanted: Sequence[Start], plants: Mapping[str, Plant]) -> Windows | None:
    """Cut windows of a recording out of its tiles; those that a gap interrupts are left out.

    Args:
        tiles: of one recording.
        wanted: its windows.
        plants: by name.

    Returns:
        None if all are interrupted.
    """
    longest, found = max(length for start in wanted for length in start.lengths), dict[int, dict[str, Tensor]]()
    nodes = STEP_S * np.arange(steps(longest) + 1)
    for t, signals in pieces(tiles, plants, longest):
        for k, start in enumerate(wanted):
            # What lies beyond a window that is shorter than others does not count: there its end stands.
            at = np.minimum(start.t + nodes, start.t + max(start.lengths))
            first, last = np.searchsorted(t, at[0], "right") - 1, np.searchsorted(t, at[-1])
            if k not in found and first >= 0 and last < len(t):
                found[k] = driving(t[first : last + 1], {name: x[first : last + 1] for name, x in signals.items()}, at)
    if not found:
        return None
    stacked = {name: torch.stack([one[name] for one in found.values()]) for name in next(iter(found.values()))}
    return Windows(tuple(wanted[k] for k in found), stacked)


def driving(t: np.ndarray, signals: Mapping[str, np.ndarray], at: np.ndarray) -> dict[str, Tensor]:
    """Return signals (N, n_dof) of times (N,) at the ends of steps (K + 1,), and the means of torques over these.

    Positions are cubic between samples, with the velocities there; all else is linear.
    """
    resampled = {}
    for name, x in signals.items():
        if name == "q":
            resampled[name] = CubicHermiteSpline(t, x, signals["qd"])(at)
        elif name in ("qd", "qdd", "temperature"):
            resampled[name] = make_interp_spline(t, x, k=1)(at)
        else:
            resampled[name] = np.diff(make_interp_spline(t, x, k=1).antiderivative()(at), axis=0) / (at[1] - at[0])
    return {name: torch.from_numpy(x) for name, x in resampled.items()}


def pieces(
    tiles: Iterable[States], plants: Mapping[str, Plant], longest: float
) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Yield of each tile times (N,) and signals (N, n_dof), with those of the last ``longest`` [s] before it."""
    robot = next(iter(plants.values())).robot
    segment, t, signals = -1, np.empty(0), dict[str, np.ndarray]()
    for states in tiles:
        # A known load moves with the robot: its torque belongs to what drives.
        tau = (torch.nan_to_num(states.tau) + states.as_recorded(states.taken_off(robot))).T
        own = {name: getattr(states, name).T for name in ("q", "qd", "qdd")} | {"tau": tau}
        if states.temperature is not None:
            own["temperature"] = states.temperature.T
        for name, plant in plants.items():
            along = plant.of_recorded_motion(states)
            own |= {} if along is None else {name: along}
        if states.segment != segment:
            t, signals = np.empty(0), {name: x[:0].numpy() for name, x in own.items()}
        new = states.t.numpy() > (t[-1] + 0.5 * states.dt if len(t) else -np.inf)
        keep = t > (t[-1] - longest - 2.0 * states.dt if len(t) else -np.inf)
        segment, t = states.segment, np.concatenate((t[keep], states.t.numpy()[new]))
        signals = {name: np.concatenate((signals[name][keep], x.detach().numpy()[new])) for name, x in own.items()}
        yield t, signals
