"""How far models move from the recorded motion, rolled forward from recorded states under recorded torque.

A small torque error may be a large one of motion, and the other way round: a joint with much friction stays where it is
whatever its inertia. Errors are the root mean square of positions over a window; a window in which a motion is lost
counts as infinite. Open loops of unstable robots diverge: the median and quartiles over windows are reported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import Block
from torchrbd.dataset.reading import Progress, Reading
from torchrbd.display import Remark
from torchrbd.errors import InputError, PhysicalError
from torchrbd.model import RigidBodyDynamics
from torchrbd.robot import RobotModel
from torchrbd.simulation.plant import Plant
from torchrbd.simulation.rollout import rollout
from torchrbd.simulation.windows import STEP_S, Start, Windows, cut, starts, steps

LENGTHS_S = (0.2, 0.5, 1.0)
"""Of the windows."""
COASTING = "constant_velocity"
"""The trivial prediction: every joint goes on as fast as it was."""
_MOST_WINDOWS, _FEWEST_WINDOWS, _LOST, _QUARTILES = 40, 4, 1e300, (0.25, 0.5, 0.75)
_NOTHING = Remark("motion not simulated")


@dataclass(frozen=True)
class Spread:
    """Median and quartiles over windows, [rad] or [m]; infinite where the motion is lost."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class MotionError:
    """How far models move from the recorded positions within windows of one length.

    Attributes:
        window_s: their length.
        held_out: whether the windows are held-out data; if not, too little is held out.
        windows: how many, by joint; fewer where a joint's torque is not in every recording.
        errors: by model ("urdf", "rigid_body", "extended", and "constant_velocity" for comparison) and joint, the root
            mean square over a window.
    """

    window_s: float
    held_out: bool
    windows: dict[str, int]
    errors: dict[str, dict[str, Spread]]


class MotionErrors(NamedTuple):
    """Errors by length of the window, shortest first, and what else is to be known of them."""

    errors: tuple[MotionError, ...]
    notes: tuple[Remark, ...]


def motion_errors(
    reading: Reading,
    blocks: Sequence[Block],
    held_out: Sequence[bool],
    models: Mapping[str, RigidBodyDynamics],
    progress: Progress = lambda *_: None,
) -> MotionErrors:
    """Roll models forward from recorded states under recorded torque, and compare where they arrive.

    Joints without a torque are moved as recorded; known loads are part of the robot.

    Args:
        reading: the recordings.
        blocks: blocks of time to simulate.
        held_out: whether each is held out; the others are used too where these hold too few windows.
        models: by name.
        progress: called with the stage and the part of it that is done.
    """
    names, kept = reading.robot.joint_names, [block for block, held in zip(blocks, held_out, strict=True) if held]
    unseen = {length: len(starts(kept, length, _MOST_WINDOWS)) >= _FEWEST_WINDOWS for length in LENGTHS_S}
    wanted = _wanted({length: kept if unseen[length] else blocks for length in LENGTHS_S})
    try:
        rolled = list(_rolled(reading, wanted, models, progress))
    except (InputError, PhysicalError) as error:
        return MotionErrors((), (Remark("motion not simulated", {"error": str(error)}),))
    errors_by_length = [
        _motion_error(k, unseen[k], [errors for length, errors in rolled if length == k], names) for k in LENGTHS_S
    ]
    found = tuple(one for one in errors_by_length if one.windows)
    return MotionErrors(found, _notes(models, reading.robot) if found else (_NOTHING,))


def _wanted(blocks: Mapping[float, Sequence[Block]]) -> list[Start]:
    """Return where windows of each length begin in the blocks for it."""
    lengths: dict[tuple[str, float], list[float]] = {}
    for length, own in blocks.items():
        for begin in starts(own, length, _MOST_WINDOWS):
            lengths.setdefault(begin, []).append(length)
    return [Start(recording, t, tuple(own)) for (recording, t), own in sorted(lengths.items())]


def _rolled(
    reading: Reading, wanted: Sequence[Start], models: Mapping[str, RigidBodyDynamics], progress: Progress
) -> Iterator[tuple[float, dict[str, np.ndarray]]]:
    """Yield the length of each window and, by model, its error at each joint (n_dof,), NaN at joints that are moved."""
    batches: dict[object, tuple[Windows, dict[str, Plant], Tensor]] = {}
    for k, recording in enumerate(reading.recordings):
        own, measured = [one for one in wanted if one.recording == recording.name], reading.measured(k)
        load = reading.payload.get(recording.name)
        plants = {name: Plant(model, load) for name, model in models.items()}
        windows = cut(reading.tiles(k), own, plants) if own and bool(measured.any()) else None
        if windows is None:
            continue
        alone = load is not None or any(plant.conditional for plant in plants.values())
        key = k if alone else (*windows.signals, *measured.tolist())
        if key in batches:
            windows = batches[key][0].joined(windows)
        batches[key] = windows, plants, measured
    for k, (windows, plants, measured) in enumerate(batches.values()):
        progress("simulating motion", k / len(batches))
        yield from _errors(windows, plants, measured)


def _errors(
    windows: Windows, plants: Mapping[str, Plant], measured: Tensor
) -> Iterator[tuple[float, dict[str, np.ndarray]]]:
    """Roll all models through windows; yields as ``_rolled``."""
    drives = {name: windows.drive(name, ~measured, alike=not plant.conditional) for name, plant in plants.items()}
    recorded = next(iter(drives.values())).q
    q, qd = recorded[:, 0], windows.signals["qd"][:, 0]
    t = STEP_S * torch.arange(recorded.shape[1], dtype=q.dtype).reshape(-1, 1)
    paths = {name: rollout(plant, q, qd, drives[name])[0] for name, plant in plants.items()}
    paths[COASTING] = q.unsqueeze(1) + t * qd.unsqueeze(1)
    squares = {name: torch.nan_to_num((path - recorded).square(), torch.inf) for name, path in paths.items()}
    for k, start in enumerate(windows.starts):
        for length in start.lengths:
            ends = slice(1, steps(length) + 1)
            roots = {name: square[k, ends].mean(0).sqrt() for name, square in squares.items()}
            yield length, {name: torch.where(measured, x, torch.nan).numpy() for name, x in roots.items()}


def _motion_error(
    length: float, held_out: bool, errors: Sequence[dict[str, np.ndarray]], joints: Sequence[str]
) -> MotionError:
    """Summarise the errors of windows of one length."""
    windows, spreads = {}, dict[str, dict[str, Spread]]()
    for j, joint in enumerate(joints):
        known = [one for one in errors if not np.isnan(one[COASTING][j])]
        for name in known[0] if known else ():
            # Between a number and infinity nothing can be interpolated.
            values = np.minimum([one[name][j] for one in known], _LOST)
            low, median, high = (x if x < _LOST / len(known) else np.inf for x in np.quantile(values, _QUARTILES))
            spreads.setdefault(name, {})[joint] = Spread(float(median), float(low), float(high))
            windows[joint] = len(known)
    return MotionError(length, held_out, windows, spreads)


def _notes(models: Mapping[str, RigidBodyDynamics], robot: RobotModel) -> tuple[Remark, ...]:
    """Remark on terms do not act as they would on a simulated motion."""
    model = list(models.values())[-1]
    along = [[term.effect.id, term.site.name(robot)] for term in Plant(model).along]
    return (Remark("terms along the recorded motion", {"terms": along}),) if along else ()
