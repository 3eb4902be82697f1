"""Error of identified parameters against encoder noise and cut-off: torque nMSE on noiseless states of another motion.

    OMP_NUM_THREADS=1 python benchmarks/input_noise.py --robots final --seeds 2

Columns: the URDF as given, the estimator "auto" on exact positions (what torque noise alone costs), and the estimators
asked for on noisy ones, unphysical answers as they come. Robots and torques are Pinocchio's. Needs the test extra.
"""

from __future__ import annotations

import argparse
from itertools import product

import import_paths  # noqa: F401
import numpy as np
from noisy_robots import development_robots, final_robots, noisy_recording, perturbed, torque_nmse, true_parameters
from rich.console import Console
from rich.progress import track
from rich.table import Table

import torchrbd
from torchrbd.errors import OptionError
from torchrbd.inference.estimators.estimate import estimate, estimators
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

# Development and final recordings share no seed.
FIRST_SEED = {"development": 0, "final": 1000}


def parameters(
    name: str, recording: Recording, urdf: str, cutoff_hz: float, told_noise: float | None = None
) -> np.ndarray:
    """Return the parameters (10 n,) that an estimator finds, before any projection; NaN where it cannot be used."""
    if name not in estimators():
        options = {"cutoff_hz": cutoff_hz, "estimator": name, "encoder_noise": told_noise}
        return torchrbd.identify(urdf, recording, effects=[], **options).model.pi.detach().numpy()
    robot = RobotModel.from_urdf(urdf)
    prepared = prepare(robot, [recording], Settings(cutoff_hz=cutoff_hz, estimator=name), ())
    try:
        return estimate(prepared, name).raw[: robot.n_params].numpy()
    except OptionError:
        return np.full(robot.n_params, np.nan)


def row(
    urdf: str, seeds: range, cutoff_hz: float, estimators: list[str], misstated: list[float], **options
) -> list[float]:
    """Return geometric means over seeds: of the URDF, of exact positions, of every estimator, of misstated noise."""
    errors = []
    for seed in seeds:
        given = perturbed(urdf, seed)
        exact, _ = noisy_recording(urdf, seed, **{**options, "encoder_noise": 0.0})
        noisy, _ = noisy_recording(urdf, seed, **options)
        found = [true_parameters(given), parameters("auto", exact, given, cutoff_hz)]
        found += [parameters(name, noisy, given, cutoff_hz) for name in estimators]
        noise = options["encoder_noise"]
        found += [parameters("smoother", noisy, given, cutoff_hz, factor * noise) for factor in misstated]
        errors.append([torque_nmse(urdf, pi, seed, fastest_hz=options["fastest_hz"]) for pi in found])
    return list(np.exp(np.log(errors).mean(0)))


def main() -> None:
    """Print one row per robot, loop, cut-off and encoder noise, and the geometric mean of each noise and cut-off."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", choices=FIRST_SEED, default="development")
    parser.add_argument("--seeds", type=int, default=1, help="recordings per row")
    parser.add_argument("--estimators", nargs="+", default=["auto"], help="of identify")
    parser.add_argument("--misstated", nargs="+", type=float, default=[], help="smoother told so many times the noise")
    parser.add_argument("--loops", nargs="+", choices=("open", "closed"), default=["open", "closed"])
    parser.add_argument("--cutoff-hz", nargs="+", type=float, default=[5.0, 10.0, 30.0])
    parser.add_argument("--encoder-noise", nargs="+", type=float, default=[1e-4, 3e-4, 1e-3, 3e-3], help="[rad]")
    parser.add_argument("--fastest-hz", type=float, default=1.5, help="of the motion")
    parser.add_argument("--torque-colour-s", type=float, default=0.0)
    chosen = parser.parse_args()
    robots = development_robots() if chosen.robots == "development" else final_robots()
    seeds = range(FIRST_SEED[chosen.robots], FIRST_SEED[chosen.robots] + chosen.seeds)

    told = [f"told x {factor:g}" for factor in chosen.misstated]
    table = Table(title=f"torque nMSE, {chosen.seeds} recordings a row, motion up to {chosen.fastest_hz:g} Hz")
    for heading in ("robot", "loop", "cut-off Hz", "noise rad", "URDF", "exact q", *chosen.estimators, *told):
        table.add_column(heading, justify="right")
    cases: list[tuple[float, float]] = list(product(chosen.cutoff_hz, chosen.encoder_noise))
    pooled: dict[tuple[float, float], list[list[float]]] = {case: [] for case in cases}
    runs: list[tuple[str, str, tuple[float, float]]] = list(product(list(robots), list(chosen.loops), cases))
    for name, loop, (cutoff, noise) in track(runs, console=Console(stderr=True), transient=True):
        errors = row(
            robots[name],
            seeds,
            cutoff,
            chosen.estimators,
            chosen.misstated,
            loop=loop,
            encoder_noise=noise,
            torque_colour_s=chosen.torque_colour_s,
            fastest_hz=chosen.fastest_hz,
        )
        pooled[cutoff, noise].append(errors)
        table.add_row(name, loop, f"{cutoff:g}", f"{noise:g}", *(f"{e:.2g}" for e in errors))
    table.add_section()
    for (cutoff, noise), errors in pooled.items():
        means = np.exp(np.log(errors).mean(0))
        table.add_row("all", "all", f"{cutoff:g}", f"{noise:g}", *(f"{e:.2g}" for e in means))
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
