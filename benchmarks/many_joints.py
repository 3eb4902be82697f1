"""How `torchrbd identify` grows with the joints of a robot.

    OMP_NUM_THREADS=1 python benchmarks/many_joints.py [--joints 7 15 30 60] [--seconds 60] [--rate 250]

A tree of so many joints (two of them slides), smooth random motion, noise of 2 % on its torques, friction at every
joint; streamed from Parquet by the command itself, results written to a folder. Each case runs in a process of its own.
Prints processor seconds and the exponent by which they grow.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from kernels import humanoid
from memory import smooth_motion


def write(path: Path, urdf: str, seconds: float, rate_hz: float) -> None:
    """Write a recording of smooth random motion to a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    import torch

    from torchrbd import RobotModel

    robot, rng = RobotModel.from_urdf(urdf), np.random.default_rng(0)
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    q, qd, qdd = smooth_motion(rng, robot.n_dof)(t)
    tau = robot.inverse_dynamics(*map(torch.from_numpy, (q, qd, qdd))).numpy()
    tau = tau + 0.02 * tau.std(0) * (qd + 2 * np.tanh(qd / 0.01) + rng.standard_normal(tau.shape))
    columns = {"t": t}
    columns |= {f"q_{name}": q[:, k] + 1e-5 * rng.standard_normal(len(t)) for k, name in enumerate(robot.joint_names)}
    columns |= {f"tau_{name}": tau[:, k] for k, name in enumerate(robot.joint_names)}
    pq.write_table(pa.table(columns), path)


def spent(joints: int, seconds: float, rate_hz: float) -> float:
    """Return the processor seconds that the command takes, from its start to the end of its results."""
    with tempfile.TemporaryDirectory() as folder:
        urdf, recording = Path(folder) / "robot.urdf", Path(folder) / "recording.parquet"
        urdf.write_text(humanoid(joints))
        write(recording, urdf.read_text(), seconds, rate_hz)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "torchrbd", "identify", str(urdf), str(recording), "-o", f"{folder}/out"]
        subprocess.run(command, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print a line for each number of joints, then the exponent."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--joints", type=int, nargs="+", default=[7, 15, 30, 60])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=250.0)
    options = parser.parse_args()
    taken = []
    for joints in options.joints:
        taken.append(spent(joints, options.seconds, options.rate))
        print(f"{joints} joints: {taken[-1]:.1f} s of a processor", flush=True)
    if len(taken) > 1:
        exponent = np.polyfit(np.log(options.joints), np.log(taken), 1)[0]
        print(f"seconds grow as joints to the power of {exponent:.2f}")


if __name__ == "__main__":
    main()
