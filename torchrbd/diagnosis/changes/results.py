"""What a comparison of two diagnoses returns, and how sure a difference is.

A parameter differs by d, known with a standard deviation s. Either nothing happened to it (its true difference is
N(0, trifle^2), with a trifle of 2 % of its size v) or something did (N(0, (0.3 v)^2)), each as likely beforehand:

    p = 1 / (1 + o),   o = N(d; 0, s^2 + (0.02 v)^2) / N(d; 0, s^2 + (0.3 v)^2)

so that p is about one half where the data are too poor to tell, and goes to 0 where they show that nothing changed.
Values of an effect say something only as far as the effect is the right one: with the probabilities P of the findings,
the probability of a change is P_before P_after p + (1 - P_before P_after) / 2.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

from torchrbd.diagnosis.results import Alternative, Quantity, Where
from torchrbd.display import Remark, Stated, brief, few

# Parts of a parameter's size: what is no change, and how large changes are.
NEGLIGIBLE, CHANGE = 0.02, 0.3
# A combination of inertial parameters is as large as all bodies in it; a load that matters is a small part of that.
NEGLIGIBLE_INERTIA = 0.005
# An effect that one data set has and the other lacks moves what else there is at the joint. Over 12 robots diagnosed
# from two recordings each (null tier of the concealed benchmark), 11 of 40 such parameters differed by more than 3 std,
# at most by 10, and 2 of 89 where the effects were the same.
WIDER = 4.0
# A limit stands beside other effects and may have another shape.
LOOSER = 2.0
# What nobody can tell has this probability.
UNKNOWN = 0.5
# Probabilities from which on a parameter has changed, and up to which it has not.
CERTAIN, UNLIKELY = 0.95, 0.2
# One or two combinations alone stood out in 3 of 38 pairs of recordings of one robot: a body that changes moves more.
LEAST_CHANGED = 3

Kind = Literal["finding", "inertia", "unexplained"]
Verdict = Literal["changed", "unchanged", "open"]
Found = Literal["both", "before", "after"]


@dataclass(frozen=True)
class Load:
    """A mass [kg] that would make a change, on one of some links that are as good, with its std."""

    links: tuple[str, ...]
    mass: float
    std: float


@dataclass(frozen=True)
class Difference:
    """A parameter of two diagnoses.

    Attributes:
        before, after: None where nothing is known of it.
        difference, std: after less before, and its standard deviation: ``WIDER`` where the joint has other effects in
            one than in the other, ``LOOSER`` where one has not found it.
        probability: that it changed by more than a trifle; NaN where one is not known.
    """

    before: Quantity | None
    after: Quantity | None
    difference: float
    std: float
    probability: float


@dataclass(frozen=True)
class Change(Stated):
    """What became of one thing that either diagnosis has.

    Attributes:
        kind: "finding", "inertia" (inertial parameters), or "unexplained".
        effect: of a finding; empty for the others.
        joints, links: where.
        depends_on: signals of other joints that it depends on.
        found: "both", or "before" or "after" if one diagnosis alone has it.
        verdict: "changed" and "unchanged" are certain, "open" is what the data cannot tell.
        probability: that it changed, the largest of its parameters'; NaN where nobody knows.
        parameters: by name.
        where: recordings and times of a finding.
        reason: why the other data say nothing of it: "window" (it acts in a window of time), "no limit", "other shape"
            (their detection limit is unknown, or of another shape); else empty.
        rivals: effects of the other diagnosis that may be other names for it.
        load: that would explain what changed in the rigid body.
    """

    kind: Kind
    effect: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    depends_on: tuple[str, ...]
    found: Literal["both", "before", "after"]
    verdict: Verdict
    probability: float
    parameters: dict[str, Difference]
    where: Where = field(default_factory=Where)
    reason: str = ""
    rivals: tuple[Alternative, ...] = ()
    load: Load | None = None


@dataclass(frozen=True)
class Comparison(Stated):
    """What changed between two diagnoses of one robot, the most certain first.

    Attributes:
        robot, joints: the robot.
        before, after: names of the diagnoses.
        changes: of what either has.
        notes: what else to know of the two.
    """

    robot: str
    joints: tuple[str, ...]
    before: str
    after: str
    changes: tuple[Change, ...]
    notes: tuple[Remark, ...] = ()

    def __repr__(self) -> str:
        changed = [
            f"{one.effect or one.kind} at {', '.join((*one.joints, *one.links)) or 'whole robot'}"
            for one in self.changes
            if one.verdict == "changed"
        ]
        unsure = sum(one.verdict == "open" for one in self.changes)
        return brief(self, robot=self.robot, before=self.before, after=self.after, changed=few(changed), open=unsure)


def difference(
    before: Quantity,
    after: Quantity,
    size: float,
    *,
    right: float = 1.0,
    wider: float = 1.0,
    negligible: float = NEGLIGIBLE,
    among: int = 1,
) -> Difference:
    """Return a parameter's difference and the probability that it changed.

    Args:
        before, after: what the two say of it.
        size: of the parameter, in whose parts changes are counted.
        right: probability that it is this parameter that there is in both.
        wider: how many times the standard deviation is what it seems.
        trifle: what is no change, in parts of the size.
        among: how many parameters there are any one of which may have changed.
    """
    d, std = after.value - before.value, wider * math.hypot(before.std, after.std)
    p = right * probability_of_change(d, std, size, negligible, among) + (1.0 - right) * UNKNOWN
    return Difference(before, after, d, std, p)


def probability_of_change(d: float, std: float, size: float, negligible: float = NEGLIGIBLE, among: int = 1) -> float:
    """Return the probability p of a change by d; NaN without a standard deviation."""
    if not (math.isfinite(d) and math.isfinite(std) and std > 0):
        return math.nan
    same, changed = std**2 + (negligible * size) ** 2, std**2 + (CHANGE * size) ** 2
    log_odds = 0.5 * math.log(changed / same) - 0.5 * d**2 * (1.0 / same - 1.0 / changed) + math.log(among)
    return 1.0 / (1.0 + math.exp(min(log_odds, 50.0)))


def verdict_of(probability: float) -> Verdict:
    """Return what a probability of change says."""
    return "changed" if probability >= CERTAIN else "unchanged" if probability <= UNLIKELY else "open"


def most(parameters: Iterable[Difference]) -> float:
    """Return the largest probability of a change; NaN where nobody knows one."""
    return max((d.probability for d in parameters if not math.isnan(d.probability)), default=math.nan)
