"""What changed in a robot of a fleet since an earlier time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from torchrbd.diagnosis.changes.inertia import inertial_differences
from torchrbd.diagnosis.changes.reading import PARAMETERS
from torchrbd.diagnosis.changes.results import CERTAIN, LEAST_CHANGED, Difference, difference
from torchrbd.diagnosis.fleet import words
from torchrbd.diagnosis.fleet.reading import read_member
from torchrbd.diagnosis.fleet.results import Member
from torchrbd.errors import InputError


def since_earlier(folder: Path, after: Member) -> tuple[dict[str, Difference] | None, str]:
    """Return the parameters that changed for certain, None where nothing was compared, and the same in words."""
    if not (folder / PARAMETERS).is_file():
        return None, "of the earlier time nothing is known"
    try:
        before = read_member(folder, after.name)
    except InputError as error:
        return None, words.of_changes(None, str(error))
    if before.robot != after.robot:
        return None, words.of_changes(None, f"it was of robot '{before.robot}'")
    inertial, shared = inertial_differences(before.inertia, after.inertia), before.terms.keys() & after.terms.keys()
    why = "" if inertial else words.not_compared(inertial)
    if why and not shared:
        return None, words.of_changes(None, f"{why}, and no term is in both")
    changes = _changes(before, after, inertial or {}, shared)
    return changes, words.of_changes(changes, why)


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
