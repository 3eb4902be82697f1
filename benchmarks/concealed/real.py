"""Effects hidden in real recordings: real noise, real friction, real unknowns, and one thing more that is known.

    TORCHRBD_DATA=/path/to/recordings python -m benchmarks.concealed.real --count 12 --sizes .15 .08 --seed 0 -o DIR

The torque that an effect adds along the measured motion, as far as that rises above noise, is added to the *measured*
torque; what sensors do is done to what they measured. Each data set also makes an untouched case: what a diagnosis of
it finds is there anyway, and against it exactly the hidden effect must be new. Folders are those of the other cases
(``cases``, ``truth``).
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet
from rich.progress import track

from .contract import Effect, Record, Window
from .effects import EFFECTS
from .motion import Motion
from .real_data import DATA_SETS, RealRobot, Taken, take
from .robots import Robot
from .simulate import Refused
from .sizes import Size, Yardstick

# What can be added to torques that were measured: neither what moves the robot otherwise (play, elastic joints) nor
# what only the true masses tell (a tilted base, wrong geometry).
HIDDEN = (
    "joint_spring", "one_sided_spring", "counterbalance", "torque_ripple", "joint_coupling", "velocity_coupling",
    "quadratic_drag", "power_law_friction", "stribeck_friction", "load_dependent_friction", "time_varying_friction",
    "position_dependent_friction", "cable_drag", "presliding_hysteresis", "rotor_inertia", "torque_scale",
    "time_delay", "payload", "external_wrench",
)  # fmt: skip
# Where a joint turns on and on, an angle is no place.
OF_ANGLES = (
    "joint_spring", "one_sided_spring", "position_dependent_friction", "cable_drag", "presliding_hysteresis",
)  # fmt: skip
OF_SENSORS = ("torque_scale", "time_delay")
IN_WINDOWS = ("payload", "external_wrench")
SIZES = (0.04, 0.08, 0.16)
_ATTEMPTS = 40


def added(effect: Effect, x: Motion, t: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Return what an effect adds to measured torques (N, n) at times (N,)."""
    if effect.id in OF_SENSORS:
        record = Record(t, np.zeros_like(torque), torque.copy())
        effect.sense(record)
        return record.tau - torque
    return np.stack([np.interp(t, x.t, column) for column in effect.torque(x).T], axis=1)


class RealYardstick(Yardstick):
    """Measure what sensors do by what they do to the measured torque: the rigid body's is not known."""

    def __init__(self, recordings: Sequence[Taken]) -> None:
        super().__init__([r.motion for r in recordings], [r.torque for r in recordings])
        self.recordings = recordings

    def of(self, effect: Effect) -> Size:
        torques = [added(effect, r.motion, r.motion.t, r.torque) for r in self.recordings]
        return self.size(torques, effect.beside_friction, effect.window)


def draw_hidden(rng: np.random.Generator, kind: str, target: float, yardstick: RealYardstick) -> Effect:
    """Draw an effect of a kind and size.

    Raises:
        Refused: after many attempts none had that size.
    """
    motions = yardstick.motions
    longest = max(motions, key=lambda x: x.t[-1])
    for _ in range(_ATTEMPTS):
        effect = EFFECTS[kind].draw(rng, longest, int(rng.integers(longest.robot.n)))
        if kind in IN_WINDOWS:
            start, length = rng.uniform(0.1, 0.5), rng.uniform(0.25, 0.4)
            effect.window = Window(longest.file, *(round(float(longest.t[-1] * p), 2) for p in (start, start + length)))
        try:
            return yardstick.scaled(effect, target)
        except Refused:
            continue
    raise Refused(f"no {kind} of size {target:g} fits these recordings")


def truth_of(effect: Effect, target: float, yardstick: RealYardstick) -> dict[str, Any]:
    """Return the entry of a truth file, as truth.py documents it."""
    x, size, window = yardstick.motions[0], yardstick.of(effect), effect.window
    robot = x.robot
    place = effect.place(robot)
    return {
        "effect": effect.id,
        **{key: place[key] for key in ("joints", "links", "other")},
        "parameters": {name: float(value) for name, value in effect.parameters(x).items()},
        "where": {
            "recordings": None if window is None else [window.file],
            "time_s": None if window is None else [[window.start, window.end]],
            "region": place["region"],
        },
        "size": float(size.left.max()),
        "raw_size": float(size.raw.max()),
        "target_size": target,
        "size_by_joint": dict(zip(robot.joints, size.left.tolist(), strict=True)),
        "in_holdout": window is None,
        "depends_on": effect.depends_on(robot),
        "indistinguishable": list(effect.same_as(robot)),
    }


