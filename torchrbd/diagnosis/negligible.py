"""Findings that are as certain as others but that held-out data does not confirm."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.final_model import FinalModel
from torchrbd.diagnosis.results import Finding


def split_negligible(
    found: Sequence[tuple[Candidate, Finding]],
    error_without: Callable[[Sequence[Candidate]], Mapping[str, float]],
    negligible: Callable[[Candidate, Finding], bool],
) -> tuple[list[tuple[Candidate, Finding]], list[tuple[Candidate, Finding]]]:
    """Remove findings, one after the other, that held-out data does not need.

    The first to go is the one without which held-out data is predicted best, all joints together. If several are alike
    in that, the least likely goes: of two findings that are proxies for each other, one stays. A finding stays if other
    joints, whose bodies and friction are fitted with it, are predicted worse without it than before.

    Args:
        found: terms and their findings; the errors of these are filled in here.
        error_without: nmse by joint of the model without some terms.
        negligible: says whether a term is, from its finding, with the errors with it and without it.

    Returns:
        Those that count, with errors given all others that count; and those that were removed, in that order.
    """
    kept, apart, after = list(found), list[tuple[Candidate, Finding]](), error_without([])
    least = math.fsum(after.values())
    while True:
        gone, may_go = [term for term, _ in apart], dict[int, float]()
        for k, (term, one) in enumerate(kept):
            before = error_without([*gone, term])
            one = with_errors(term, one, before, after)
            kept[k], total = (term, one), math.fsum(before.values())
            if negligible(term, one) and least >= (1.0 - DECISIONS.no_change) * total:
                may_go[k] = total
        if not may_go:
            return kept, apart
        most = min(may_go.values()) / (1.0 - DECISIONS.no_change)
        first = min((k for k, total in may_go.items() if total <= most), key=lambda k: kept[k][1].log_evidence_gain)
        apart.append(kept.pop(first))
        after, least = error_without([term for term, _ in apart]), min(least, may_go[first])


def with_errors(term: Candidate, one: Finding, before: Mapping[str, float], after: Mapping[str, float]) -> Finding:
    """Return a finding with the nmse by joint of the model without its term, and with it, where the term acts."""
    touched = [name for name in (one.joints if term.place is not None else after) if name in before and name in after]
    return replace(one, nmse_before={j: before[j] for j in touched}, nmse_after={j: after[j] for j in touched})


def is_negligible(finding: Finding, extended: FinalModel) -> bool:
    """Say whether held-out data hardly shows a finding, and the finding carries next to no torque of its joint.

    Other inertial parameters, or other friction, explain the data as well then. It counts if one joint shows it, unless
    all its joints together are predicted worse with it. Held-out data may hold nothing of what acts for a time, or in
    some recordings; it changes nothing there then.
    """
    if contradicted(finding) or (finding.share < DECISIONS.no_change and finding.where.recordings is None):
        return True
    torque = extended.prepared.training.torque.sum(0)
    rms = dict(zip(extended.prepared.robot.joint_names, (torque[:, 2] / torque[:, 0]).sqrt().tolist(), strict=True))
    own = {joint: x for joint, x in finding.torque_rms.items() if joint in finding.joints} or finding.torque_rms
    small = all(carried < DECISIONS.negligible_torque * rms[joint] for joint, carried in own.items())
    return small and finding.share < DECISIONS.negligible_error


def contradicted(finding: Finding) -> bool:
    """Say whether held-out data is predicted worse with it, all joints that it acts on together."""
    return finding.share_of_all < -DECISIONS.no_change
