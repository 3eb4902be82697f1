"""What the command line prints of a result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import wrap

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from torchrbd.comparison import Comparison
from torchrbd.diagnosis import Diagnosis
from torchrbd.diagnosis.results import Finding, Where
from torchrbd.effects import Effect
from torchrbd.export.check import FileCheck
from torchrbd.inference import Identification
from torchrbd.inference.comparison import EstimatorComparison
from torchrbd.report.cards import PlainRow, plain_rows, plain_titles
from torchrbd.report.changes import shown, title
from torchrbd.report.text.comparison import certainty, signed
from torchrbd.report.text.console import (
    FAVOURED,
    LACKING,
    PHYSICAL,
    check_words,
    closed_loop_words,
    combinations_words,
    estimator_words,
    measure_words,
    more_words,
    wrote,
)
from torchrbd.report.text.names import guessed, more_values, place, values, when
from torchrbd.report.text.numbers import number, probability, unit
from torchrbd.report.text.numbers import percent as exact_percent
from torchrbd.report.text.verdict import badge, headline, model_words, worth
from torchrbd.simulation import ClosedLoop

# A probability from which on the table of plain friction says none.
SURE = 0.95
# What leaves room for the other columns on a narrow terminal: recordings that are named, letters in a line.
_MOST_RECORDINGS, _WIDEST = 2, 22
_MODEL_WORDS = {"baseline": "baseline", "rigid_body": "re-fitted", "extended": "extended"}


def print_diagnosis(result: Diagnosis) -> None:
    """Print verdict, findings and fits."""
    out = _headed(result)
    folded = plain_rows(result.findings, result.identification.series.joints)
    in_table = {id(f) for row in folded for f in row.findings}
    special = [f for f in result.findings if id(f) not in in_table]
    recordings = len(result.identification.recordings)
    _print_findings(special, recordings, "missing", out)
    if folded:
        _print_plain(folded, out)
    for statement in (
        *(d.statement for d in result.joint_deflections),
        *(rest.statement for rest in result.unexplained),
    ):
        out.print(statement, markup=False)
    _print_fits(result.identification, out, model_words(result), worth(result))


def _print_findings(findings: Sequence[Finding], recordings: int, heading: str, out: Console) -> None:
    """Print a table of findings, if there are any."""
    if not findings:
        return
    table = Table(_whole("where"), Column(heading, overflow="fold"), "value ± 95 %", _right("probability"))
    for f in findings:
        more = more_values(f)
        quantities = "\n".join([*values(f), *([more_words(more, "diagnosis.json")] if more else [])])
        inside = "\n".join((place(f), *_times(f.where, recordings)))
        table.add_row(Text(inside), Text(guessed(f)), Text(quantities), probability(f.probability))
    out.print(table)


def _times(where: Where, recordings: int) -> list[str]:
    """Return when and in which recordings something acts, in short lines; many of them are counted."""
    if where.recordings is not None and len(where.recordings) > _MOST_RECORDINGS:
        counted = f"in {len(where.recordings)} of {recordings} recordings"
        lines = ", ".join(filter(None, (counted, when(replace(where, recordings=None)))))
    else:
        lines = when(where)
    return wrap(lines, _WIDEST, break_on_hyphens=False)


def _print_plain(rows: Sequence[PlainRow], out: Console) -> None:
    """Print friction and offsets, a row per joint; what is less than certain with its probability."""
    table = Table(_whole("± 95 %"), *(_right(title.replace(" [", "\n[")) for title in plain_titles(rows)))
    for row in rows:
        cells = (
            words + (f" ({probability(f.probability)})" if f is not None and f.probability < SURE else "")
            for words, f in zip(row.values, row.findings, strict=True)
        )
        table.add_row(Text(row.joint), *cells)
    out.print(table)


def print_identification(result: Identification) -> None:
    """Print verdict and fits."""
    _print_fits(result, _headed(result))


def print_each(rows: Iterable[tuple[str, str, float, float, float]]) -> None:
    """Print rows of a recording's name, its verdict, mean nmse of the URDF and of the last model, NaN if there is none,
    and seconds."""
    table = Table(_whole("recording"), "verdict", *map(_right, ("nmse, URDF", "nmse, fitted", "time")))
    for name, verdict, before, after, seconds in rows:
        table.add_row(Text(name), verdict, number(before), number(after), f"{seconds:.1f} s")
    Console(highlight=False).print(table)


def _headed(result: Identification | Diagnosis) -> Console:
    """Print the verdict and its sentence as the report has them, and return where to print the rest."""
    out = Console(highlight=False)
    out.print(Text.assemble((f"{badge(result)[2:]}:", "bold"), " ", " ".join(filter(None, headline(result)))))
    return out


def _print_fits(result: Identification, out: Console, model: str = "URDF", remark: str = "") -> None:
    """Print what is to be doubted, how well each model predicts held-out torque, the noise, and notes.

    ``model`` is what the recordings are compared with, ``remark`` what to say of the errors.
    """
    _print_doubts(result.doubts, out)
    _print_measure(result.held_out, result.cutoff_hz, out)
    words = {"urdf": model, **_MODEL_WORDS}
    errors = Table(_whole("joint"), *(_right(words[name]) for name in result.fits))
    filtered = result.states == "filtered"
    titles = "position noise", f"torque from position noise{'' if filtered else ', if filtered'}", "residual torque"
    noise = Table(_whole("standard deviation"), *map(_right, titles))
    prismatic = dict(zip(result.robot.joint_names, result.robot.prismatic.tolist(), strict=True))
    for joint in result.fits["urdf"].nmse:
        errors.add_row(Text(joint), *(number(fit.nmse[joint]) for fit in result.fits.values()))
    errors.add_row("mean", *(number(fit.mean_nmse) for fit in result.fits.values()), style="bold")
    loop = _closed_loop(result.closed_loop, words, prismatic)
    for joint, of in result.noise.items():
        q, tau = ("m", "N") if prismatic[joint] else ("rad", "N m")
        values = ((of.position, q), (of.from_position, tau), (of.torque, tau))
        noise.add_row(Text(joint), *(f"{number(value)} {unit}" for value, unit in values))
    out.print(errors)
    if remark:
        out.print(remark, markup=False)
    out.print(noise)
    if loop is not None and result.closed_loop is not None:
        out.print(closed_loop_words(result.closed_loop), markup=False)
        out.print(loop)
    if not result.regime.biases:
        out.print(result.regime.statement, markup=False)
    _print_notes(result.notes, out)


def _closed_loop(loop: ClosedLoop | None, words: dict[str, str], prismatic: dict[str, bool]) -> Table | None:
    """Return how far models with drives move from the recorded positions; None without drives."""
    if loop is None:
        return None
    table = Table(_whole("joint"), *(_right(words[name]) for name in loop.errors), _right("tracking error"))
    for joint in next(iter(loop.errors.values())):
        values = [*(errors[joint] for errors in loop.errors.values()), loop.tracking.get(joint, math.nan)]
        symbol = "mm" if prismatic[joint] else "mrad"
        table.add_row(Text(joint), *("lost" if x == math.inf else f"{number(1e3 * x)} {symbol}" for x in values))
    return table


def _right(title: str) -> Column:
    return Column(Text(title), justify="right")


def _whole(title: str) -> Column:
    """Return a column of names, which are not cut."""
    return Column(Text(title), no_wrap=True)


def _print_measure(held_out: str, cutoff_hz: float, out: Console) -> None:
    out.print(measure_words(held_out, cutoff_hz), markup=False)


def _print_doubts(doubts: Iterable[object], out: Console) -> None:
    for doubt in doubts:
        out.print(Text.assemble(("warning:", "bold yellow"), " ", str(doubt)))


def _print_notes(notes: Iterable[object], out: Console) -> None:
    for note in notes:
        out.print(f"note: {note}", markup=False)


def print_changes(result: Comparison) -> None:
    """Print what changed between two diagnoses, a row per parameter, what is certain first."""
    out = Console(highlight=False)
    out.print(Text.assemble((f"{result.robot}:", "bold"), " ", result.statement))
    titles = "before", "after", "difference\n± 95 %", "unit", "changed?"
    table = Table("what", Column("parameter", overflow="fold"), *map(_right, titles))
    for change in result.changes:
        for row, (name, d) in enumerate(shown(change)):
            lines = next(q for q in (d.after, d.before) if q is not None)
            values = ("–" if q is None else number(q.value) for q in (d.before, d.after))
            difference = signed(d), unit(lines.unit), certainty(d.probability)
            table.add_row(Text(title(change) if row == 0 else ""), Text(name.replace("_", " ")), *values, *difference)
    if table.row_count:
        out.print(table)
    for change in result.changes:
        if change.verdict != "changed" and not shown(change):
            out.print(change.statement, markup=False)
    _print_notes(result.notes, out)


def print_comparison(result: EstimatorComparison) -> None:
    """Print estimators side by side, with a star where the error is about the least."""
    out = Console(highlight=False)
    _print_doubts(result.doubts, out)
    _print_measure(result.held_out, result.cutoff_hz, out)
    found = [(row, row.raw, row.physical) for row in result.rows if row.raw is not None and row.physical is not None]
    means = Table("mean over joints", _right("as found"), "physical?", _right("made physical"), _right("time"))
    joints = Table("made physical", *map(_right, result.joints))
    least = min(physical.mean_nmse for _, _, physical in found)
    least_of = {name: min(physical.nmse[name] for _, _, physical in found) for name in result.joints}
    for row, raw, physical in found:
        valid = "" if row.was_physical is None else "yes" if row.was_physical else "no"
        seconds = "" if row.was_physical is None else f"{row.seconds:.2f} s"
        means.add_row(row.name, number(raw.mean_nmse), valid, _starred(physical.mean_nmse, least), seconds)
        joints.add_row(row.name, *(_starred(physical.nmse[name], least_of[name]) for name in result.joints))
    out.print(means)
    if len(result.joints) > 1:
        out.print(joints)
    out.print(PHYSICAL)
    out.print(combinations_words(result.base_parameters, result.condition))
    out.print(result.regime.statement, markup=False)
    if result.noise_matters:
        out.print(FAVOURED)
    for row in result.rows:
        if row.note:
            out.print(estimator_words(row.name, row.note, failed=row.raw is None), markup=False)
    _print_notes(result.notes, out)


def print_export(file: Path, lacking: Sequence[str], found: FileCheck | None) -> None:
    """Print how far a file for a simulator and its model are apart, if that was looked at, and what the file lacks."""
    out = Console(highlight=False)
    if found is not None:
        out.print(check_words(found.samples, found.cutoff_hz), markup=False)
        table = Table(_whole("joint"), *map(_right, ("torque", "file less model", "in per cent")))
        for one in found.joints:
            torques = (f"{number(value)} {one.unit}" for value in (one.torque, one.difference))
            table.add_row(Text(one.joint), *torques, exact_percent(one.part))
        out.print(table)
        _print_notes(found.notes, out)
    if lacking:
        out.print(LACKING)
    for sentence in lacking:
        out.print(f"- {sentence}", markup=False)
    out.print(wrote(file), markup=False, soft_wrap=True)


def print_effects(known: Iterable[Effect]) -> None:
    """Print what can be missing: the name to give to --effects, what it is, and the torque that it adds."""
    table = Table(_whole("effect"), Column("what it is", overflow="fold"), Column("torque", overflow="fold"))
    for one in known:
        table.add_row(*map(Text, (one.id, one.words, one.equation)))
    Console(highlight=False).print(table)


def _starred(value: float, least: float) -> str:
    return f"[bold]{number(value)} *[/]" if value <= 1.01 * least else f"{number(value)}  "
