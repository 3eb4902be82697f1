"""What changed in a robot of a fleet since an earlier time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from torchrbd.comparison.inertia import inertial_differences
from torchrbd.comparison.reading import PARAMETERS
from torchrbd.comparison.results import CERTAIN, LEAST_CHANGED, Difference, difference
from torchrbd.errors import InputError
from torchrbd.fleet.reading import read_member
from torchrbd.fleet.results import Member


def since_earlier(folder: Path, after: Member) -> tuple[dict[str, Difference] | None, str, str]:
    """Return the parameters that certainly changed (None where nothing was compared), a reason, and a detail of it.

    The reason is "unknown" (no earlier results), "unreadable" (the error), "other robot" (its name), "other bodies" or
    "none identified" (inertial parameters are not compared), either with ", no term" where no term is in both. It is
    "" if all was compared.
    """
    if not (folder / PARAMETERS).is_file():
        return None, "unknown", ""
    try:
        before = read_member(folder, after.name)
    except InputError as error:
        return None, "unreadable", str(error)
    if before.robot != after.robot:
        return None, "other robot", before.robot
    inertial, shared = inertial_differences(before.inertia, after.inertia), before.terms.keys() & after.terms.keys()
    why = "" if inertial else "other bodies" if inertial is None else "none identified"
    if why and not shared:
        return None, f"{why}, no term", ""
    return _changes(before, after, inertial or {}, shared), why, ""


def _changes(
    before: Member, after: Member, inertial: Mapping[str, Difference], shared: Iterable[str]
) -> dict[str, Difference]:
    """Return what changed for certain, see ``changes/results.py`` for the probability, the clearest first."""
    found = {name: d for name, d in inertial.items() if d.probability >= CERTAIN}
    if len(found) < LEAST_CHANGED:
        found = {}
    for name in shared:
        one, other = before.terms[name], after.terms[name]
        d = difference(one, other, max(abs(one.value), abs(other.value)), among=len(after.terms))
        if d.probability >= CERTAIN:
            found[name] = d
    return dict(sorted(found.items(), key=lambda item: -abs(item[1].difference / item[1].std)))
