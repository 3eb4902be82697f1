"""What torchrbd finds on real robots, at length: tables of errors, findings and published values.

    TORCHRBD_DATA=/path/to/recordings python examples/real_robots.py kuka_kr300
    TORCHRBD_DATA=/path/to/recordings python examples/real_robots.py dfki_double_pendulum
    TORCHRBD_DATA=/path/to/recordings python examples/real_robots.py dfki_pendulum

``real_recordings.py`` says where the recordings come from.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import real_recordings as real

import torchrbd
from torchrbd import Diagnosis
from torchrbd.diagnosis.results import Finding, Quantity
from torchrbd.errors import RecordingError
from torchrbd.report.text.names import alternatives, named, place, value, when
from torchrbd.report.text.numbers import measure, number, percent, with_unit

FRICTION = ("viscous_friction", "coulomb_friction")
GRAVITY = 9.81
MODELS = ("urdf", "rigid_body", "extended")
# Bytes: one recording is eight times as long as the others and would outweigh them.
SHORT = 500_000


def print_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table in Markdown."""
    for row in (head, ["---"] * len(head), *rows):
        print(f"| {' | '.join(row)} |")
    print()


def print_errors(results: Mapping[str, Diagnosis]) -> None:
    """Print held-out nmse, a row per diagnosis and model."""
    joints = next(iter(results.values())).identification.series.joints
    rows = []
    for name, d in results.items():
        for model in MODELS:
            fit = d.identification.fits[model]
            values = (f"{fit.nmse.get(j, float('nan')):.3f}" for j in joints)
            rows.append([name, model.replace("_", " "), *values, f"{fit.mean_nmse:.4f}"])
    print_table(["nmse, held out", "model", *joints, "mean"], rows)


def told_first(finding: Finding) -> Quantity:
    """Return the first value of a finding; of a joint that sits elsewhere the shift that is surest, not along x."""
    first, *others = finding.parameters.values()
    if finding.effect != "geometry_error":
        return first
    shifts = [q for q in (first, *others) if q.unit == first.unit and np.isfinite(q.value)]
    return max(shifts, key=lambda q: abs(q.value) / q.std, default=first)


