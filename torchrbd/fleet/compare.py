"""Compare the robots of a fleet with each other, and each with itself at an earlier time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from torchrbd.comparison.inertia import load_like
from torchrbd.errors import InputError
from torchrbd.fleet.earlier import since_earlier
from torchrbd.fleet.reading import read_member
from torchrbd.fleet.results import UNFINISHED, FleetComparison, Member, MemberResult
from torchrbd.fleet.sisters import deviations, median_inertia, sisters


def compare_fleet(
    folder: str | Path,
    names: Sequence[str],
    *,
    before: str | Path | None = None,
    failed: Mapping[str, str] | None = None,
    left: Sequence[str] = (),
) -> FleetComparison:
    """Say who differs from its sisters, and what changed.

    A robot whose results cannot be read counts as one that could not be identified.

    Args:
        folder: of the fleet; ``<name>/parameters.json`` is read.
        names: of the robots.
        before: folder of the same fleet at an earlier time; robots of the same name are compared.
        failed: by name why a robot could not be identified.
        left: names of robots that an interrupt has left; they are not compared.
    """
    failed, members = dict(failed or {}), []
    for name in names:
        if name not in failed and name not in left:
            try:
                members.append(read_member(Path(folder) / name, name))
            except InputError as error:
                failed[name] = str(InputError(f"{error} (remove {Path(folder) / name} to have it identified again)"))
    found = {
        name: MemberResult(name, verdict, math.nan, why, 0, (), None, None, ())
        for verdict, reasons in (("failed", failed), (UNFINISHED, dict.fromkeys(left, "")))
        for name, why in reasons.items()
    }
    for group in sisters(members):
        found |= {one.name: one for one in _compared(group, None if before is None else Path(before))}
    ordered = tuple(found[name] for name in names)
    return FleetComparison(ordered, "" if before is None else str(before))


def _compared(group: Sequence[Member], before: Path | None) -> Iterator[MemberResult]:
    """Compare sisters with each other, and each with what ``before`` has of it."""
    off = deviations(group)
    odd = {name for name, own in off.items() if any(d.kind == "inertia" for d in own)}
    median = median_inertia(group) if odd else None
    for one in group:
        load = load_like(median, one.inertia, one.bodies) if one.name in odd else None
        changes, why, detail = (None, "", "") if before is None else since_earlier(before / one.name, one)
        off_here = tuple(off[one.name])
        yield MemberResult(
            one.name, one.verdict, one.nmse, "", len(group), off_here, load, changes, one.doubts, why, detail
        )
