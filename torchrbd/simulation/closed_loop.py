"""Closed loops: a model whose drives follow recorded set-points, as a simulator would run it.

The drives hold the motion near the recorded one, so that whole motions can be compared, not only short windows. The
error of a model is the root mean square distance from the recorded positions. It does not depend on how a torque was
computed, and needs none: it judges inertia, friction, gains and delay together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import Block
from torchrbd.dataset.reading import Progress, Reading
from torchrbd.display import Remark
from torchrbd.errors import InputError, PhysicalError
from torchrbd.model import RigidBodyDynamics
from torchrbd.recordings import Recording
from torchrbd.simulation.plant import Plant
from torchrbd.simulation.rollout import Commands, Drive, rollout
from torchrbd.simulation.windows import STEP_S, Start, Windows, cut, runs, steps

# Longest piece of a motion that is simulated at once [s], and how many of these.
_LONGEST_S, _MOST = 30.0, 16


@dataclass(frozen=True)
class ClosedLoop:
    """How far models move from the recorded positions when their drives follow the recorded set-points.

    Attributes:
        seconds: how long the simulated motions are, together.
        held_out: whether they are held-out data; if not, too little is held out.
        errors: by model ("urdf", "baseline", "rigid_body", "extended") and joint, root mean square over all of them
            [rad, m]; infinite where a motion was lost.
        tracking: by joint, root mean square of the recorded difference of set-point and position [rad, m].
    """

    seconds: float
    held_out: bool
    errors: dict[str, dict[str, float]]
    tracking: dict[str, float]


def closed_loop(
    reading: Reading,
    blocks: Sequence[Block],
    held_out: Sequence[bool],
    models: Mapping[str, RigidBodyDynamics],
    progress: Progress = lambda *_: None,
) -> tuple[ClosedLoop | None, tuple[Remark, ...]]:
    """Simulate the held-out motions of robots with drives, whole or in pieces of ``_LONGEST_S``.

    Joints without a torque are moved as recorded; known loads are part of the robot.

    Args:
        reading: the recordings.
        blocks: blocks of time.
        held_out: whether each is held out; all are used where none is.
        models: by name.
        progress: called with the stage and the part of it that is done.

    Returns:
        The errors, None without drives or motions; and what else is to be known of them.
    """
    kept = [block for block, held in zip(blocks, held_out, strict=True) if held]
    wanted = _pieces(kept or blocks)
    errors, tracking, notes = dict[str, list[Tensor]](), list[Tensor](), list[Remark]()
    names, seconds = reading.robot.joint_names, 0.0
    for k, recording in enumerate(reading.recordings):
        own = [one for one in wanted if one.recording == recording.name]
        if not own or not recording.drives.of:
            continue
        load = reading.payload.get(recording.name)
        plants = {name: Plant(model, load) for name, model in models.items()}
        windows = cut(reading.tiles(k), own, plants)
        if windows is None:
            continue
        inside, recorded = _inside(windows), windows.signals["q"]
        at = np.array([start.t for start in windows.starts])[:, None] + STEP_S * np.arange(recorded.shape[1])
        seconds += STEP_S * float(inside.sum())
        for name, plant in plants.items():
            progress("simulating motion", (k + list(plants).index(name) / len(plants)) / len(reading.recordings))
            drive = windows.drive(name, ~reading.measured(k), alike=not plant.conditional)
            drive = with_commands(drive, recording, at)
            try:
                path = rollout(plant, recorded[:, 0], windows.signals["qd"][:, 0], drive)[0]
            except (InputError, PhysicalError) as error:
                notes.append(Remark("motion not simulated", {"error": str(error)}, name))
                continue
            far = torch.nan_to_num(path - recorded, nan=torch.inf)
            errors.setdefault(name, []).append(torch.where(reading.measured(k), far, torch.nan)[inside])
        wanted_q = torch.from_numpy(set_points(recording, at))
        driven = torch.from_numpy(recording.drives.stiffness > 0) & reading.measured(k)
        tracking.append(torch.where(driven, wanted_q - recorded, torch.nan)[inside])
    if not errors:
        return None, tuple(notes)
    by_model = {name: _by_joint(parts, names) for name, parts in errors.items()}
    return ClosedLoop(seconds, bool(kept), by_model, _by_joint(tracking, names)), tuple(notes)


def with_commands(drive: Drive, recording: Recording, at: np.ndarray) -> Drive:
    """Return the same with drives that follow set-points in place of their torque.

    Args:
        drive: what drives windows otherwise.
        recording: that has the set-points.
        at: (W, K + 1) times of the steps' ends [s].
    """
    drives = recording.drives
    gains = (torch.from_numpy(x) for x in (drives.stiffness, drives.damping, drives.limits))
    commands = Commands(torch.from_numpy(set_points(recording, at)), *gains)
    return replace(drive, tau=torch.where(commands.kp > 0, 0.0, drive.tau), commands=commands)


def set_points(recording: Recording, at: np.ndarray) -> np.ndarray:
    """Return the set-points that drives follow at times (..., K) [s], (..., K, n_dof); zero at other joints."""
    chunks = [(chunk.t, chunk.q_ref) for chunk in recording.chunks() if chunk.q_ref is not None]
    t, q_ref = (np.concatenate(parts) for parts in zip(*chunks, strict=True))
    found = np.zeros((*at.shape, len(recording.joints)))
    for k in recording.drives.index:
        known = np.isfinite(t) & np.isfinite(q_ref[:, k])
        found[..., k] = np.interp(at, t[known], q_ref[known, k])
    return found


def _pieces(blocks: Sequence[Block]) -> list[Start]:
    """Return the pieces of the runs of blocks, as many as are simulated, evenly."""
    found = [
        Start(recording, first + k * _LONGEST_S, (min(_LONGEST_S, last - first - k * _LONGEST_S),))
        for recording, first, last in runs(blocks)
        for k in range(int(np.ceil((last - first) / _LONGEST_S - 1e-9)))
    ]
    long = [one for one in found if steps(one.lengths[0]) > 1]
    evenly = np.linspace(0, len(long) - 1, min(len(long), _MOST)).round().astype(int)
    return [long[k] for k in evenly]


def _inside(windows: Windows) -> Tensor:
    """Return which ends of steps (W, K + 1) lie within their window, the start left out; what follows is padding."""
    k = torch.arange(windows.signals["q"].shape[1])
    last = torch.tensor([steps(start.lengths[0]) for start in windows.starts])
    return (k > 0) & (k <= last.unsqueeze(1))


def _by_joint(parts: Sequence[Tensor], names: Sequence[str]) -> dict[str, float]:
    """Return the root mean square (N, n_dof) of joints that have one; NaN where a recording has no torque."""
    rms = torch.cat(list(parts)).square().nanmean(0).sqrt().tolist()
    return {name: x for name, x in zip(names, rms, strict=True) if not np.isnan(x)}
