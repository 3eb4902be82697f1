"""What the command line prints of a result."""

from __future__ import annotations

from rich.console import Console
from rich.table import Column, Table

from torchrbd.diagnosis import Diagnosis
from torchrbd.diagnosis.words import interval, number, words_of
from torchrbd.inference import Identification
from torchrbd.inference.comparison import EstimatorComparison
from torchrbd.report.words import percent

_MODEL_WORDS = {"urdf": "URDF", "rigid_body": "re-fitted", "extended": "extended"}


def print_diagnosis(result: Diagnosis) -> None:
    """Print verdict, findings and fits."""
    out = Console(highlight=False)
    out.print(f"{result.verdict.replace('_', ' ')}:", style="bold", end=" ")
    out.print(result.statement, markup=False)
    if result.findings:
        table = Table("joint", "missing", "95 % interval", "probability")
        for f in result.findings:
            values = "\n".join(f"{name.replace('_', ' ')} {interval(q)}" for name, q in f.parameters.items())
            table.add_row(", ".join(f.joints), words_of(f.effect), values, percent(f.probability))
        out.print(table)
    for rest in result.unexplained:
        out.print(rest.statement, markup=False)
    print_fits(result.identification)


def print_fits(result: Identification) -> None:
    """Print how well each model predicts held-out torque."""
    out = Console(highlight=False)
    out.print(f"Unpredicted part of the torque variance on held-out data ({result.held_out}),", markup=False)
    out.print(f"torque and features band-limited at {result.cutoff_hz:.3g} Hz:")
    table = Table("joint")
    for name in result.fits:
        table.add_column(_MODEL_WORDS[name], justify="right")
    for title in ("position noise", "torque noise"):
        table.add_column(title, justify="right")
    prismatic = dict(zip(result.robot.joint_names, result.robot.prismatic.tolist(), strict=True))
    for joint in result.fits["urdf"].nmse:
        noise = result.noise.get(joint)
        units = ("m", "N") if prismatic[joint] else ("rad", "N m")
        words = (
            (f"{number(v)} {u}" for v, u in zip((noise.position, noise.torque), units, strict=True)) if noise else ()
        )
        table.add_row(joint, *(number(fit.nmse[joint]) for fit in result.fits.values()), *words)
    table.add_row("mean", *(number(fit.mean_nmse) for fit in result.fits.values()), style="bold")
    out.print(table)
    out.print(result.regime[0].upper() + result.regime[1:] + ".", markup=False)
    for note in result.notes:
        out.print(f"note: {note}", markup=False)


def print_comparison(result: EstimatorComparison) -> None:
    """Print estimators side by side."""
    out = Console(highlight=False)
    out.print(f"Unpredicted part of the torque variance on held-out data ({result.held_out}),", markup=False)
    out.print(f"torque and features band-limited at {result.cutoff_hz:.3g} Hz. The data tells {result.base_parameters}")
    out.print(f"combinations of parameters, condition number {result.condition:.3g}.")
    found = [(row, row.raw, row.physical) for row in result.rows if row.raw is not None and row.physical is not None]
    means = Table("estimator", "mean, as found", "physical?", "mean, made physical", "seconds")
    joints = Table("made physical", *(Column(name, justify="right") for name in result.joints))
    for row, raw, physical in found:
        valid = "" if row.was_physical is None else "yes" if row.was_physical else "no"
        means.add_row(row.name, number(raw.mean_nmse), valid, number(physical.mean_nmse), f"{row.seconds:.2f}")
        joints.add_row(row.name, *(number(physical.nmse[joint]) for joint in result.joints))
    out.print(means)
    out.print(joints)
    for row in result.rows:
        if row.note:
            out.print(f"{row.name}: {row.note}" if row.raw else f"{row.name} failed: {row.note}", markup=False)
    for note in result.notes:
        out.print(f"note: {note}", markup=False)
