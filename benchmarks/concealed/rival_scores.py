"""Score what rivals predict and choose, torchrbd beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .figures import mean, median, share, table
from .matching import PARTS, judge

Json = Mapping[str, Any]


def range_errors(error: np.ndarray, measured: np.ndarray, states: np.ndarray, held_out: np.ndarray) -> Json:
    """Return mean squared errors over the torque's variance, per joint, on held-out samples; None without any.

    A sample is outside if any of its signals lies beyond what the fitted samples cover.

    Args:
        error: (M, n) of the predicted torque.
        measured: (M, n).
        states: (M, K) signals whose range counts.
        held_out: (M,) bool.
    """
    low, high = states[~held_out].min(0), states[~held_out].max(0)
    beyond = ((states < low) | (states > high)).any(1)
    variance = np.var(measured[held_out], axis=0)
    # A joint whose torque is not measured, or does not change, has no error to speak of.
    unit = np.where(variance > 0, variance, np.nan)
    return {
        name: (np.mean(error[own] ** 2, axis=0) / unit).tolist() if own.any() else None
        for name, own in (("inside", held_out & ~beyond), ("outside", held_out & beyond))
    }


def score_rivals(truth: Json, rivals: Json, diagnosis: Json, series: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return per method its errors and, where it names terms, how many concealed effects it holds and how many are
    false; torchrbd beside them.

    Args:
        truth: contents of the truth file.
        rivals: what ``run_rivals`` returned.
        diagnosis: contents of diagnosis.json.
        series: what the diagnosis predicted: held_out, q, qd, measured, extended.
    """
    rows = {name: {"errors": errors, "hits": None, "false": None} for name, errors in rivals["errors"].items()}
    for name, terms in rivals["terms"].items():
        hits, false = _term_counts(terms, truth)
        rows[name].update(hits=hits, false=false)
    judged = judge(diagnosis["findings"], truth)
    states = np.concatenate((series["q"], series["qd"]), axis=1)
    error = series["measured"] - series["extended"]
    rows["torchrbd"] = {
        "errors": range_errors(error, series["measured"], states, series["held_out"]),
        "hits": sum(j.effect is not None for j in judged),
        "false": sum(not j.right for j in judged),
    }
    return {"case": truth["id"], "tier": truth["tier"], "concealed": len(truth["effects"]), "methods": rows}


def _term_counts(terms: Mapping[str, Sequence[Sequence[str]]], truth: Json) -> tuple[int, int]:
    """Return how many concealed effects are among the chosen terms, and how many terms belong to nothing true.

    Generous to the rivals: a column counts for every effect that has it, and all shapes of an effect count once.
    """
    true = [*truth["effects"], *truth["background"], *truth.get("companions", ())]

    def right(joint: str, kinds: Sequence[str], e: Json) -> bool:
        names = {e["effect"], *PARTS.get(e["effect"], ())}
        return bool(names & set(kinds)) and (not e["joints"] or joint in e["joints"])

    chosen = {(joint, tuple(kinds)) for joint, own in terms.items() for kinds in own}
    hits = sum(any(right(joint, kinds, e) for joint, kinds in chosen) for e in truth["effects"])
    return hits, sum(not any(right(joint, kinds, e) for e in true) for joint, kinds in chosen)


def rivals_markdown(scores: Sequence[Json]) -> str:
    """Return a table of methods per tier: errors in units of the re-fitted rigid body's, terms right and false."""
    rows = []
    for tier in dict.fromkeys(s["tier"] for s in scores):
        own = [s for s in scores if s["tier"] == tier]
        for name in own[0]["methods"]:
            told = [(s, s["methods"][name], s["methods"]["rigid body"]) for s in own]
            inside, outside = (
                median(_ratio(m["errors"][where], base["errors"][where]) for _, m, base in told)
                for where in ("inside", "outside")
            )
            named = [(s, m) for s, m, _ in told if m["false"] is not None]
            hits = share([m["hits"] for _, m in named], [s["concealed"] for s, _ in named])
            rows.append((tier, name, str(inside), str(outside), str(hits), str(mean([m["false"] for _, m in named]))))
    head = ("tier", "method", "error inside", "error outside", "concealed effects held", "false terms a case")
    return f"## Rivals\n\n{table(head, rows)}\n"


def _ratio(errors: Sequence[float] | None, base: Sequence[float] | None) -> float | None:
    """Return the geometric mean over joints of errors in units of other ones."""
    if errors is None or base is None:
        return None
    ratios = np.log(np.maximum(errors, 1e-300)) - np.log(np.maximum(base, 1e-300))
    return float(np.exp(np.mean(ratios[np.isfinite(ratios)])))
