"""How often a right table is suspected, and whether exchanged torques and URDFs of other variants are told.

    python benchmarks/suspicions.py real         # every set of real recordings, as it stands
    python benchmarks/suspicions.py simulated    # arms with friction, springs and ripple
    python benchmarks/suspicions.py exchanged    # the KR300, two axes' torques exchanged
    python benchmarks/suspicions.py lengths      # arms whose URDF has two links 20 to 40 % too long or too short
    python benchmarks/suspicions.py inertials    # the same arms of seven joints with the right lengths

Prints what is told of each set, and the processor's seconds; of right tables nothing should be. Real recordings are
read from the folder that TORCHRBD_DATA names. Needs the test extra.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import import_paths  # noqa: F401
import noisy_robots
import numpy as np
import real_recordings as real
from pyarrow import csv
from rich.progress import track
from robot.random_robots import random_urdf
from simulated import record, with_lengths, with_wrong_inertials

import torchrbd
from torchrbd import Recording
from torchrbd.effects import effect
from torchrbd.errors import InputError
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.preparation import prepare
from torchrbd.inference.suspicions import suspicions
from torchrbd.robot import RobotModel, joint_origins

Case = tuple[str, Any, list[Any], dict[str, Any]]
DEMO = Path(torchrbd.__file__).parent / "demo"
TORQUES = (
    lambda m: 1.0 * np.sign(m.qd) + 0.5 * m.qd,
    lambda m: 2.0 * np.sign(m.qd) + 3.0 * (m.q - 0.4),
    lambda m: 0.5 * np.sign(m.qd) + 1.5 * np.sin(6.0 * m.q) + 0.3 * m.qdd,
)


def of_real_robots(data: Path) -> Iterator[Case]:
    """Yield each recording alone, and those of a robot together."""
    yield "demo", DEMO / "arm.urdf", [DEMO / "fit.parquet"], {"holdout": [DEMO / "holdout.parquet"]}
    yield "demo, held out", DEMO / "arm.urdf", [DEMO / "holdout.parquet"], {}
    for name in ("kuka_kr300", "emps", "panda", "dfki_pendulum"):
        robot, files = data / name / "robot.urdf", sorted((data / name).glob("*.csv"))
        every = [[file] for file in files] + ([files] if len(files) > 1 else [])
        yield from ((f"{name}: {', '.join(f.stem for f in one)}", robot, one, {}) for one in every)
    pendulum = data / "dfki_double_pendulum"
    for design in "AC":
        files = real.recordings_of(data, design)
        for urdf in "AC":
            split = {"holdout": files[-2:], "cutoff_hz": real.PENDULUM_CUTOFF_HZ}
            yield f"double pendulum {design}, URDF {urdf}", pendulum / f"robot_{urdf}.urdf", files[:-2], split
        for file in sorted(pendulum.glob(f"{design}_*.csv")):
            yield f"double pendulum: {file.stem}", pendulum / f"robot_{design}.urdf", [file], {}


def of_simulated_arms(count: int = 20) -> Iterator[Case]:
    """Yield arms of three to seven joints whose URDF is 30 % off."""
    for seed in range(count):
        kinds = ("revolute", "prismatic") if seed % 3 else ("revolute",)
        urdf = random_urdf(300 + seed, 3 + seed % 5, kinds=kinds, branching=0.2, massless=0.0)
        one = record(urdf, seed, extra=TORQUES[seed % 3], duration_s=(12.0, 20.0, 40.0)[seed % 3])
        yield f"arm {seed}, {3 + seed % 5} joints", with_wrong_inertials(urdf, seed, 0.3), [one], {}


def of_exchanged_torques(data: Path) -> Iterator[Case]:
    """Yield the recordings of the KR300 with the torques of two axes exchanged, each pair and each recording alone."""
    folder = data / "kuka_kr300"
    for file in sorted(folder.glob("*.csv")):
        table = csv.read_csv(file)
        values = {name: table[name].to_numpy().astype(float) for name in table.column_names}
        joints = [name[4:] for name in values if name.startswith("tau_")]
        for a, b in combinations(joints, 2):
            own = {**values, f"tau_{a}": values[f"tau_{b}"], f"tau_{b}": values[f"tau_{a}"]}
            t, q, tau = own["t"], *(np.stack([own[f"{s}_{j}"] for j in joints], 1) for s in ("q", "tau"))
            recording = Recording.from_arrays(file.name, joints, t=t, q=q, tau=tau)
            yield f"{file.stem}, {a} and {b}", folder / "robot.urdf", [recording], {}


def of_seven_joints() -> Iterator[Case]:
    """Yield arms of seven joints, noisily recorded, whose URDF has inertials that are 25 % off."""
    arms = {**noisy_robots.development_robots(), **noisy_robots.final_robots()}
    for seed, (name, urdf) in enumerate(arms.items()):
        yield name, noisy_robots.perturbed(urdf, seed), [noisy_robots.noisy_recording(urdf, seed)[0]], {}


def of_other_lengths() -> Iterator[Case]:
    """Yield the arms of seven joints, and the others, with two joints elsewhere in the URDF than on the robot."""
    for seed, (name, urdf, recordings, options) in enumerate((*of_seven_joints(), *of_simulated_arms())):
        rng, robot = np.random.default_rng([seed, 5]), RobotModel.from_urdf(urdf)
        sites, origins = effect("geometry_error").sites(robot), joint_origins(robot)
        some = [site.joint for site in sites if site.joint is not None and bool(origins[site.joint].any())]
        chosen = rng.choice(some, 2, replace=False)
        parts = {robot.joint_names[j]: 1.0 + float(rng.choice((-1, 1)) * rng.uniform(0.2, 0.4)) for j in chosen}
        words = ", ".join(f"{joint} {100 * (part - 1):+.0f} %" for joint, part in parts.items())
        yield f"{name}: {words}", with_lengths(urdf, parts), recordings, options


def told(case: Case) -> tuple[str, float]:
    """Return what is suspected of a set of recordings, and the processor's time [s]."""
    _, robot, recordings, options = case
    try:
        prepared = prepare(*read_arguments(robot, recordings, options, "suspicions"), ())
        start = time.process_time()
        found = suspicions(prepared).found
    except InputError as error:
        return f"refused: {error}", 0.0
    words = (f"{one.kind} of {', '.join(one.joints) or 'all'}, {one.log_odds:.1f} nats" for one in found)
    return "; ".join(words), time.process_time() - start


def main() -> int:
    """Print what is told of each set, and of how many sets something is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("real", "simulated", "exchanged", "lengths", "inertials"))
    what = parser.parse_args().what
    data = Path(os.environ.get("TORCHRBD_DATA", ""))
    if what in ("real", "exchanged") and not (data / "kuka_kr300").is_dir():
        parser.error("TORCHRBD_DATA names no folder of real recordings; see examples/real_recordings.py")
    cases = {"real": lambda: of_real_robots(data), "exchanged": lambda: of_exchanged_torques(data)}
    made = {"simulated": of_simulated_arms, "lengths": of_other_lengths, "inertials": of_seven_joints}
    every = list((cases | made)[what]())
    results = {case[0]: told(case) for case in track(every, what)}
    for name, (words, seconds) in results.items():
        print(f"{name}: {words or 'nothing'} ({seconds:.2f} s)")
    judged = [words for words, _ in results.values() if not words.startswith("refused")]
    print(f"{sum(bool(words) for words in judged)} of {len(judged)} suspected, {len(every) - len(judged)} refused")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
