"""What was found as surely as anything else, and held-out time does not need."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from torchrbd.diagnosis.decisions import NO_CHANGE
from torchrbd.diagnosis.extending import Extended
from torchrbd.diagnosis.results import Finding
from torchrbd.likelihood.columns import Candidate

# Parts of a joint's torque, and of its held-out error, that are nobody's business.
LEAST_TORQUE, _LEAST_SHARE = 0.01, 0.1


def split_negligible(
    told: Sequence[tuple[Candidate, Finding]],
    error_without: Callable[[Sequence[Candidate]], Mapping[str, float]],
    trifling: Callable[[Candidate, Finding], bool],
) -> tuple[list[tuple[Candidate, Finding]], list[tuple[Candidate, Finding]]]:
    """Set findings apart, one after the other, that held-out time does not need.

    First goes what it is told best without, all joints taken together; of what is alike in that, the least likely, so
    that of two findings that stand in for each other one stays. What other joints need, whose bodies and friction are
    fitted beside it, stays: without it all of them are told worse than they have been.

    Args:
        told: terms and what is told of them; their errors are given here.
        error_without: nmse by joint of the model without some terms.
        trifling: says whether a term is, of what is told of it, with its errors with it and without it.

    Returns:
        Those that count, their errors beside all others that do, and those that are set apart, the first of them first.
    """
    kept, apart, after = list(told), list[tuple[Candidate, Finding]](), error_without([])
    least = math.fsum(after.values())
    while True:
        gone, may_go = [term for term, _ in apart], dict[int, float]()
        for k, (term, one) in enumerate(kept):
            before = error_without([*gone, term])
            one = with_errors(term, one, before, after)
            kept[k], total = (term, one), math.fsum(before.values())
            if trifling(term, one) and least >= (1.0 - NO_CHANGE) * total:
                may_go[k] = total
        if not may_go:
            return kept, apart
        most = min(may_go.values()) / (1.0 - NO_CHANGE)
        first = min((k for k, total in may_go.items() if total <= most), key=lambda k: kept[k][1].log_evidence_gain)
        apart.append(kept.pop(first))
        after, least = error_without([term for term, _ in apart]), min(least, may_go[first])


def with_errors(term: Candidate, one: Finding, before: Mapping[str, float], after: Mapping[str, float]) -> Finding:
    """Return a finding with the nmse by joint of the model without its term, and with it, where the term acts."""
    touched = [name for name in (one.joints if term.place is not None else after) if name in before and name in after]
    return replace(one, nmse_before={j: before[j] for j in touched}, nmse_after={j: after[j] for j in touched})


def is_negligible(finding: Finding, extended: Extended) -> bool:
    """Say whether held-out time does not show a finding, or hardly, and it carries next to none of its joint's torque.

    Other inertial parameters, or other friction, do as well then. One joint that it is shown at is enough, unless all
    that it acts on together are told worse with it. Of what acts for a time only, or in some recordings, held-out time
    may have seen nothing; but then it changes nothing there.
    """
    if contradicted(finding) or (finding.share < NO_CHANGE and finding.where.recordings is None):
        return True
    torque = extended.prepared.training.torque.sum(0)
    rms = dict(zip(extended.prepared.robot.joint_names, (torque[:, 2] / torque[:, 0]).sqrt().tolist(), strict=True))
    own = {joint: x for joint, x in finding.torque_rms.items() if joint in finding.joints} or finding.torque_rms
    small = all(carried < LEAST_TORQUE * rms[joint] for joint, carried in own.items())
    return small and finding.share < _LEAST_SHARE


def contradicted(finding: Finding) -> bool:
    """Say whether held-out time is told worse with it, all joints that it acts on together."""
    return finding.share_of_all < -NO_CHANGE
