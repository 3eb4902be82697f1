"""Score a diagnosis against what was concealed in its recordings: named, located, measured, how sure, how fast.

Only diagnosis.json, the truth file, the seconds and the oracle's errors are read; nothing that the tool thinks of
itself enters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

from torchrbd.effects.registry import effect, known_effects

from .matching import RIGID_BODY, Judgement, covers, judge, new_findings, relation
from .overlap import end_errors, interval_iou, region_iou
from .parameters import parameter_errors

Json = Mapping[str, Any]

# The oracle must gain this part of the rigid body's error, or a share of its gain tells nothing.
LEAST_ORACLE_GAIN = 0.02
# A joint at which effects of other joints leave more than this part of its torque may be told of.
LEAST_SIZE = 0.005


@dataclass(frozen=True)
class EffectScore:
    """What became of one concealed effect; None where a question does not arise.

    Attributes:
        effect: of the truth.
        size: that was asked for, RMS of its torque over the joint's; 0 where nothing of it is left to see.
        exact: named at its place.
        in_class: that, or told to be indistinguishable, or nothing named where other inertials do the same.
        probability: of the finding that names it.
        joint, link, recordings: whether the right ones were reported, named or not.
        unexplained: whether its joint is reported as unexplained, and first by one of the signals it depends on.
        end_errors_s: of the ends of its times; infinite where none are reported.
        window_iou, region_iou: overlap over union of times and of signal ranges.
        errors: of parameters, relative; ``shape_errors`` of those that the torque is not proportional to.
        covered: whether each parameter lies in its 95 % interval.
        family: of an injected effect: in class, or another effect of its family is new at its joint or link.
    """

    effect: str
    size: float
    exact: bool
    in_class: bool
    probability: float | None
    joint: bool | None
    link: bool | None
    recordings: bool | None
    unexplained: bool
    end_errors_s: tuple[float, ...] = ()
    window_iou: float | None = None
    region_iou: float | None = None
    errors: tuple[float, ...] = ()
    shape_errors: tuple[float, ...] = ()
    covered: tuple[bool, ...] = ()
    family: bool = False


class Judged(NamedTuple):
    """A finding's probability, whether it is right, and what it gains if it is more than plain friction, else None."""

    probability: float
    right: bool
    gain: float | None


@dataclass(frozen=True)
class CaseScore:
    """What became of one case.

    Attributes:
        case, tier, robot: of the truth.
        effects: what was concealed.
        background: of the friction that every robot has, at joints where nothing is concealed, whether it was found.
        judgements: of every finding.
        false: findings that name nothing true: (effect, place, probability).
        alarms: of ``n_joints``, those with a false finding, or something located or unexplained where nothing is
            concealed.
        gain_share: part of the gain from the re-fitted rigid body to the oracle; None without one.
        seconds: that the diagnosis took.
        error: why there is no diagnosis.
        told: whether a search that was told the effect and its joint finds it; None without one.
        slope, slope_covers: how large held-out time has what was found, and whether the interval of that holds one;
            None where it cannot be told, or something else was found than is there.
    """

    case: str
    tier: str
    robot: str
    effects: tuple[EffectScore, ...]
    background: tuple[bool, ...]
    judgements: tuple[Judged, ...]
    false: tuple[tuple[str, str, float], ...]
    alarms: int
    n_joints: int
    gain_share: float | None
    seconds: float
    error: str | None = None
    told: bool | None = None
    slope: float | None = None
    slope_covers: bool | None = None


