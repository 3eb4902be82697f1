"""Peak memory and speed on long recordings of a seven-joint arm at 500 Hz, streamed from Parquet.

    OMP_NUM_THREADS=1 python benchmarks/memory.py [ROWS] [--work identify stats moments]

``identify`` is the default; ``stats`` writes a statistics file (reading, filtering and moments, in two passes), and
``moments`` is ``identify`` from that file. Each runs in a process of its own. Prints seconds, processor seconds, rows a
processor second, and peak resident memory above that after ``from torchrbd import identify``. Linux only (reads /proc).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

JOINTS, RATE_HZ = 7, 500.0
WORKS = ("identify", "stats", "moments")


def arm(joints: int = JOINTS) -> str:
    """Return a URDF of so many links of 0.3 m with alternating axes."""
    axes = ("0 0 1", "0 1 0")
    links = "".join(
        f'<link name="link{k}"><inertial><origin xyz="0 0.02 0.15"/><mass value="{4.0 - 0.4 * k}"/>'
        f'<inertia ixx="0.03" iyy="0.03" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="joint{k}" type="continuous"><parent link="{f"link{k - 1}" if k else "base"}"/>'
        f'<child link="link{k}"/><origin xyz="0 0 0.3"/><axis xyz="{axes[k % 2]}"/></joint>'
        for k in range(joints)
    )
    return f'<robot name="arm"><link name="base"/>{links}</robot>'


def smooth_motion(rng: np.random.Generator, joints: int) -> Callable[[np.ndarray], tuple[np.ndarray, ...]]:
    """Return a random motion of five sines a joint: of times (N,), q, qd and qdd (N, joints)."""
    omega, phase = 2 * np.pi * rng.uniform(0.1, 1.0, (joints, 5)), rng.uniform(0, 2 * np.pi, (joints, 5))

    def at(t: np.ndarray) -> tuple[np.ndarray, ...]:
        angle = omega * t[:, None, None] + phase
        ways = 0.5 / omega * np.sin(angle), 0.5 * np.cos(angle), -0.5 * omega * np.sin(angle)
        return tuple(way.sum(-1) for way in ways)

    return at


def write(path: Path, urdf: str, rows: int) -> None:
    """Write a recording of smooth random motion in pieces."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    import torch

    from torchrbd import RobotModel

    robot, rng = RobotModel.from_urdf(urdf), np.random.default_rng(0)
    motion = smooth_motion(rng, JOINTS)
    writer = None
    for start in range(0, rows, 50_000):
        t = np.arange(start, min(start + 50_000, rows)) / RATE_HZ
        q, qd, qdd = motion(t)
        tau = robot.inverse_dynamics(*map(torch.from_numpy, (q, qd, qdd))).numpy()
        tau = tau + 0.02 * tau.std(0) * rng.standard_normal(tau.shape)
        columns = {"t": t}
        columns |= {f"q_joint{k}": q[:, k] + 1e-5 * rng.standard_normal(len(t)) for k in range(JOINTS)}
        columns |= {f"tau_joint{k}": tau[:, k] for k in range(JOINTS)}
        table = pa.table(columns)
        writer = writer or pq.ParquetWriter(path, table.schema)
        writer.write_table(table)
    assert writer is not None
    writer.close()


MEASURED = """
import resource, sys, time
from torchrbd import identify, write_statistics
def resident():
    return int(open("/proc/self/status").read().split("VmRSS:")[1].split()[0]) / 1e6
work, urdf, recording, folder = sys.argv[1:]
before, start, spent = resident(), time.perf_counter(), time.process_time()
if work == "stats":
    write_statistics(urdf, recording, folder, cutoff_hz=5.0)
else:
    result = identify(urdf, recording if work == "identify" else f"{folder}/recording.parquet.stats")
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
print(time.perf_counter() - start, time.process_time() - spent, peak - before, before)
"""


def measure(rows: int, works: Sequence[str]) -> Iterator[str]:
    """Do each work in a process of its own and say what it took."""
    with tempfile.TemporaryDirectory() as folder:
        urdf, recording = Path(folder) / "arm.urdf", Path(folder) / "recording.parquet"
        urdf.write_text(arm())
        write(recording, arm(), rows)
        for work in works:
            command = [sys.executable, "-c", MEASURED, work, str(urdf), str(recording), folder]
            told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            seconds, spent, above, before = map(float, told.split())
            yield (
                f"{work}, {rows} rows: {seconds:.1f} s, {spent:.1f} s of a processor, {rows / spent / 1e3:.1f} "
                f"thousand rows/s, {above:.3f} GB above the {before:.3f} GB after import"
            )


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("rows", type=int, nargs="?", default=1_000_000)
    options.add_argument("--work", nargs="+", choices=WORKS, default=WORKS)
    given = options.parse_args()
    for line in measure(given.rows, given.work):
        print(line, flush=True)
