"""A fleet of simulated arms from recordings to its page: seconds, and who is told to differ.

    OMP_NUM_THREADS=1 python benchmarks/fleet_page.py [--robots 100] [--seconds 10] [--engine local] [--keep DIR]

Six-joint arms with viscous and Coulomb friction that scatters by 10 % from arm to arm, all of the same URDF, whose
inertials are off by 15 %; 10 s at 100 Hz in a Parquet file each. In three of them something is planted: a link that is
10 % heavier, a Coulomb friction that is doubled, a viscous friction that is doubled. Needs the test extra.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import time
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

import import_paths  # noqa: F401
import numpy as np
import pyarrow as pa
from pyarrow import parquet
from rich.console import Console
from simulated import Motion, joint_names, record, with_wrong_inertials

from torchrbd.cli import main as torchrbd
from torchrbd.fleet.compare import compare_fleet
from torchrbd.inference.robots_file import read_robots
from torchrbd.report.fleet import write_fleet_report

VISCOUS, COULOMB, SCATTER = 0.3, 0.8, 0.1
LINK, JOINT = "forearm", 4


def heavier(urdf: str, link: str, part: float) -> str:
    """Return a URDF with a link whose mass and inertia are larger by a part."""

    def changed(found: re.Match[str]) -> str:
        numbers = r'((?:value|ixx|ixy|ixz|iyy|iyz|izz))="([^"]+)"'
        return re.sub(numbers, lambda m: f'{m[1]}="{float(m[2]) * (1.0 + part)!r}"', found[0])

    assert f'<link name="{link}">' in urdf
    return re.sub(rf'<link name="{link}">.*?</inertial>', changed, urdf, flags=re.S)


def write(urdf: str, seed: int, viscous: np.ndarray, coulomb: np.ndarray, path: Path, seconds: float) -> None:
    """Record one arm."""

    def friction(motion: Motion) -> np.ndarray:
        return viscous * motion.qd + coulomb * np.sign(motion.qd)

    recording = record(urdf, seed, extra=friction, duration_s=seconds, rate_hz=100.0)
    (chunk,) = recording.chunks(10**8)
    columns = {"t": chunk.t}
    for k, joint in enumerate(recording.joints):
        columns |= {f"q_{joint}": chunk.q[:, k], f"tau_{joint}": chunk.tau[:, k]}
    parquet.write_table(pa.table(columns), path)


def write_fleet(folder: Path, robots: int, seconds: float) -> dict[str, str]:
    """Write recordings, URDF and list of robots; return what was planted, by robot."""
    truth = (files("torchrbd") / "demo" / "arm.urdf").read_text()
    (folder / "arm.urdf").write_text(with_wrong_inertials(truth, 3))
    n, rng = len(joint_names(truth)), np.random.default_rng(0)
    planted = {f"arm{robots // 4:04d}": "mass", f"arm{robots // 2:04d}": "coulomb", f"arm{robots - 1:04d}": "viscous"}
    entries = []
    for k in range(robots):
        name = f"arm{k:04d}"
        viscous, coulomb = VISCOUS * np.ones(n), COULOMB * np.ones(n)
        viscous, coulomb = (x * (1.0 + SCATTER * rng.standard_normal(n)) for x in (viscous, coulomb))
        coulomb[JOINT] *= 2.0 if planted.get(name) == "coulomb" else 1.0
        viscous[JOINT] *= 2.0 if planted.get(name) == "viscous" else 1.0
        urdf = heavier(truth, LINK, 0.1) if planted.get(name) == "mass" else truth
        write(urdf, k, viscous, coulomb, folder / f"{name}.parquet", seconds)
        entries.append(f"  - {{name: {name}, urdf: arm.urdf, recordings: {name}.parquet}}\n")
    (folder / "robots.yaml").write_text("robots:\n" + "".join(entries))
    return planted


def listing_s(listed: Path) -> float:
    """Return the seconds that reading a list of robots takes."""
    start = time.perf_counter()
    read_robots(listed)
    return time.perf_counter() - start


def page_s(folder: Path, names: Sequence[str]) -> float:
    """Return the seconds that comparing robots which are identified and writing their page take."""
    start = time.perf_counter()
    write_fleet_report(compare_fleet(folder, names), folder / "again.html")
    return time.perf_counter() - start


def main() -> None:
    """Print seconds and what was told."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--robots", type=int, default=100, metavar="N")
    options.add_argument("--seconds", type=float, default=10.0, metavar="S", help="of a recording")
    options.add_argument("--engine", default="local", help="local or dask")
    options.add_argument("--keep", type=Path, metavar="DIR", help="where to leave everything")
    options.add_argument("--estimator", default="auto", help="of the parameters")
    given = options.parse_args()
    console = Console(soft_wrap=True)
    with TemporaryDirectory() as temporary:
        folder = given.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        planted = write_fleet(folder, given.robots, given.seconds)
        listed = folder / "robots.yaml"
        listed.write_text(f"options: {{estimator: {given.estimator}}}\n{listed.read_text()}")
        start, spent = time.perf_counter(), sum(os.times()[:4])
        code = torchrbd(["fleet", str(listed), "-o", str(folder / "out"), "--engine", given.engine])
        seconds, spent = time.perf_counter() - start, sum(os.times()[:4]) - spent
        found = json.loads((folder / "out" / "fleet.json").read_text())["members"]
        told = {one["name"]: [d["parameter"] for d in one["deviations"]] for one in found if one["deviations"]}
        console.print(
            f"exit code {code}; {given.robots} robots: {seconds:.0f} s, {seconds / given.robots:.2f} s a robot, "
            f"{spent / given.robots:.2f} processor seconds a robot; load {os.getloadavg()[0]:.1f}"
        )
        size = sum(file.stat().st_size for file in (folder / "out").rglob("*")) / given.robots
        console.print(
            f"{size / 1e6:.2f} MB a robot; by one process: reading the list {listing_s(listed):.2f} s, comparing and "
            f"writing the page {page_s(folder / 'out', [one['name'] for one in found]):.2f} s"
        )
        for name, what in planted.items():
            console.print(f"planted in {name}: {what}; told: {', '.join(told.pop(name, [])) or 'nothing'}")
        console.print(f"false alarms: {told or 'none'}")


if __name__ == "__main__":
    main()