def score_case(truth: Json, diagnosis: Json, seconds: float, oracle: Json | None = None) -> CaseScore:
    """Score one diagnosis.

    Args:
        truth: contents of the truth file.
        diagnosis: contents of diagnosis.json; ``{"error": words}`` where none was made.
        seconds: that it took.
        oracle: held-out nmse per joint of a model that was told the truth.
    """
    findings = diagnosis.get("findings", ())
    judged = judge(findings, truth)
    false = [f for f, j in zip(findings, judged, strict=True) if not j.right]
    named = {j.effect: (f, j) for f, j in zip(findings, judged, strict=True) if j.effect is not None}
    effects = tuple(_effect_score(e, diagnosis, truth, named.get(k)) for k, e in enumerate(truth["effects"]))
    there = diagnosis.get("held_out_ratio") if not false and all(e.in_class for e in effects) else None
    return CaseScore(
        case=truth["id"],
        tier=truth["tier"],
        robot=truth["robot"]["name"],
        effects=effects,
        background=_background(findings, truth),
        judgements=tuple(
            Judged(float(f["probability"]), j.right, None if _is_plain(f) else float(f["log_evidence_gain"]))
            for f, j in zip(findings, judged, strict=True)
            if j.kind != "companion"
        ),
        false=tuple((f["effect"], ", ".join((*f["joints"], *f["links"])), float(f["probability"])) for f in false),
        alarms=len(_alarmed(diagnosis, truth, false)),
        n_joints=len(truth["robot"]["joints"]),
        gain_share=_gain_share(truth, diagnosis, oracle),
        seconds=seconds,
        error=diagnosis.get("error"),
        slope=there and there["value"],
        slope_covers=there and there["low"] <= 1.0 <= there["high"],
    )


def _is_plain(finding: Json) -> bool:
    known = known_effects().get(finding["effect"])
    return known is not None and known.is_baseline and finding["where"]["recordings"] is None


def score_injected(
    truth: Json, diagnosis: Json, baseline: Json, seconds: float, told: Json | None = None
) -> CaseScore | None:
    """Score a diagnosis of real recordings with an injected effect by what is new against the untouched ones.

    Returns:
        None if the untouched recordings show that effect already, so that it cannot be new.
    """
    joints = truth["robot"]["joints"]
    known = baseline.get("findings", ())
    if any(relation(f, e, joints) is not None for f in known for e in truth["effects"]):
        return None
    findings = diagnosis.get("findings", ())
    new = new_findings(findings, known)
    # What was not there before is new, though it contains friction that was.
    new += [f for f in findings if f not in new and any(relation(f, e, joints) is not None for e in truth["effects"])]
    before = [(u["joints"], u["depends_on"][:1]) for u in baseline.get("unexplained", ())]
    left = [u for u in diagnosis.get("unexplained", ()) if (u["joints"], u["depends_on"][:1]) not in before]
    score = score_case(truth, {**diagnosis, "findings": new, "unexplained": left}, seconds)
    kin = [any(_is_kin(f, e) for f in new) for e in truth["effects"]]
    effects = (replace(e, family=e.in_class or near) for e, near in zip(score.effects, kin, strict=True))
    score = replace(score, effects=tuple(effects))
    if told is None:
        return score
    return replace(
        score, told=any(relation(f, e, joints) is not None for f in told["findings"] for e in truth["effects"])
    )


def _effect_score(true: Json, diagnosis: Json, truth: Json, named: tuple[Json, Judgement] | None) -> EffectScore:
    finding, judgement = named or (None, None)
    own, links = set(true["joints"]), set(true["links"])
    # What acts on a link shows at the joints that it moves.
    felt = own or {j for j, size in (true.get("size_by_joint") or {}).items() if size > LEAST_SIZE}
    left = [u for u in diagnosis.get("unexplained", ()) if felt & set(u["joints"])]
    at_joint = [f for f in diagnosis.get("findings", ()) if own & set(f["joints"]) and f is not finding]
    placed = [x for x in _located(diagnosis) if felt & set(x["joints"]) or links & set(x["links"])]
    unnamed = [*left, *_not_background(at_joint, truth)]
    reports = [*([finding] if finding is not None else unnamed), *placed]
    same = any(a["effect"] == RIGID_BODY for a in true.get("indistinguishable", ()))
    exact = judgement is not None and judgement.kind == "exact"
    result = EffectScore(
        effect=true["effect"],
        size=float(true["target_size"] or 0.0),
        exact=exact,
        in_class=judgement is not None or (same and "error" not in diagnosis and not unnamed),
        probability=None if finding is None else float(finding["probability"]),
        joint=any(own & set(r["joints"]) for r in reports) if own else None,
        link=any(links == set(r.get("links", ())) for r in reports) if links else None,
        recordings=_recordings_right(true, reports),
        unexplained=any(u["depends_on"] and u["depends_on"][0] in true["depends_on"] for u in left),
        **_overlaps(true["where"], [r["where"] for r in reports]),
    )
    return (
        replace(result, **parameter_errors(true["parameters"], finding["parameters"])) if exact and finding else result
    )


