"""Compare two diagnoses of one robot: before and after service, or two robots of a series."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from torchrbd.comparison.findings import changed_findings
from torchrbd.comparison.inertia import inertial_differences, load_like
from torchrbd.comparison.reading import Side, side_of
from torchrbd.comparison.results import CERTAIN, LEAST_CHANGED, Change, Comparison, Found, most, verdict_of
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.display import Remark
from torchrbd.errors import InputError

_ORDER = {"changed": 0, "open": 1, "unchanged": 2}


def compare(before: Diagnosis | str | Path, after: Diagnosis | str | Path) -> Comparison:
    """Say what changed between two diagnoses of the same robot, and how certain that is.

    Findings of both are compared parameter by parameter. A finding of one only is new, or gone, if the
    ``detection_limits`` of the other say that it would have been seen. Inertial parameters are compared in
    combinations that both data sets identify. For a file, parameters.json must be in the same folder.

    Args:
        before, after: diagnoses, their folders, or their diagnosis.json.

    Returns:
        What changed, the most certain first; see ``changes/results.py`` for the probability.

    Raises:
        InputError: a file that cannot be used, or diagnoses of different robots.
    """
    one, other = side_of(before, "before"), side_of(after, "after")
    _check(one, other)
    findings = [*changed_findings(one, other)]
    changes = [*findings, *_inertia(one, other), *_unexplained(one, other)]
    changes.sort(key=lambda c: (_ORDER[c.verdict], -c.probability if c.probability == c.probability else 0.0))
    return Comparison(one.robot, one.joints, one.name, other.name, tuple(changes), tuple(_notes(one, other)))


def _check(before: Side, after: Side) -> None:
    remedy = "compare diagnoses of one robot, made with URDFs of the same name and joints"
    if before.robot != after.robot:
        raise InputError(f"{before.name} is of robot '{before.robot}', {after.name} of robot '{after.robot}'; {remedy}")
    if set(before.joints) != set(after.joints):
        different = sorted(set(before.joints) ^ set(after.joints))
        raise InputError(
            f"{before.name} and {after.name} are of different joints, only one has {', '.join(different)}; {remedy}"
        )


def _inertia(before: Side, after: Side) -> Iterator[Change]:
    parameters = inertial_differences(before.inertia, after.inertia)
    if parameters:
        probability = most(parameters.values())
        verdict = verdict_of(probability)
        load = load_like(before.inertia, after.inertia, before.bodies) if verdict == "changed" else None
        if load is None and sum(d.probability >= CERTAIN for d in parameters.values()) < LEAST_CHANGED:
            verdict = "unchanged" if verdict == "unchanged" else "open"
        links = load.links if load else ()
        yield Change("inertia", "", (), links, (), "both", verdict, probability, parameters, load=load)


def _unexplained(before: Side, after: Side) -> Iterator[Change]:
    sides = {"before": before.unexplained, "after": after.unexplained}
    keys = {found: [(u.joints, u.depends_on[:1]) for u in those] for found, those in sides.items()}
    for found, those in sides.items():
        for one, key in zip(those, keys[found], strict=True):
            shared = key in keys["before"] and key in keys["after"]
            if shared and found == "after":
                continue
            where: Found = "both" if shared else found  # type: ignore[assignment]
            yield Change("unexplained", "", one.joints, (), one.depends_on, where, "open", math.nan, {})


def _notes(before: Side, after: Side) -> Iterator[Remark]:
    shared = sorted(set(before.recordings) & set(after.recordings))
    if shared:
        yield Remark("same recordings", {"recordings": shared})
    if before.cutoff_hz != after.cutoff_hz:
        yield Remark("other cutoff", {"before_hz": before.cutoff_hz, "after_hz": after.cutoff_hz})
    if bool(before.simulated) != bool(after.simulated):
        yield Remark("one simulated")
    if inertial_differences(before.inertia, after.inertia) is None:
        yield Remark("inertia not compared")
    if not all(side.detection_limits for side in (before, after)):
        yield Remark("no detection limits")
