"""Speed of the rigid body on a GPU: as torch's operations come, and as ``torch.compile`` makes kernels of them.

    python benchmarks/gpu.py [--samples 1000000] [--joints 7] [--eager]

Prints millions of samples a second in float64 and float32, the largest difference from float64 on the CPU (of the
largest number), and memory beyond inputs; last how many times as fast as the compiled kernels of one CPU core. Times
are those of the device, medians of some calls after two to warm up. Needs a CUDA device.
"""

from __future__ import annotations

import argparse
import copy
import statistics
import time
import warnings
from collections.abc import Callable

import torch
from memory import arm
from torch import Tensor

from torchrbd.model import RigidBodyDynamics
from torchrbd.robot import RobotModel

CALLS, CHECKED, ON_CPU = 9, 1000, 65536
"""Timed calls; samples that are compared; samples of the CPU's turn."""

Work = Callable[..., Tensor]


def forward_and_backward(model: RigidBodyDynamics, *states: Tensor) -> Tensor:
    """Return the torques after a pass back to states and log-Cholesky coordinates."""
    states = tuple(x.detach().requires_grad_() for x in states)
    tau = model(*states)
    tau.backward(torch.ones_like(tau))
    model.zero_grad(set_to_none=True)
    return tau.detach()


def without_derivatives(work: Work) -> Work:
    def call(model: RigidBodyDynamics, *states: Tensor) -> Tensor:
        with torch.no_grad():
            return work(model, *states)

    return call


WORKS: dict[str, Work] = {
    "regressor": without_derivatives(lambda model, *x: model.robot.regressor(*x)),
    "inverse dynamics": without_derivatives(lambda model, *x: model.robot.inverse_dynamics(*x)),
    "the same, `RigidBodyDynamics`": without_derivatives(lambda model, *x: model(*x)),
    "mass matrix": without_derivatives(lambda model, *x: model.robot.mass_matrix(x[0])),
    "forward dynamics": without_derivatives(lambda model, *x: model.robot.forward_dynamics(*x)),
    "forward + backward, states and log-Cholesky": forward_and_backward,
}


def seconds(call: Callable[[], object]) -> float:
    """Return the time of the device for one call."""
    taken = []
    for k in range(CALLS + 2):
        start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        start.record()
        call()
        end.record()
        torch.cuda.synchronize()
        if k > 1:
            taken.append(1e-3 * start.elapsed_time(end))
    return statistics.median(taken)


def measured(work: Work, model: RigidBodyDynamics, states: list[Tensor], expected: Tensor) -> tuple[float, str]:
    """Return millions of samples a second, and a cell of the table."""
    small = work(model, *(x[: len(expected)] for x in states)).cpu().double()
    difference = float((small - expected).abs().max() / expected.abs().max())
    torch.cuda.reset_peak_memory_stats()
    before = torch.cuda.memory_allocated()
    speed = 1e-6 * len(states[0]) / seconds(lambda: work(model, *states))
    memory = 1e-9 * (torch.cuda.max_memory_allocated() - before)
    return speed, f"{speed:.3g} ({difference:.0e}, {memory:.2g} GB)"


def on_cpu(work: Work, model: RigidBodyDynamics, states: list[Tensor]) -> float:
    """Return millions of samples a second of one core."""
    part = [x[:ON_CPU] for x in states]
    taken = []
    for _ in range(5):
        start = time.perf_counter()
        work(model, *part)
        taken.append(time.perf_counter() - start)
    return 1e-6 * ON_CPU / min(taken)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--joints", type=int, default=7)
    parser.add_argument(
        "--eager", action="store_true", help="without torch.compile, which takes half a minute each time"
    )
    options = parser.parse_args()
    if not torch.cuda.is_available():
        parser.error("torch finds no CUDA device")
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    exact = RigidBodyDynamics(RobotModel.from_urdf(arm(options.joints)))
    generator = torch.Generator().manual_seed(0)
    states = [2 * torch.rand(options.samples, options.joints, generator=generator).double() - 1 for _ in range(3)]
    print(
        f"{torch.cuda.get_device_name()}, torch {torch.__version__}, {options.joints} joints, {options.samples} samples"
    )
    dtypes = {"float64": torch.float64, "float32": torch.float32}
    hows = ("",) if options.eager else ("", ", compiled")
    ways = [(f"{name}{how}", dtype, how) for how in hows for name, dtype in dtypes.items()]
    print("| | " + " | ".join(name for name, *_ in ways) + " | float64 over one core |\n|" + " --- |" * (len(ways) + 2))
    for name, work in WORKS.items():
        expected, cells, speeds = work(exact, *(x[:CHECKED] for x in states)), [], []
        for _, dtype, how in ways:
            torch.compiler.reset()
            model = copy.deepcopy(exact).to("cuda", dtype)
            there = [x.to("cuda", dtype) for x in states]
            start = time.perf_counter()
            speed, cell = measured(torch.compile(work) if how else work, model, there, expected)
            speeds.append(speed)
            cells.append(cell + (f" {time.perf_counter() - start:.0f} s" if how else ""))
            del there
        one_core = on_cpu(work, exact, states)
        times = [f"{speed / one_core:.3g}" for speed in speeds[:: len(dtypes)]]
        print(f"| {name} | " + " | ".join((*cells, ", compiled ".join(times))) + " |", flush=True)


if __name__ == "__main__":
    main()