def _is_kin(finding: Json, true: Json) -> bool:
    """Say whether a finding is of a concealed effect's family, at its joint or link."""
    near = any(set(finding[key]) & set(true[key]) for key in ("joints", "links"))
    return near and finding["family"] == effect(true["effect"]).family


def _located(diagnosis: Json) -> list[Json]:
    """Return what was located beside rigid body and friction, before anything was named."""
    return [x for x in diagnosis.get("locations", ()) if x["model"] == "rigid_body"]


def _not_background(findings: Sequence[Json], truth: Json) -> list[Json]:
    bare = {**truth, "effects": ()}
    return [f for f, j in zip(findings, judge(findings, bare), strict=True) if j.kind == "false"]


def _recordings_right(true: Json, reports: Sequence[Json]) -> bool | None:
    if true["where"].get("recordings") is None:
        return None
    wanted = set(true["where"]["recordings"])
    return any(set(r["where"].get("recordings") or ()) == wanted for r in reports)


def _background(findings: Sequence[Json], truth: Json) -> tuple[bool, ...]:
    taken = set(chain.from_iterable(e["joints"] for e in truth["effects"]))
    rest = [e for e in truth["background"] if not taken & set(e["joints"])]
    return tuple(covers(findings, e, truth["robot"]["joints"]) for e in rest)


def _alarmed(diagnosis: Json, truth: Json, false: Sequence[Json]) -> set[str]:
    touched: set[str] = set()
    for e in (*truth["effects"], *truth.get("companions", ())):
        sizes = e.get("size_by_joint") or {}
        touched |= {*e["joints"], *(j for j, size in sizes.items() if size > LEAST_SIZE)}
    told = [*diagnosis.get("unexplained", ()), *_located(diagnosis)]
    return set(chain.from_iterable(f["joints"] for f in false)) | (
        set(chain.from_iterable(x["joints"] for x in told)) - touched
    )


def _gain_share(truth: Json, diagnosis: Json, oracle: Json | None) -> float | None:
    """Return (rigid - extended) / (rigid - oracle) of the held-out nmse summed over the concealed effects' joints."""
    if oracle is None or "fit" not in diagnosis or not all(e["in_holdout"] for e in truth["effects"]):
        return None
    joints = set(chain.from_iterable(e["joints"] for e in truth["effects"])) or set(truth["robot"]["joints"])
    rigid, extended = (
        math.fsum(diagnosis["fit"][model]["nmse"].get(j) or 0.0 for j in joints) for model in ("rigid_body", "extended")
    )
    best = math.fsum(oracle.get(j) or 0.0 for j in joints)
    return (rigid - extended) / (rigid - best) if rigid - best > LEAST_ORACLE_GAIN * rigid else None


def _overlaps(where: Json, told: Sequence[Json]) -> dict[str, Any]:
    """Return the errors of times and regions, those of the best of several reports."""
    found: dict[str, Any] = {}
    if where.get("time_s"):
        true = [tuple(pair) for pair in where["time_s"]]
        times = [[tuple(pair) for pair in w.get("time_s") or ()] for w in told]
        best = max(times, key=lambda t: interval_iou(true, t), default=[])
        found = {"end_errors_s": end_errors(true, best), "window_iou": interval_iou(true, best)}
    if where.get("region"):
        found["region_iou"] = max((region_iou(where["region"], w.get("region") or ()) for w in told), default=0.0)
    return found
