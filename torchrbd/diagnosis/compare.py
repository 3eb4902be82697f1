"""Compare two diagnoses of one robot: before and after service, or two robots of a series."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import torch

from torchrbd.diagnosis import compare_words as words
from torchrbd.diagnosis.compare_inertia import inertial_differences, load_like
from torchrbd.diagnosis.compare_reading import Side, side_of
from torchrbd.diagnosis.compare_results import (
    CERTAIN,
    LOOSER,
    WIDER,
    Change,
    Comparison,
    Difference,
    Verdict,
    difference,
    verdict_of,
)
from torchrbd.diagnosis.results import Alternative, Diagnosis, Finding, Limit, Quantity
from torchrbd.errors import InputError
from torchrbd.physics import effect, effects

Place = tuple[str, tuple[str, ...], tuple[str, ...], tuple[str, ...]]
Found = Literal["both", "before", "after"]

# Their size says nothing of the strength of an effect.
_NOT_COMPARED = ("phase", "side")
# Friction in motion goes by other names where more of it is seen: at rest, by direction, before it slides.
_COULOMB = "coulomb"
_DRY = ("coulomb_friction", "asymmetric_coulomb_friction", "stribeck_friction", "presliding_hysteresis")
# Parts by which shapes may differ.
LIKE_SHAPE = 0.25
# One or two combinations alone stood out in 3 of 38 pairs of recordings of one robot: a body that changes moves more.
LEAST_CHANGED = 3
_ORDER = {"changed": 0, "open": 1, "unchanged": 2}


def compare(before: Diagnosis | str | Path, after: Diagnosis | str | Path) -> Comparison:
    """Say what changed between two diagnoses of the same robot, and how certain that is.

    Findings of both are compared parameter by parameter. One that is found in one only is new, or gone, if the
    ``limits`` of the other say that it would have been seen. Inertial parameters are compared in combinations that both
    data sets tell; from a file, parameters.json must lie beside it.

    Args:
        before, after: diagnoses, their folders, or their diagnosis.json.

    Returns:
        What changed, the most certain first; see ``compare_results.py`` for the probability.

    Raises:
        InputError: a file that cannot be used, or diagnoses of different robots.
    """
    one, other = side_of(before, "before"), side_of(after, "after")
    _check(one, other)
    findings = [*_matched(one, other)]
    changes = [*findings, *_inertia(one, other), *_unexplained(one, other)]
    changes.sort(key=lambda c: (_ORDER[c.verdict], -c.probability if c.probability == c.probability else 0.0))
    statement = words.overall(changes)
    return Comparison(one.robot, one.joints, one.name, other.name, statement, tuple(changes), tuple(_notes(one, other)))


def _check(before: Side, after: Side) -> None:
    remedy = "compare diagnoses of one robot, made with URDFs of the same name and joints"
    if before.robot != after.robot:
        raise InputError(f"{before.name} is of robot '{before.robot}', {after.name} of robot '{after.robot}'; {remedy}")
    if set(before.joints) != set(after.joints):
        different = sorted(set(before.joints) ^ set(after.joints))
        raise InputError(
            f"{before.name} and {after.name} are of different joints, only one has {', '.join(different)}; {remedy}"
        )


def _matched(before: Side, after: Side) -> Iterator[Change]:
    """Yield a change for each finding, those of both first."""
    left = {"before": list(before.findings), "after": list(after.findings)}
    for one in before.findings:
        same = next((f for f in left["after"] if _place(f) == _place(one) and _timed(f) == _timed(one)), None)
        if same is not None:
            left["before"].remove(one)
            left["after"].remove(same)
            yield _of_both(one, same, 1.0 if _alike(before, after, one) else WIDER)
    yield from _dry(left["before"], left["after"])
    for found, other in (("after", before), ("before", after)):
        for finding in left[found]:
            rivals = left["before" if found == "after" else "after"]
            yield _of_one(finding, found, other, rivals)  # type: ignore[arg-type]


def _dry(before: list[Finding], after: list[Finding]) -> Iterator[Change]:
    """Yield what became of friction in motion that is part of different effects; plain friction leaves the lists."""
    for one in [f for f in before if f.effect in _DRY and not _timed(f)]:
        for other in [f for f in after if f.effect in _DRY and f.joints == one.joints and not _timed(f)]:
            plain, same = _plain(one), _plain(other)
            if plain is not None and same is not None:
                yield _of_both(plain, same, WIDER)
            # What friction in motion says, or that of two directions, is said by this.
            for found, f in ((before, one), (after, other)):
                if f.effect in _DRY[:2] and f in found:
                    found.remove(f)


def _alike(before: Side, after: Side, finding: Finding) -> bool:
    """Say whether both have the same effects, and the same without a name, at the joints of a finding."""
    found = [
        {_place(f) for f in side.findings if set(f.joints) & set(finding.joints)}
        | {u.depends_on for u in side.unexplained if set(u.joints) & set(finding.joints)}
        for side in (before, after)
    ]
    return found[0] == found[1]


def _of_both(one: Finding, other: Finding, wider: float) -> Change:
    before, after = _quantities(one), _quantities(other)
    for name in before.keys() & after.keys():
        if before[name].unit != after[name].unit:
            raise InputError(
                f"{name} of {one.effect} at {', '.join(one.joints or one.links)} is in {before[name].unit} before "
                f"and in {after[name].unit} after; compare diagnoses of one robot"
            )
    parameters = {
        name: difference(
            q,
            after[name],
            max(_size(one, name, q), _size(other, name, after[name])),
            right=one.probability * other.probability,
            wider=wider,
        )
        for name, q in before.items()
        if name in after
    }
    probability = _most(parameters.values())
    verdict = verdict_of(probability)
    statement = words.of_both(one, verdict, probability, parameters)
    return _change(one, "both", verdict, probability, parameters, statement)


def _of_one(finding: Finding, found: Found, other: Side, rivals: Sequence[Finding]) -> Change:
    """Return what the other side says of a finding that it has not."""
    others = [r for r in rivals if _may_be(finding, r) or _may_be(r, finding)]
    others = others or [r for r in rivals if set(r.joints) & set(finding.joints)]
    if others:
        return _change(finding, found, "open", math.nan, {}, words.renamed(finding, others, found))
    limit = next((x for x in other.limits if _place(x) == _place(finding)), None)
    why = ""
    if _timed(finding):
        why = "it acts for a time only, in recordings that the other diagnosis has not seen"
    elif limit is None or limit.parameter not in finding.parameters:
        why = "the other diagnosis does not say how large it could have been unseen"
    elif not _alike_in_shape(finding, limit):
        why = "how large it could have been unseen in the other data is known for another shape of it only"
    if why or limit is None:
        statement = words.of_one(finding, "open", str(found), {}, why)
        return _change(finding, found, "open", math.nan, {}, statement)
    here, there = finding.parameters[limit.parameter], Quantity(limit.value, limit.std, limit.unit)
    size = max(_size(finding, limit.parameter, here), abs(limit.value - limit.none))
    pair = (there, here) if found == "after" else (here, there)
    parameters = {limit.parameter: difference(*pair, size, right=finding.probability, wider=LOOSER)}
    probability = _most(parameters.values())
    verdict = verdict_of(probability)
    if verdict == "changed" and not _departs(finding, limit):
        verdict = "open"
    statement = words.of_one(finding, verdict, str(found), parameters, "")
    return _change(finding, found, verdict, probability, parameters, statement)


def _alike_in_shape(finding: Finding, limit: Limit) -> bool:
    """Say whether a limit holds for the shape that was found: a narrow bump may hide where a wide one would not."""
    if not limit.shape:
        return True
    if finding.effect not in effects():
        return False
    _, shape = effect(finding.effect).coefficients({name: q.value for name, q in finding.parameters.items()})
    return all(
        name in shape and abs(shape[name] - value) <= LIKE_SHAPE * max(abs(shape[name]), abs(value))
        for name, value in limit.shape.items()
    )


def _departs(finding: Finding, limit: Limit) -> bool:
    """Say whether a finding is more than what the other data allow."""
    return _size(finding, limit.parameter, finding.parameters[limit.parameter]) > abs(limit.value - limit.none)


def _inertia(before: Side, after: Side) -> Iterator[Change]:
    parameters = inertial_differences(before, after)
    if parameters:
        probability = _most(parameters.values())
        verdict = verdict_of(probability)
        load = load_like(before, after) if verdict == "changed" else None
        if load is None and sum(d.probability >= CERTAIN for d in parameters.values()) < LEAST_CHANGED:
            verdict = "unchanged" if verdict == "unchanged" else "open"
        statement = words.of_inertia(verdict, probability, parameters, load)
        yield Change(
            "inertia", "", (), load.links if load else (), (), "both", verdict, probability, parameters, statement
        )


def _unexplained(before: Side, after: Side) -> Iterator[Change]:
    sides = {"before": before.unexplained, "after": after.unexplained}
    keys = {found: [(u.joints, u.depends_on[:1]) for u in those] for found, those in sides.items()}
    for found, those in sides.items():
        for one, key in zip(those, keys[found], strict=True):
            shared = key in keys["before"] and key in keys["after"]
            if shared and found == "after":
                continue
            where: Found = "both" if shared else found  # type: ignore[assignment]
            statement = words.of_unexplained(one, where)
            yield Change("unexplained", "", one.joints, (), one.depends_on, where, "open", math.nan, {}, statement)


def _notes(before: Side, after: Side) -> Iterator[str]:
    shared = sorted(set(before.recordings) & set(after.recordings))
    if shared:
        yield f"both were made from recordings called {', '.join(shared)}: if they are the same, nothing has changed"
    if before.cutoff_hz != after.cutoff_hz:
        yield (
            f"the band limits differ, {before.cutoff_hz:g} and {after.cutoff_hz:g} Hz; what acts between them may show "
            "in one only: diagnose both with one --cutoff"
        )
    if bool(before.simulated) != bool(after.simulated):
        yield "one was compared with a simulation, the other with the URDF: what the simulator has is a difference too"
    if inertial_differences(before, after) is None:
        yield "inertial parameters are not compared: parameters.json is missing, without intervals, or of other bodies"
    if not all(side.limits for side in (before, after)):
        yield "one of the two does not say how large what it has not found could be; diagnose the recordings again"


def _change(
    finding: Finding,
    found: Found,
    verdict: Verdict,
    probability: float,
    parameters: dict[str, Difference],
    statement: str,
) -> Change:
    place = finding.joints, finding.links, finding.depends_on
    return Change("finding", finding.effect, *place, found, verdict, probability, parameters, statement)


def _place(one: Finding | Limit) -> Place:
    return one.effect, one.joints, one.links, one.depends_on


def _timed(finding: Finding) -> bool:
    return finding.where.recordings is not None


def _may_be(finding: Finding, other: Finding) -> bool:
    """Say whether the data of a finding cannot tell it from another."""
    alike = Alternative(other.effect, other.joints, other.links, other.depends_on)
    return alike in finding.indistinguishable_from


def _quantities(finding: Finding) -> dict[str, Quantity]:
    return {name: q for name, q in finding.parameters.items() if name not in _NOT_COMPARED}


def _plain(finding: Finding) -> Finding | None:
    """Return a finding's friction in motion as plain friction, the mean of both directions; None if it has none."""
    value = finding.parameters.get(_COULOMB)
    both = [q for name, q in finding.parameters.items() if name.startswith(f"{_COULOMB}_")]
    if value is None and len(both) == 2:
        mean = 0.5 * sum(q.value for q in both)
        value = Quantity(mean, 0.5 * math.hypot(*(q.std for q in both)), both[0].unit)
    return None if value is None else replace(finding, effect=_DRY[0], parameters={_COULOMB: value})


def _size(finding: Finding, name: str, quantity: Quantity) -> float:
    """Return how far a parameter is from what it is without the effect; of a place or shape, its own size."""
    if finding.effect in effects():
        known = effect(finding.effect)
        w, shape = known.coefficients({key: q.value for key, q in finding.parameters.items()})
        none = float(known.parameters(torch.zeros(len(w), dtype=torch.float64), shape)[name])
        if math.isfinite(none) and none != quantity.value:
            return abs(quantity.value - none)
    return abs(quantity.value)


def _most(parameters: Iterable[Difference]) -> float:
    return max((d.probability for d in parameters if not math.isnan(d.probability)), default=math.nan)
