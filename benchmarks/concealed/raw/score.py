"""Score rankings of raw cases.

    python -m benchmarks.concealed.raw.score OUT DIR [DIR ...]

prints tables. Ranks count from 1. ``exact`` is the rank of the concealed effect at its place; ``class`` that of the
first hypothesis which is it or is listed as indistinguishable from it; ``at its place`` the exact one's rank among all
hypotheses of the same joints and links. A truth is named if it is first at its place, or the first of all is in its
class, with more than 9 nats. What the data cannot say is not asked for: rates are of cases whose oracle has more.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from ..figures import rate, table
from ..matching import same_place

Json = Mapping[str, Any]
ENOUGH = 9.0
"""Nats that a finding takes."""


@dataclass(frozen=True)
class Score:
    """One case.

    Attributes:
        id, robot: of the truth.
        effect: concealed, None for a null.
        share, remains, nats: of the truth.
        exact, in_class, at_place: ranks, None where it is not in the list.
        evidence: of the exact hypothesis, None likewise.
        oracle: log evidence of the same likelihood told the truth.
        named: whether it is; None for nulls.
        top: (effect, place, log evidence) of the first hypothesis.
        seconds, peak_mb: taken.
        error: if the case ended in one.
    """

    id: str
    robot: str
    effect: str | None
    share: float
    remains: float
    nats: float
    exact: int | None
    in_class: int | None
    at_place: int | None
    evidence: float | None
    oracle: float | None
    named: bool | None
    top: tuple[str, str, float] | None
    seconds: float
    peak_mb: float | None
    error: str


def is_exact(hypothesis: Json, true: Json, joints: Sequence[str]) -> bool:
    """Say whether a hypothesis is the concealed effect, at its place."""
    other = hypothesis.get("other")
    return (
        hypothesis["effect"] == true["effect"]
        and same_place(hypothesis, true, joints)
        and (not true["other"] or not other or other == true["other"])
    )


def is_in_class(hypothesis: Json, true: Json, joints: Sequence[str]) -> bool:
    """Say whether a hypothesis is the concealed effect or as right a name."""
    alike = [a for a in true["indistinguishable"] if a["effect"] == hypothesis["effect"]]
    return is_exact(hypothesis, true, joints) or any(same_place(hypothesis, a, joints) for a in alike)


def _first(flags: Sequence[bool]) -> int | None:
    return flags.index(True) + 1 if True in flags else None


def score_case(truth: Json, result: Json, of: str = "first") -> Score:
    """Score the first or the last ranking of a case."""
    true = truth["effects"][0] if truth["effects"] else None
    ranking = sorted(result.get(of, ()), key=lambda h: -(h["log_evidence"] or -1e300))
    joints, first = truth["robot"]["joints"], ranking[0] if ranking else None
    top = first and (first["effect"], place_of(first), float(first["log_evidence"] or 0.0))
    common = {
        "id": truth["id"], "robot": truth["robot"]["name"], "top": top, "seconds": float(result["seconds"]),
        "peak_mb": result.get("peak_mb"), "error": result.get("error", ""),
    }  # fmt: skip
    if true is None:
        nothing = dict.fromkeys(("effect", "exact", "in_class", "at_place", "evidence", "oracle", "named"))
        return Score(**common, **nothing, share=0.0, remains=0.0, nats=0.0)  # pyright: ignore[reportArgumentType]
    exact = [is_exact(h, true, joints) for h in ranking]
    alike = [is_in_class(h, true, joints) for h in ranking]
    there = [k for k, h in enumerate(ranking) if same_place(h, true, joints) and (true["joints"] or true["links"])]
    there = there or [k for k, h in enumerate(ranking) if not h["joints"] and not h["links"]]
    at_place = _first([exact[k] for k in there])
    value = ranking[exact.index(True)]["log_evidence"] if True in exact else None
    named = at_place == 1 and (value or 0.0) > ENOUGH
    named = named or bool(alike and alike[0] and (first["log_evidence"] or 0.0) > ENOUGH)
    oracle = (result.get("oracle") or [None])[0]
    return Score(
        **common, effect=true["effect"], share=true["share"], remains=true["remains"], nats=true["nats"],
        exact=_first(exact), in_class=_first(alike), at_place=at_place, evidence=value, oracle=oracle, named=named,
    )  # fmt: skip


def place_of(hypothesis: Json) -> str:
    """Return joints and links in words."""
    names = [*hypothesis["joints"], *hypothesis["links"]]
    return ("robot" if not names else ", ".join(names)) + (f" ({o})" if (o := hypothesis.get("other")) else "")


def _text(value: float | None, form: str = ".1f") -> str:
    return "–" if value is None else format(value, form)


def tables(scores: Sequence[Score]) -> str:
    """Return all tables in Markdown."""
    with_effect = [s for s in scores if s.effect is not None]
    rows = [
        (s.effect or "", s.robot, f"{100 * s.share:.1f} %", f"{s.remains:.3f}", _text(s.exact, "d"),
         _text(s.at_place, "d"), _text(s.in_class, "d"), _text(s.evidence), _text(s.oracle), _text(s.nats, ".0f"),
         "yes" if s.named else "no", s.error or _top(s))
        for s in sorted(with_effect, key=lambda s: (s.effect or "", s.id))
    ]  # fmt: skip
    head = ("effect", "robot", "share", "remains", "exact", "at its place", "class", "evidence", "oracle", "nats",
            "named", "first of all")  # fmt: skip
    parts = ["## Cases", table(head, rows), "## By effect", _by_effect(with_effect), "## Nulls", _nulls(scores)]
    parts += ["## Altogether", _altogether(scores, with_effect)]
    return "\n\n".join(parts) + "\n"


def _top(s: Score) -> str:
    return "–" if s.top is None else f"{s.top[0]} {s.top[1]} {s.top[2]:.1f}"


def _by_effect(scores: Sequence[Score]) -> str:
    rows = []
    for effect in sorted({s.effect or "" for s in scores}):
        own = [s for s in scores if s.effect == effect]
        sure = [s for s in own if (s.oracle or 0.0) > ENOUGH]
        rows.append((
            effect, str(len(own)), " ".join(_text(s.exact, "d") for s in own),
            " ".join(_text(s.in_class, "d") for s in own), " ".join(_text(s.evidence, ".0f") for s in own),
            " ".join(_text(s.oracle, ".0f") for s in own), f"{sum(bool(s.named) for s in sure)} of {len(sure)}",
        ))  # fmt: skip
    return table(("effect", "n", "exact", "class", "evidence", "oracle", "named where the oracle is sure"), rows)


def _nulls(scores: Sequence[Score]) -> str:
    nulls = sorted((s for s in scores if s.effect is None), key=lambda s: -(s.top[2] if s.top else 0.0))
    rows = [(s.robot, s.id, _text(s.top and s.top[2]), s.error or _top(s)) for s in nulls]
    return table(("robot", "case", "greatest evidence", "of"), rows)


def _altogether(scores: Sequence[Score], with_effect: Sequence[Score]) -> str:
    sure = [s for s in with_effect if (s.oracle or 0.0) > ENOUGH]
    nulls = [s.top[2] for s in scores if s.effect is None and s.top]
    peaks = [s.peak_mb for s in scores if s.peak_mb is not None]
    rows = [
        ("oracle above 9 nats", str(rate((s.oracle or 0.0) > ENOUGH for s in with_effect))),
        ("named, of those", str(rate(bool(s.named) for s in sure))),
        ("first of all is exact, of those", str(rate(s.exact == 1 for s in sure))),
        ("first of all is in the class, of those", str(rate(s.in_class == 1 for s in sure))),
        ("greatest evidence on a null", _text(max(nulls, default=None))),
        ("nulls above 9 nats", f"{sum(v > ENOUGH for v in nulls)} of {sum(s.effect is None for s in scores)}"),
        ("errors", str(sum(bool(s.error) for s in scores))),
        ("median seconds", _text(median(s.seconds for s in scores))),
        ("greatest peak [MB]", _text(max(peaks, default=None), ".0f")),
    ]
    return table(("", ""), rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, read, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="OUT", help="written by rank")
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="with truth")
    parser.add_argument("--of", choices=("first", "last"), default="first", help="ranking to score")
    args = parser.parse_args(arguments)
    truths = [json.loads(file.read_text()) for folder in args.folders for file in sorted(folder.glob("truth/*.json"))]
    files = {truth["id"]: args.out / f"{truth['id']}.json" for truth in truths}
    missing = [name for name, file in files.items() if not file.exists()]
    if missing:
        print(f"{len(missing)} of {len(truths)} cases have no ranking, the first is {missing[0]}; of the others:\n")
    found = [t for t in truths if files[t["id"]].exists()]
    print(tables([score_case(t, json.loads(files[t["id"]].read_text()), args.of) for t in found]))


if __name__ == "__main__":
    main()
