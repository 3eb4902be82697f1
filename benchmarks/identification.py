"""Time an identification, intervals included: a seven-joint arm, 60 s at 500 Hz, from opened recording to result.

    OMP_NUM_THREADS=1 python benchmarks/identification.py

The other side of the ratio is the least one can do with Pinocchio: its regressor in a loop over the same samples, and
numpy's lstsq on the stack, without filter, prior, intervals or held-out data. Needs the test extra.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import import_paths  # noqa: F401
import numpy as np
import pinocchio as pin
import torch
from noisy_robots import final_robots, noisy_recording, perturbed
from rich.console import Console
from rich.table import Table

import torchrbd
from torchrbd.robot import RobotModel

ROBOT, SEED, REPEATS = "panda", 1000, 3


def seconds(work: Callable[[], object]) -> float:
    """Return the best of some runs; the first one, which imports and warms up, does not count."""
    times = []
    for _ in range(REPEATS + 1):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times[1:])


def main() -> None:
    """Print seconds and ratios."""
    torch.set_num_threads(1)
    urdf = final_robots()[ROBOT]
    given = RobotModel.from_urdf(perturbed(urdf, SEED))
    recording, truth = noisy_recording(urdf, SEED, duration_s=60.0, encoder_noise=1e-3)
    model = pin.buildModelFromXML(urdf)
    data = model.createData()

    def stacked() -> object:
        rows = zip(truth.q, truth.qd, truth.qdd, strict=True)
        Y = np.concatenate([pin.computeJointTorqueRegressor(model, data, *row) for row in rows])
        return np.linalg.lstsq(Y, truth.tau.ravel(), rcond=None)

    base = seconds(stacked)
    table = Table("work", "s", "ratio")
    table.add_row("Pinocchio regressors and lstsq", f"{base:.2f}", "1.0")
    for name in ("physical", "smoother"):
        spent = seconds(
            lambda name=name: torchrbd.identify(given, recording, cutoff_hz=10.0, estimator=name, effects=[])
        )
        table.add_row(f"identify, {name}", f"{spent:.2f}", f"{spent / base:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
