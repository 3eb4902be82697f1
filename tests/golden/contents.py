"""What a diagnosis says, as numbers and names that a later version has to repeat."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from torchrbd import Diagnosis, Finding
from torchrbd.diagnosis.ranked import Ranked
from torchrbd.diagnosis.results import Quantity
from torchrbd.inference.results import BaseParameterEstimate

# Leading hypotheses of the first and of the last step.
LEADING = 10
# Evidence [nats], relative figures, and standard deviations by which an estimate may differ.
NATS, RELATIVE, STANDARD_DEVIATIONS = 0.05, 5e-4, 0.02


def contents(result: Diagnosis) -> dict[str, Any]:
    """Return what a case fixes; JSON can hold it."""
    identification = result.identification
    return {
        "verdict": result.verdict,
        "findings": [_finding(one) for one in result.findings],
        "not_confirmed": [_finding(one) for one in result.not_confirmed],
        "unexplained": [[one.kind, *one.joints, *one.depends_on] for one in result.unexplained],
        "suspicions": [[one.kind, *one.joints] for one in identification.suspicions.found],
        "evidence": {} if result.ranking is None else {
            "adopted": _evidence(result.ranking.adopted),
            "first": _evidence(result.ranking.first[:LEADING]),
            "last": _evidence(result.ranking.last[:LEADING]),
        },
        "nmse": {name: _rounded(fit.nmse) for name, fit in identification.fits.items()},
        "base_parameters": [_estimate_of(one) for one in identification.base],
    }  # fmt: skip


def _finding(one: Finding) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "place": [*one.joints, *one.links, *one.depends_on],
        "recordings": None if one.where.recordings is None else list(one.where.recordings),
        "time_s": None if one.where.time_s is None else [list(span) for span in one.where.time_s],
        "probability": _significant(one.probability),
        "parameters": {name: _estimate_of(q) for name, q in one.parameters.items()},
    }


def _estimate_of(one: Quantity | BaseParameterEstimate) -> dict[str, float | None]:
    return {"value": _significant(one.value), "std": _significant(one.std)}


def _evidence(several: Iterable[Ranked]) -> list[list[Any]]:
    """Return effect, place and window in words, and nats."""
    return [[_words(one), round(one.log_evidence, 3)] for one in several]


def _words(one: Ranked) -> str:
    window = "" if one.window is None else f" {one.window[0]} {one.window[1]:.2f}:{one.window[2]:.2f}"
    return " ".join(filter(None, (one.effect, *one.joints, *one.links, one.other))) + window


def _rounded(values: Mapping[str, float]) -> dict[str, float | None]:
    return {name: _significant(value) for name, value in values.items()}


def _significant(value: float) -> float | None:
    return float(f"{value:.6g}") if math.isfinite(value) else None


def differences(expected: Any, found: Any, place: str = "") -> Iterator[str]:
    """Yield where two contents differ by more than they may."""
    if isinstance(expected, dict) and isinstance(found, dict):
        if set(expected) == {"value", "std"} == set(found):
            yield from _estimate(expected, found, place)
            return
        for name in sorted(set(expected) | set(found)):
            if name not in found or name not in expected:
                yield f"{place}/{name}: {'gone' if name not in found else 'new'}"
            else:
                yield from differences(expected[name], found[name], f"{place}/{name}")
    elif isinstance(expected, list) and isinstance(found, list):
        if place.startswith("/evidence/"):
            yield from _nats(expected, found, place)
            return
        if len(expected) != len(found):
            yield f"{place}: {expected} became {found}"
            return
        for k, (a, b) in enumerate(zip(expected, found, strict=True)):
            yield from differences(a, b, f"{place}/{k}")
    elif isinstance(expected, float) and isinstance(found, float):
        if abs(found - expected) > RELATIVE * abs(expected) + 1e-12:
            yield f"{place}: {expected:.6g} became {found:.6g}"
    elif expected != found:
        yield f"{place}: {expected} became {found}"


def _estimate(expected: dict[str, Any], found: dict[str, Any], place: str) -> Iterator[str]:
    """Compare an estimate in units of its standard deviation: small digits of what is unknown say nothing."""
    a, b, std = expected["value"], found["value"], expected["std"] or 0.0
    if a is None or b is None:
        if a is not b:
            yield f"{place}: {a} became {b}"
        return
    if abs(b - a) > max(RELATIVE * abs(a), STANDARD_DEVIATIONS * std) + 1e-12:
        yield f"{place}: {a:.6g} became {b:.6g} (standard deviation {std:.3g})"


def _nats(expected: list[list[Any]], found: list[list[Any]], place: str) -> Iterator[str]:
    """Compare evidence by hypothesis; the last of the leading ones may change places with one that is as good."""
    before, after = dict(map(tuple, expected)), dict(map(tuple, found))
    least = max(min(before.values(), default=-math.inf), min(after.values(), default=-math.inf)) + NATS
    for name in sorted(set(before) | set(after)):
        a, b = before.get(name), after.get(name)
        if a is None or b is None:
            if (a if b is None else b) > least or place.endswith("adopted"):
                yield f"{place}/{name}: {a} became {b} nats"
        elif abs(a - b) > NATS:
            yield f"{place}/{name}: {a} became {b} nats"
