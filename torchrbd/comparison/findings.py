"""What became of each finding of two diagnoses: as strong as it was, stronger, new, gone, or called otherwise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import torch

from torchrbd.comparison.reading import Side
from torchrbd.comparison.results import (
    LOOSER,
    WIDER,
    Change,
    Difference,
    Found,
    Verdict,
    difference,
    most,
    verdict_of,
)
from torchrbd.diagnosis.results import Alternative, DetectionLimit, Finding, Quantity
from torchrbd.effects import effect, known_effects
from torchrbd.errors import InputError

Place = tuple[str, tuple[str, ...], tuple[str, ...], tuple[str, ...]]

# Friction in motion goes by other names where more of it is seen: at rest, by direction, before it slides.
_COULOMB, _PLAIN = "coulomb", "coulomb_friction"
# Parts by which shapes may differ.
LIKE_SHAPE = 0.25


def changed_findings(before: Side, after: Side) -> Iterator[Change]:
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
    for one in [f for f in before if _is_dry(f) and not _timed(f)]:
        for other in [f for f in after if _is_dry(f) and f.joints == one.joints and not _timed(f)]:
            plain, same = _plain(one), _plain(other)
            if plain is not None and same is not None:
                yield _of_both(plain, same, WIDER)
            # What friction in motion says, or that of two directions, is said by this.
            for found, f in ((before, one), (after, other)):
                if effect(f.effect).is_baseline and f in found:
                    found.remove(f)


def _is_dry(finding: Finding) -> bool:
    known = known_effects().get(finding.effect)
    return known is not None and known.dry


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
    probability = most(parameters.values())
    verdict = verdict_of(probability)
    return _change(one, "both", verdict, probability, parameters)


def _of_one(finding: Finding, found: Found, other: Side, rivals: Sequence[Finding]) -> Change:
    """Return what the other side says of a finding that it has not."""
    others = [r for r in rivals if _may_be(finding, r) or _may_be(r, finding)]
    others = others or [r for r in rivals if set(r.joints) & set(finding.joints)]
    if others:
        names = tuple(Alternative(r.effect, r.joints, r.links, r.depends_on) for r in others)
        return replace(_change(finding, found, "open", math.nan, {}), rivals=names)
    limit = next((x for x in other.detection_limits if _place(x) == _place(finding)), None)
    why = ""
    if _timed(finding):
        why = "window"
    elif limit is None or limit.parameter not in finding.parameters:
        why = "no limit"
    elif not _alike_in_shape(finding, limit):
        why = "other shape"
    if why or limit is None:
        return replace(_change(finding, found, "open", math.nan, {}), reason=why)
    here, there = finding.parameters[limit.parameter], Quantity(limit.value, limit.std, limit.unit)
    size = max(_size(finding, limit.parameter, here), abs(limit.value - limit.none))
    pair = (there, here) if found == "after" else (here, there)
    parameters = {limit.parameter: difference(*pair, size, right=finding.probability, wider=LOOSER)}
    probability = most(parameters.values())
    verdict = verdict_of(probability)
    if verdict == "changed" and not _departs(finding, limit):
        verdict = "open"
    return _change(finding, found, verdict, probability, parameters)


def _alike_in_shape(finding: Finding, limit: DetectionLimit) -> bool:
    """Say whether a limit holds for the shape that was found: a narrow bump may hide where a wide one would not."""
    if not limit.shape:
        return True
    if finding.effect not in known_effects():
        return False
    _, shape = effect(finding.effect).coefficients({name: q.value for name, q in finding.parameters.items()})
    return all(
        name in shape and abs(shape[name] - value) <= LIKE_SHAPE * max(abs(shape[name]), abs(value))
        for name, value in limit.shape.items()
    )


def _departs(finding: Finding, limit: DetectionLimit) -> bool:
    """Say whether a finding is more than what the other data allow."""
    return _size(finding, limit.parameter, finding.parameters[limit.parameter]) > abs(limit.value - limit.none)


def _change(
    finding: Finding,
    found: Found,
    verdict: Verdict,
    probability: float,
    parameters: dict[str, Difference],
) -> Change:
    place = finding.joints, finding.links, finding.depends_on
    return Change("finding", finding.effect, *place, found, verdict, probability, parameters, finding.where)


def _place(one: Finding | DetectionLimit) -> Place:
    return one.effect, one.joints, one.links, one.depends_on


def _timed(finding: Finding) -> bool:
    return finding.where.recordings is not None


def _may_be(finding: Finding, other: Finding) -> bool:
    """Say whether the data of a finding cannot distinguish it from another."""
    alike = Alternative(other.effect, other.joints, other.links, other.depends_on)
    return alike in finding.indistinguishable_from


def _quantities(finding: Finding) -> dict[str, Quantity]:
    """Return what says how strong an effect is, or what shape it has."""
    not_compared = ("phase", *effect(finding.effect).kinds)
    return {name: q for name, q in finding.parameters.items() if name not in not_compared}


def _plain(finding: Finding) -> Finding | None:
    """Return a finding's friction in motion as plain friction, the mean of both directions; None if it has none."""
    value = finding.parameters.get(_COULOMB)
    both = [q for name, q in finding.parameters.items() if name.startswith(f"{_COULOMB}_")]
    if value is None and len(both) == 2:
        mean = 0.5 * sum(q.value for q in both)
        value = Quantity(mean, 0.5 * math.hypot(*(q.std for q in both)), both[0].unit)
    return None if value is None else replace(finding, effect=_PLAIN, parameters={_COULOMB: value})


def _size(finding: Finding, name: str, quantity: Quantity) -> float:
    """Return how far a parameter is from what it is without the effect; of a place or shape, its own size."""
    if finding.effect in known_effects():
        known = effect(finding.effect)
        w, shape = known.coefficients({key: q.value for key, q in finding.parameters.items()})
        none = float(known.parameters(torch.zeros(len(w), dtype=torch.float64), shape)[name])
        if math.isfinite(none) and none != quantity.value:
            return abs(quantity.value - none)
    return abs(quantity.value)