def print_findings(results: Mapping[str, Diagnosis]) -> None:
    """Print findings, a row per place and effect, a column per diagnosis: a value ± 95 %, probability, rivals."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for name, d in results.items():
        for f in d.findings:
            quantity = told_first(f)
            other = f", or {' or '.join(alternatives(f))}" if alternatives(f) else ""
            inside = f", {when(f.where)}" if f.where.recordings else ""
            cell = f"{value(quantity)} ({percent(f.probability)}{other}{inside})"
            cells.setdefault((place(f), named(f)), {})[name] = cell
    rows = [[*key, *(row.get(name, "–") for name in results)] for key, row in sorted(cells.items())]
    print_table(["where", "found", *results], rows)
    for name, d in results.items():
        left = "; ".join(u.statement.rstrip(".") for u in d.unexplained) or "nothing"
        print(f"- {name}: {d.verdict}. Left unexplained: {left}.")
    print()


def show_kuka(folder: Path) -> None:
    """Print what is found on the KR300, each recording left out in turn."""
    result = real.kuka(folder)
    joints = next(iter(result.diagnoses.values())).identification.series.joints
    pooled = {model: result.nmse(model) for model in MODELS}
    rows = [[m.replace("_", " "), *(f"{v:.3f}" for v in x), f"{x.mean():.4f}"] for m, x in pooled.items()]
    print_table(["nmse, each left out in turn", *joints, "mean"], rows)
    results = {f"{Path(name).stem} left out": d for name, d in result.diagnoses.items()}
    print_findings(results)
    springs = [
        [
            d.joint,
            name,
            with_unit(number(d.stiffness_at_least), "N m/rad") if d.stiffness is None else value(d.stiffness),
            f"{percent(d.nmse_before)} → {percent(d.nmse_after)}",
            measure(1000.0 * d.delay.value, 1960.0 * d.delay.std),
        ]
        for name, diagnosis in results.items()
        for d in diagnosis.joint_deflections
    ]
    head = ["joint", "", "stiffness, ± 95 % or at least", "deflection unpredicted, held out", "delay [ms]"]
    print_table(head, sorted(springs))
    for joint, (least, most) in real.slopes_on_torque(folder / "kuka_kr300").items():
        print(f"- {joint}: encoder difference regressed on torque alone: {least:.3g} to {most:.3g} N m/rad")


def show_double_pendulum(folder: Path) -> None:
    """Print what is found on the double pendulum: right and wrong URDF, with and without friction compensation."""
    pendulum, results = folder / "dfki_double_pendulum", {}
    for design in "AC":
        recordings = real.recordings_of(folder, design)
        for urdf in "AC":
            name = f"recordings {design}, URDF {urdf}"
            start = pendulum / f"robot_{urdf}.urdf"
            split = {"holdout": recordings[-2:], "cutoff_hz": real.PENDULUM_CUTOFF_HZ}
            results[name] = torchrbd.diagnose(start, recordings[:-2], **split)
    print_errors(results)
    print_findings(results)
    moments = {name: real.first_moments(d, real.LINK_LENGTH[name[-1]]) for name, d in results.items()}
    rows = [[name, *(f"{v:.3f}" for v in m.values())] for name, m in moments.items()]
    print_table(["first moments [kg m]", *real.PUBLISHED_FIRST_MOMENTS], rows)
    show_compensation(pendulum, real.recordings_of(folder, "A"))


def show_compensation(pendulum: Path, recordings: Sequence[Path]) -> None:
    """Print how well friction fitted without compensation predicts torque with it, and without."""
    (compensated,) = pendulum.glob("*compensated*.csv")
    *fitted, off = (p for p in recordings if p.stat().st_size < SHORT)
    options = {"cutoff_hz": real.PENDULUM_CUTOFF_HZ, "effects": [*FRICTION, "torque_offset", "rotor_inertia@elbow"]}
    rows = []
    for words, judged in (("off", off), ("on", compensated)):
        fit = torchrbd.identify(pendulum / "robot_A.urdf", fitted, holdout=[judged], **options)
        series = fit.series
        for k, joint in enumerate(series.joints):
            left = series.residual("extended")[series.held_out, k]
            direction = np.sign(series.qd[series.held_out, k])
            error = fit.fits["extended"].nmse[joint]
            rows.append([words, joint, f"{error:.3f}", f"{left.std():.3f}", f"{np.mean(left * direction):+.3f}"])
    head = ["compensation", "joint", "nmse", "torque left, std [N m]", "of it along the motion, mean [N m]"]
    print_table(head, rows)


def show_pendulum(folder: Path) -> None:
    """Print what is found on the pendulum, and what each recording says of its gravity and inertia."""
    pendulum = folder / "dfki_pendulum"
    recordings, rows = sorted(pendulum.glob("*.csv")), []
    for path in recordings:
        try:
            fit = torchrbd.identify(pendulum / "robot.urdf", path, effects=[*FRICTION, "torque_offset"], cutoff_hz=5.7)
        except RecordingError:
            rows.append([path.name, "too short alone", *["–"] * 4])
            continue
        told = {p.name: p for p in fit.parameters}
        gravity, inertia = told["mcz_pendulum"], told["Iyy_pendulum"]
        swing = fit.series.measured.std()
        rows.append(
            [
                path.name,
                f"{swing:.2f}",
                measure(-GRAVITY * gravity.value, 1.96 * GRAVITY * gravity.std),
                measure(inertia.value, 1.96 * inertia.std),
                f"{fit.fits['urdf'].mean_nmse:.2f}",
                f"{list(fit.fits.values())[-1].mean_nmse:.2f}",
            ]
        )
    head = ["alone", "torque, std [N m]", "gravity moment [N m]", "inertia [kg m²]", "nmse, URDF", "nmse, fitted"]
    print_table(head, rows)
    results = {"all": torchrbd.diagnose(pendulum / "robot.urdf", recordings)}
    print_errors(results)
    print_findings(results)


def show_in_turn(folder: Path) -> None:
    """Print rows on the double pendulum: nine recordings left out in turn, twice."""
    for design, words in (("A", "right lengths, wrong inertials"), ("C", "wrong lengths")):
        result = real.double_pendulum(folder, design)
        print_table([f"URDF with {words}", "mean nmse"], [[m, f"{result.nmse(m).mean():.4f}"] for m in MODELS])
        print_findings(result.diagnoses)
        moments = [real.first_moments(d, real.LINK_LENGTH[design]) for d in result.diagnoses.values()]
        for name, published in real.PUBLISHED_FIRST_MOMENTS.items():
            values = [m[name] for m in moments]
            print(f"first moment, {name}: {min(values):.3f} to {max(values):.3f} kg m, published {published:.3f}\n")


SETS: dict[str, Callable[[Path], None]] = {
    "kuka_kr300": show_kuka,
    "dfki_double_pendulum": show_double_pendulum,
    "dfki_pendulum": show_pendulum,
    "dfki_double_pendulum_in_turn": show_in_turn,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what is found on the sets named; exit code 2 where there are no recordings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="+", choices=SETS)
    chosen, folder = parser.parse_args(arguments).sets, real.data_folder()
    if folder is None:
        print("Set TORCHRBD_DATA to the folder of the recordings; see real_recordings.py for their sources.")
        return 2
    for name in chosen:
        SETS[name](folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
