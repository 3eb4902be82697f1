"""Speed of the regressor and of inverse dynamics, as a ratio to Pinocchio called sample by sample from Python.

    OMP_NUM_THREADS=1 python benchmarks/regressor.py

Both sides in one run, medians of five; float64. Needs the test extra.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import torch
from memory import arm

from torchrbd import RobotModel

SAMPLES, ROUNDS = 20_000, 5


def median_us(call: Callable[[], object]) -> float:
    """Return the median time of a call, in microseconds a sample."""
    seconds = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return 1e6 * statistics.median(seconds) / SAMPLES


def main() -> None:
    """Print microseconds a sample and ratios for a seven-joint arm."""
    robot, model = RobotModel.from_urdf(arm()), pin.buildModelFromXML(arm())
    data = model.createData()
    states = np.random.default_rng(0).normal(size=(3, SAMPLES, robot.n_dof))
    q, qd, qdd = map(torch.from_numpy, states)
    # A continuous joint is a point on the circle for Pinocchio.
    on_circle = np.stack((np.cos(states[0]), np.sin(states[0])), -1).reshape(SAMPLES, -1)
    out = np.empty((SAMPLES, model.nv, 10 * (model.njoints - 1)))

    def pinocchio_regressor() -> None:
        for k in range(SAMPLES):
            out[k] = pin.computeJointTorqueRegressor(model, data, on_circle[k], states[1, k], states[2, k])

    def pinocchio_inverse_dynamics() -> None:
        for k in range(SAMPLES):
            pin.rnea(model, data, on_circle[k], states[1, k], states[2, k])

    for name, ours, theirs in (
        ("regressor", lambda: robot.regressor(q, qd, qdd), pinocchio_regressor),
        ("inverse dynamics", lambda: robot.inverse_dynamics(q, qd, qdd), pinocchio_inverse_dynamics),
    ):
        a, b = median_us(ours), median_us(theirs)
        print(f"{name}: torchrbd {a:.2f} us, Pinocchio in a Python loop {b:.2f} us a sample, ratio {a / b:.2f}")


if __name__ == "__main__":
    main()