def write_case(folder: Path, robot: Robot, recordings: Sequence[Taken], effect: Effect | None) -> None:
    """Write a URDF and recordings, with an effect in their torque if given."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(robot.urdf, encoding="utf-8")
    for taken in recordings:
        table = dict(taken.table)
        if effect is not None:
            torque = np.stack([table[f"tau_{joint}"] for joint in robot.joints], axis=1)
            torque = torque + added(effect, taken.moved, table["t"], torque)
            table |= {f"tau_{joint}": column for joint, column in zip(robot.joints, torque.T, strict=True)}
        parquet.write_table(pa.table(table), folder / taken.motion.file)


def generate(data: Path, out: Path, count: int, seed: int, sizes: Sequence[float] = SIZES) -> None:
    """Write the untouched case and ``count`` cases with an effect for each data set.

    Args:
        data: folder of the data sets.
        out: folder for ``cases`` and ``truth``.
        count: for each data set; kinds, then sizes, take turns.
        seed: of all draws.
        sizes: of the effects, in turns.
    """
    (out / "truth").mkdir(parents=True, exist_ok=True)
    for number, (name, one) in enumerate(DATA_SETS.items()):
        folder = data / one.folder
        robot = RealRobot(name, (folder / one.urdf).read_text(encoding="utf-8"))
        names = [f"fit_{k + 1}.parquet" for k in range(len(one.fit))]
        fitted = [take(robot, folder / file, new) for file, new in zip(one.fit, names, strict=True)]
        left_out = [take(robot, folder / one.holdout, "holdout.parquet")] if one.holdout else []
        recordings = [*fitted, *left_out]
        rng, yardstick = np.random.default_rng([seed, number]), RealYardstick(fitted)
        turns = max(float(np.ptp(r.motion.q)) for r in fitted) > 2 * np.pi
        kinds = [k for k in HIDDEN if (robot.n > 1 or "coupling" not in k) and not (turns and k in OF_ANGLES)]
        order = rng.permutation(kinds).tolist()
        baseline = _identifier(rng)
        _write(out, robot, recordings, baseline, None, {"tier": "untouched", "effects": []})
        for k in track(range(count), name):
            kind, target = order[k % len(order)], sizes[k % len(sizes)]
            try:
                effect = draw_hidden(rng, kind, target, yardstick)
            except Refused as refusal:
                print(f"{name}: {refusal}")
                continue
            entry = {"tier": "injected", "index": k, "effects": [truth_of(effect, target, yardstick)]}
            entry |= {"seed": seed, "baseline": baseline}
            _write(out, robot, recordings, _identifier(rng), effect, entry)


def _identifier(rng: np.random.Generator) -> str:
    return rng.bytes(6).hex()


def _write(
    out: Path, robot: Robot, recordings: Sequence[Taken], case: str, effect: Effect | None, entry: dict[str, Any]
) -> None:
    write_case(out / "cases" / case, robot, recordings, effect)
    told = {"name": robot.name, "joints": list(robot.joints), "links": list(robot.links)}
    rest = {"schema": 1, "set": "real", "id": case, "robot": told, "companions": [], "background": []}
    (out / "truth" / f"{case}.json").write_text(json.dumps({**rest, **entry}, indent=1), encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse and generate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=12, help="cases for each data set")
    parser.add_argument("--seed", type=int, default=0, help="of all draws; the final set's is another one")
    parser.add_argument("--sizes", type=float, nargs="+", default=SIZES, help="parts of the joint's torque, in turns")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for cases and truth")
    options = parser.parse_args(arguments)
    data = os.environ.get("TORCHRBD_DATA")
    if not data or not Path(data).is_dir():
        print("TORCHRBD_DATA names no folder of real recordings; see examples/real_recordings.py for their sources")
        return 2
    generate(Path(data), options.output, options.count, options.seed, options.sizes)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
