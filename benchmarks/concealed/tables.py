"""Put scores together: rates with intervals by tier and size, calibration, what must hold; as Markdown and JSON.

A rate that every effect or case enters once has Wilson's interval. One of things that come several to a case has the
same, with as many independent ones as the scatter over cases supports. A median's interval is that of its ranks.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import chain, pairwise

import numpy as np
from scipy.optimize import minimize_scalar

from .figures import Figure, mean, median, rate, share, table
from .score import CaseScore, EffectScore

BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0)
GAINS = (0.0, 30.0, 40.0, 60.0, 100.0, 300.0, math.inf)
_ABOUT_8, _ABOUT_15 = (0.07, 0.09), (0.14, 0.17)
EFFECT_COLUMNS = ("named exactly", "in class", "parameter error", "shape error", "95 % intervals cover")
PLACE_COLUMNS = (
    "joint", "link", "recordings", "ends of times [s]", "IoU of times", "IoU of ranges",
    "unexplained, joint and variable",
)  # fmt: skip
KIND_COLUMNS = ("named exactly", "in class", "joint", "unexplained, joint and variable", "parameter error")


def effect_figures(effects: Sequence[EffectScore]) -> dict[str, Figure]:
    """Return what is told of concealed effects one by one."""

    def every(get: Callable[[EffectScore], Sequence[float]]) -> list[float]:
        return list(chain.from_iterable(get(e) for e in effects))

    return {
        "named exactly": rate(e.exact for e in effects),
        "in class": rate(e.in_class for e in effects),
        "joint": rate(e.joint for e in effects),
        "link": rate(e.link for e in effects),
        "recordings": rate(e.recordings for e in effects),
        "unexplained, joint and variable": rate(e.unexplained for e in effects),
        "ends of times [s]": median(every(lambda e: e.end_errors_s)),
        "IoU of times": median(e.window_iou for e in effects),
        "IoU of ranges": median(e.region_iou for e in effects),
        "parameter error": median(every(lambda e: e.errors)),
        "shape error": median(every(lambda e: e.shape_errors)),
        "95 % intervals cover": share([sum(e.covered) for e in effects], [len(e.covered) for e in effects]),
    }


def case_figures(cases: Sequence[CaseScore]) -> dict[str, Figure]:
    """Return what is told of cases as a whole."""
    return {
        "false findings a case": mean([len(c.false) for c in cases]),
        "cases with a false finding": rate(bool(c.false) for c in cases),
        "findings false": share([len(c.false) for c in cases], [len(c.judgements) for c in cases]),
        "false above p = .6": rate(any(p > 0.6 for *_, p in c.false) for c in cases),
        "joints with an alarm": share([c.alarms for c in cases], [c.n_joints for c in cases]),
        "other friction found": share([sum(c.background) for c in cases], [len(c.background) for c in cases]),
        "gain share": median(c.gain_share for c in cases),
        "seconds": median(c.seconds for c in cases),
        "found where told": rate(c.told for c in cases),
        "slope where right": median(c.slope for c in cases),
        "its interval holds one": rate(c.slope_covers for c in cases),
        "failed": rate(c.error is not None for c in cases),
    }


def calibration(cases: Sequence[CaseScore]) -> list[tuple[float, float, float, Figure]]:
    """Return per bin of probability its ends, the mean probability, and the share of its findings that are right."""
    told = [j for c in cases for j in c.judgements]
    rows = []
    for low, high in pairwise(BINS):
        own = [j for j in told if low < j.probability <= high or (j.probability == low == 0.0)]
        middle = float(np.mean([j.probability for j in own])) if own else math.nan
        rows.append((low, high, middle, rate(j.right for j in own)))
    return rows


def right_by_gain(cases: Sequence[CaseScore]) -> list[tuple[float, float, float, Figure]]:
    """Return per bin of what names beside plain friction gain its ends, the share that should be right, and that is.

    What should be is the mean of 1 / (1 + a / gain) with the most likely a.
    """
    told, a = _gains(cases), imitated(cases)
    rows = []
    for low, high in pairwise(GAINS):
        own = [(gain, right) for gain, right in told if low <= gain < high]
        expected = float(np.mean([1.0 / (1.0 + a / gain) for gain, _ in own])) if own else math.nan
        rows.append((low, high, expected, rate(right for _, right in own)))
    return rows


def imitated(cases: Sequence[CaseScore]) -> float:
    """Return the most likely a, if the odds that a name beside plain friction is wrong are a over what it gains."""
    told = _gains(cases)
    if not told:
        return math.nan
    gain, right = np.array([g for g, _ in told]), np.array([r for _, r in told])

    def unlikelihood(log_a: float) -> float:
        odds = math.exp(log_a) / gain
        return float(np.log1p(odds).sum() - np.log(odds[~right]).sum())

    return math.exp(minimize_scalar(unlikelihood, bounds=(math.log(0.01), math.log(1e4)), method="bounded").x)


def _gains(cases: Sequence[CaseScore]) -> list[tuple[float, bool]]:
    """Return what names beside plain friction gain, at least one log-likelihood unit, and whether they are right."""
    return [(max(j.gain, 1.0), j.right) for c in cases for j in c.judgements if j.gain is not None]


def sure_and_right(cases: Sequence[CaseScore]) -> tuple[Figure, Figure]:
    """Return the share of findings above .9 that are right, and the share of the right ones that are above .9."""
    told = [j for c in cases for j in c.judgements]
    return rate(j.right for j in told if j.probability > 0.9), rate(j.probability > 0.9 for j in told if j.right)


def must_hold(cases: Sequence[CaseScore]) -> list[tuple[str, Figure, str, bool | None]]:
    """Return what the final set must hold: words, figure, bound, and whether its value is within it."""

    def effects(tier: str, least: float = 0.0, most: float = math.inf) -> list[EffectScore]:
        return [e for c in cases if c.tier == tier for e in c.effects if least <= e.size <= most]

    def of(tier: str) -> list[CaseScore]:
        return [c for c in cases if c.tier == tier]

    named = [e for c in cases if c.tier in ("clean", "field") for e in c.effects]
    field8, measured, overall = effect_figures(effects("field", *_ABOUT_8)), effect_figures(named), case_figures(cases)
    sure, right = sure_and_right(cases)

    def tellable(least: float, most: float) -> list[EffectScore]:
        return [e for c in of("injected") if c.told for e in c.effects if least <= e.size <= most]

    rows: list[tuple[str, Figure, str, float]] = [
        ("clean, 8 % and more: in class", rate(e.in_class for e in effects("clean", 0.07)), ">=", 0.97),
        ("field, 8 %: in class", field8["in class"], ">=", 0.88),
        ("field, 4 %: in class", rate(e.in_class for e in effects("field", 0.03, 0.05)), ">=", 0.65),
        ("field: friction on the other joints", case_figures(of("field"))["other friction found"], ">=", 0.95),
        ("injected, 15 %: in class", rate(e.in_class for e in effects("injected", *_ABOUT_15)), ">=", 0.8),
        ("injected, 15 %: or its family", rate(e.family for e in effects("injected", *_ABOUT_15)), ">=", 0.8),
        ("injected, 15 %, where it can be told: in class", rate(e.in_class for e in tellable(*_ABOUT_15)), ">=", 0.8),
        ("injected, 8 %: in class", rate(e.in_class for e in effects("injected", *_ABOUT_8)), ">=", 0.8),
        ("injected, 8 %: or its family", rate(e.family for e in effects("injected", *_ABOUT_8)), ">=", 0.6),
        ("injected, 8 %, where it can be told: in class", rate(e.in_class for e in tellable(*_ABOUT_8)), ">=", 0.8),
        ("nulls: cases with a false finding", rate(bool(c.false) for c in of("null")), "<=", 0.02),
        ("nulls: joints with an alarm", case_figures(of("null"))["joints with an alarm"], "<=", 0.02),
        ("all: findings false", overall["findings false"], "<=", 0.05),
        ("absorbed: false above p = .6", case_figures(of("absorbed"))["false above p = .6"], "<=", 0.0),
        ("outside: unexplained, joint and variable", rate(e.unexplained for e in effects("outside")), ">=", 0.8),
        ("outside: cases with a wrong name", rate(bool(c.false) for c in of("outside")), "<=", 0.1),
        ("parameter error, median", measured["parameter error"], "<=", 0.05),
        ("shape error, median", measured["shape error"], "<=", 0.1),
        ("95 % intervals cover at least", measured["95 % intervals cover"], ">=", 0.9),
        ("95 % intervals cover at most", measured["95 % intervals cover"], "<=", 0.98),
        ("findings above .9 that are right", sure, ">=", 0.88),
        ("right findings that are above .9", right, ">=", 0.5),
        ("field: gain share, median", case_figures(of("field"))["gain share"], ">=", 0.85),
        ("field, 8 %: joint located", field8["joint"], ">=", 0.97),
        ("field, 8 %: ends of times [s]", field8["ends of times [s]"], "<=", 0.3),
        ("field, 8 %: IoU of times", field8["IoU of times"], ">=", 0.7),
        ("field, 8 %: IoU of ranges", field8["IoU of ranges"], ">=", 0.7),
        ("seconds a case, median", overall["seconds"], "<=", 15.0),
    ]
    return [(words, f, f"{way} {bound:g}", _holds(f, way, bound)) for words, f, way, bound in rows]


def _holds(figure: Figure, way: str, bound: float) -> bool | None:
    if figure.n == 0:
        return None
    return figure.value >= bound if way == ">=" else figure.value <= bound


def markdown(cases: Sequence[CaseScore]) -> str:
    """Return all tables."""
    tiers = list(dict.fromkeys(c.tier for c in cases))
    by_tier = {tier: [c for c in cases if c.tier == tier] for tier in tiers}
    sizes = sorted({e.size for c in cases for e in c.effects})
    rows = {
        (f"{tier}, {100 * size:.2g} %" if size else tier): effect_figures(own)
        for tier in tiers
        for size in sizes
        if (own := [e for c in by_tier[tier] for e in c.effects if e.size == size])
    }
    kinds = {
        f"{effect} ({tier})": effect_figures(own)
        for tier in tiers
        for effect in sorted({e.effect for c in by_tier[tier] for e in c.effects})
        if (own := [e for c in by_tier[tier] for e in c.effects if e.effect == effect])
    }
    wrong = Counter((effect, c.tier) for c in cases for effect, *_ in c.false)
    parts = [
        ("Must hold", table(("", "reached", "bound", "holds"), [
            (words, str(f), bound, {True: "yes", False: "no", None: "not judged"}[held])
            for words, f, bound, held in must_hold(cases)
        ])),
        ("Concealed effects, by tier and size", _figures("tier, size", rows, EFFECT_COLUMNS)),
        ("Where and when", _figures("tier, size", rows, PLACE_COLUMNS)),
        ("Concealed effects, by kind", _figures("effect", kinds, KIND_COLUMNS)),
        ("Cases", _figures("tier", {t: case_figures(own) for t, own in by_tier.items()})),
        ("Calibration", table(("probability", "findings", "mean probability", "right"), [
            (f"{low:g} to {high:g}", str(f.n), f"{p:.2f}", str(f)) for low, high, p, f in calibration(cases) if f.n
        ])),
        ("Names beside plain friction, by what they gain", table(
            ("log-likelihood units", "names", "right", f"1 / (1 + {imitated(cases):.3g} / gain)"),
            [(f"{lo:g} to {hi:g}", str(f.n), str(f), f"{p:.2f}") for lo, hi, p, f in right_by_gain(cases) if f.n],
        )),
        ("False findings", table(("effect", "tier", "findings"), [
            (effect, tier, str(n)) for (effect, tier), n in wrong.most_common()
        ])),
    ]  # fmt: skip
    return "\n\n".join(f"## {title}\n\n{table}" for title, table in parts) + "\n"


def _figures(head: str, rows: Mapping[str, Mapping[str, Figure]], columns: Sequence[str] | None = None) -> str:
    """Return a table of figures without the columns in which nothing is told."""
    wanted = columns or list(next(iter(rows.values()), {}))
    told = [c for c in wanted if any(r[c].n for r in rows.values())]
    counted = ("n",) if columns else ()
    lines = [(name, *(str(r["in class"].n) for _ in counted), *(str(r[c]) for c in told)) for name, r in rows.items()]
    return table((head, *counted, *told), lines)
