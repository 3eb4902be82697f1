"""Coverage of the 95 % intervals of base parameters, against encoder noise; torque noise is coloured.

    OMP_NUM_THREADS=1 python benchmarks/intervals.py --robots final --recordings 100

Every recording has its own motion, noise and wrong URDF; robots, and open and closed loop, take turns. Robots and
torques are Pinocchio's. Needs the test extra.
"""

from __future__ import annotations

import argparse
from typing import Any

import import_paths  # noqa: F401
import numpy as np
from noisy_robots import development_robots, final_robots, noisy_recording, perturbed
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.stats import norm

import torchrbd
from torchrbd.parameters import base_parameters
from torchrbd.recordings import Recording

# Development and final recordings share no seed.
FIRST_SEED = {"development": 0, "final": 1000}
QUANTILE = float(norm.ppf(0.975))


def standardised_errors(urdf: str, pi: np.ndarray, recording: Recording, **options: Any) -> np.ndarray:
    """Return (n_base,) errors of base parameters in their claimed standard deviations.

    Args:
        urdf: as given to the estimator.
        pi: (10 n,) true parameters.
        recording: the data.
        **options: of identify.
    """
    found = torchrbd.identify(urdf, recording, effects=[], **options)
    true = base_parameters(found.robot).combination.numpy() @ pi
    return np.array([(b.value - t) / b.std for b, t in zip(found.base, true, strict=True)])


def main() -> None:
    """Print, per encoder noise, the share of parameters whose interval holds the truth, over all recordings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", choices=FIRST_SEED, default="development")
    parser.add_argument("--recordings", type=int, default=20)
    parser.add_argument("--loops", nargs="+", choices=("open", "closed"), default=["open", "closed"])
    parser.add_argument("--encoder-noise", nargs="+", type=float, default=[1e-4, 1e-3, 3e-3], help="[rad]")
    parser.add_argument("--cutoff-hz", type=float, default=None, help="chosen from the data if not given")
    parser.add_argument("--estimator", default="auto", help="of identify")
    parser.add_argument("--torque-colour-s", type=float, default=0.05)
    parser.add_argument("--fastest-hz", type=float, default=1.5, help="of the motion")
    parser.add_argument("--duration-s", type=float, default=20.0)
    chosen = parser.parse_args()
    robots = list((development_robots() if chosen.robots == "development" else final_robots()).values())

    table = Table(title=f"95 % intervals of base parameters, {chosen.recordings} recordings")
    for heading in ("noise rad", "coverage %", "+- (between recordings)", "least covered %", "rms z", "largest |z|"):
        table.add_column(heading, justify="right")
    for noise in chosen.encoder_noise:
        z = []
        for k in track(range(chosen.recordings), f"{noise:g} rad", console=Console(stderr=True), transient=True):
            urdf, seed = robots[k % len(robots)], FIRST_SEED[chosen.robots] + k
            recording, truth = noisy_recording(
                urdf,
                seed,
                loop=chosen.loops[(k // len(robots)) % len(chosen.loops)],
                encoder_noise=noise,
                torque_colour_s=chosen.torque_colour_s,
                fastest_hz=chosen.fastest_hz,
                duration_s=chosen.duration_s,
            )
            z.append(
                standardised_errors(
                    perturbed(urdf, seed), truth.pi, recording, estimator=chosen.estimator, cutoff_hz=chosen.cutoff_hz
                )
            )
        covered = 100 * np.array([np.mean(np.abs(one) < QUANTILE) for one in z])
        pooled = np.concatenate(z)
        spread = covered.std(ddof=1) / np.sqrt(len(covered)) if len(covered) > 1 else np.nan
        table.add_row(
            f"{noise:g}",
            f"{100 * np.mean(np.abs(pooled) < QUANTILE):.1f}",
            f"{spread:.1f}",
            f"{covered.min():.0f}",
            f"{np.sqrt(np.mean(pooled**2)):.2f}",
            f"{np.abs(pooled).max():.1f}",
        )
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
