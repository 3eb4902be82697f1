"""Base parameters from streamed moments against building every row and calling a least-squares routine.

    OMP_NUM_THREADS=1 python benchmarks/moments.py [--samples 200000] [--rounds 3]

A seven-joint arm, random states, torques with noise; all sides take the same arrays in memory and end with the same
base parameters. Rivals build the rows of all samples, whiten them, and solve by numpy's ``lstsq`` (LAPACK gelsd), with
all columns, as people do who do not know which depend on each other, or with the independent ones alone, or by torch's
(gels, a QR decomposition), which needs these. Rows are those of ``RobotModel.regressor``, the fastest that there is
here, or of Pinocchio's regressor in a Python loop. The sides take turns in one run; processor seconds, medians over the
rounds, so that other programs on the cores matter little; extra memory is the peak of a process of its own above what
it had with the samples in memory (Linux only). Needs the test extra.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from statistics import median

import numpy as np
import torch
from memory import JOINTS, arm
from rich.console import Console
from rich.table import Table

import torchrbd

Side = Callable[[torchrbd.RobotModel, list[torch.Tensor]], torch.Tensor]

_LIMIT = '<limit lower="-100" upper="100" effort="1" velocity="1"/>'
NOISE_STD = torch.linspace(0.5, 0.1, JOINTS, dtype=torch.float64)


def case(samples: int) -> tuple[torchrbd.RobotModel, list[torch.Tensor]]:
    """Return the arm, and states and torques (N, n)."""
    robot, generator = torchrbd.RobotModel.from_urdf(arm().encode()), torch.Generator().manual_seed(0)
    x = [torch.randn(samples, JOINTS, generator=generator, dtype=torch.float64) for _ in range(4)]
    return robot, [*x[:3], robot.inverse_dynamics(*x[:3]) + NOISE_STD * x[3]]


def streamed(robot: torchrbd.RobotModel, given: list[torch.Tensor], square_root: bool) -> torch.Tensor:
    """Return the base parameters of one pass."""
    regression = torchrbd.BaseRegression(robot, square_root=square_root)
    regression.take(*given)
    return regression.solve(NOISE_STD).value


def ours(robot: torchrbd.RobotModel, given: list[torch.Tensor]) -> torch.Tensor:
    """Build all rows by our regressor, (N, n, n_params)."""
    return robot.regressor(*given[:3])


def pinocchio(robot: torchrbd.RobotModel, given: list[torch.Tensor]) -> torch.Tensor:
    """Build all rows in a Python loop over Pinocchio's regressor, whose columns are ours on a chain."""
    import pinocchio as pin

    # Continuous joints have two coordinates there.
    model = pin.buildModelFromXML(arm().replace("continuous", "revolute").replace("</joint>", f"{_LIMIT}</joint>"))
    data = model.createData()
    rows = zip(*(x.numpy() for x in given[:3]), strict=True)
    return torch.from_numpy(np.stack([pin.computeJointTorqueRegressor(model, data, *row).copy() for row in rows]))


def built(build: Callable[..., torch.Tensor], *, independent: bool, by_numpy: bool = True) -> Side:
    """Return a side that builds everything and solves."""

    def side(robot: torchrbd.RobotModel, given: list[torch.Tensor]) -> torch.Tensor:
        base = torchrbd.BaseRegression(robot).base
        Y = build(robot, given)
        A = ((Y[..., list(base.independent)] if independent else Y) / NOISE_STD.unsqueeze(1)).flatten(0, 1)
        del Y
        y = (given[3] / NOISE_STD).flatten()
        if by_numpy:
            solution = torch.from_numpy(np.linalg.lstsq(A.numpy(), y.numpy(), rcond=None)[0])
        else:
            solution = torch.linalg.lstsq(A, y.unsqueeze(1), driver="gels").solution[:, 0]
        return solution if independent else base.combination @ solution

    return side


SIDES: dict[str, Side] = {
    "moments": partial(streamed, square_root=False),
    "square root": partial(streamed, square_root=True),
    "all columns, numpy lstsq": built(ours, independent=False),
    "independent columns, numpy lstsq": built(ours, independent=True),
    "independent columns, torch gels": built(ours, independent=True, by_numpy=False),
    "Pinocchio loop, all columns, numpy lstsq": built(pinocchio, independent=False),
}


def resident(key: str) -> float:
    """Return memory of this process [GB]: VmRSS now, VmHWM at most."""
    with open("/proc/self/status") as status:
        return int(status.read().split(f"{key}:")[1].split()[0]) / 1e6


def alone(name: str, samples: int) -> float:
    """Return the extra memory [GB] of one side in a process of its own."""
    command = [sys.executable, __file__, "--samples", str(samples), "--alone", name]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--samples", type=int, default=200_000, metavar="N")
    options.add_argument("--rounds", type=int, default=3, metavar="N")
    options.add_argument("--alone", choices=SIDES, help=argparse.SUPPRESS)
    given = options.parse_args()
    torch.set_num_threads(1)
    robot, x = case(given.samples)
    if given.alone:
        SIDES[given.alone](robot, [one[:5000] for one in x])
        before = resident("VmRSS")
        SIDES[given.alone](robot, x)
        print(resident("VmHWM") - before)
        return
    seconds: dict[str, list[float]] = {name: [] for name in SIDES}
    found = {}
    for _ in range(given.rounds):
        for name, side in SIDES.items():
            start = time.process_time()
            found[name] = side(robot, x)
            seconds[name].append(time.process_time() - start)
    table = Table("side", "thousand samples/s", "time / moments'", "/ square root's", "extra GB", "apart")
    for name, times in seconds.items():
        ratios = (median(a / b for a, b in zip(times, seconds[other], strict=True)) for other in list(SIDES)[:2])
        apart = float((found[name] - found["moments"]).norm() / found["moments"].norm())
        numbers = (f"{r:.1f}" for r in ratios)
        table.add_row(
            name,
            f"{given.samples / median(times) / 1e3:.0f}",
            *numbers,
            f"{alone(name, given.samples):.3f}",
            f"{apart:.0e}",
        )
    Console().print(table)


if __name__ == "__main__":
    main()
