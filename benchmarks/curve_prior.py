"""What real recordings say of curves: the log evidence of values that are alike at close knots, over independent ones.

    TORCHRBD_DATA=/path/to/recordings python benchmarks/curve_prior.py emps ur10 panda kuka_kr300

Writes ``benchmarks/results/curve_prior.json``. All curves of the discrepancy are in the model, over each joint's own
position, velocity, acceleration, load and time. Their amplitudes, and the noise, are learnt under each prior.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import against_least_squares
import numpy as np
import results_file
import torch

from torchrbd.dataset.band import band_hz
from torchrbd.diagnosis.curve_hypotheses import curves_at, is_over_own_signal
from torchrbd.diagnosis.discrepancy import learn_amplitudes_and_noise
from torchrbd.diagnosis.hypotheses import rows_with_load
from torchrbd.effects.smooth_torque import SMOOTH
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.preparation import read
from torchrbd.likelihood.clocks import in_band
from torchrbd.likelihood.likelihood import Likelihood

# Sweeps over amplitudes and noise.
SWEEPS = 6


@contextmanager
def independent_values() -> Iterator[None]:
    """Make the values of all curves independent of each other."""
    before = [effect.root for effect in SMOOTH]
    for effect in SMOOTH:
        effect.root = torch.eye(effect.knots, dtype=torch.float64)
    try:
        yield
    finally:
        for effect, root in zip(SMOOTH, before, strict=True):
            effect.root = root


def machine(name: str, folder: Path) -> Likelihood:
    """Return the likelihood of the rigid body with baseline friction on the recordings of the first fold."""
    chosen = against_least_squares.SETS[name]
    files = [folder / recording for recording in chosen.recordings]
    files = files if chosen.parts else files[: -chosen.together]
    options = {"cutoff_hz": chosen.cutoff_hz} if chosen.cutoff_hz else {}
    robot, sources, settings = read_arguments(folder / chosen.urdf, files, options, "diagnose")
    reading, _ = read(robot, sources, settings)
    band = settings.cutoff_hz or band_hz(reading.surveys, reading.filtering.recorded)
    return in_band(reading, band, lambda _, t: torch.zeros(len(t), dtype=torch.bool), frozenset()).fit


def evidence(base: Likelihood) -> tuple[float, int]:
    """Return the log evidence with all curves in the model, and how many these are."""
    rows = rows_with_load(base)
    curves = [h for h in curves_at(base, rows, range(rows.n_dof)) if is_over_own_signal(h.candidate)]
    plain = base.with_(noise=tuple(replace(n, tail=None) for n in base.hyper.noise), dispersion=np.ones(rows.n_dof))
    fit = plain.extended([h.extra(base, rows) for h in curves]).renoised()
    return learn_amplitudes_and_noise(fit, SWEEPS).log_evidence, len(curves)


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare the priors on the sets named; exit code 2 where there are no recordings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="+", choices=against_least_squares.SETS)
    chosen = parser.parse_args(arguments).sets
    folder = os.environ.get("TORCHRBD_DATA")
    if folder is None or not Path(folder).is_dir():
        print("set TORCHRBD_DATA to the folder of recordings", file=sys.stderr)
        return 2
    for name in chosen:
        base = machine(name, Path(folder) / name)
        alike, count = evidence(base)
        with independent_values():
            independent, _ = evidence(base)
        gain = round(alike - independent, 1)
        found = {"robot": against_least_squares.SETS[name].robot, "curves": count, "log_evidence_gain": gain}
        results_file.update("curve_prior", f"python benchmarks/curve_prior.py {name}", {name: found})
        print(f"{name}: {gain:+.1f} nats")
    return 0


if __name__ == "__main__":
    sys.exit(main())
