"""Compare the robots of a fleet with each other, and each with itself at an earlier time."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from torchrbd.diagnosis.changes.inertia import inertial_differences, load_like
from torchrbd.diagnosis.changes.reading import Inertia, Side, read_inertia
from torchrbd.diagnosis.changes.results import CERTAIN, LEAST_CHANGED, Difference, difference
from torchrbd.diagnosis.fleet import words
from torchrbd.diagnosis.fleet.results import FleetComparison, Member, MemberResult
from torchrbd.diagnosis.fleet.sisters import LEAST_SISTERS, deviations, median_inertia, sisters
from torchrbd.diagnosis.results import Quantity
from torchrbd.errors import InputError

_FILE = "parameters.json"


def compare_fleet(
    folder: str | Path,
    names: Sequence[str],
    *,
    before: str | Path | None = None,
    failed: Mapping[str, str] | None = None,
) -> FleetComparison:
    """Say who differs from its sisters, and what changed.

    Args:
        folder: of the fleet; ``<name>/parameters.json`` is read.
        names: of the robots.
        before: folder of the same fleet at an earlier time; robots of the same name are compared.
        failed: by name why a robot could not be identified.

    Raises:
        InputError: a file that cannot be used.
    """
    failed, folder = failed or {}, Path(folder)
    members = [read_member(folder / name, name) for name in names if name not in failed]
    found = {
        name: MemberResult(name, "failed", math.nan, why, 0, (), None, None, why, ()) for name, why in failed.items()
    }
    for group in sisters(members):
        off = deviations(group)
        odd = {name for name, own in off.items() if any(d.kind == "inertia" for d in own)}
        median = median_inertia(group) if odd else None
        for one in group:
            load = load_like(_side(one, median), _side(one)) if one.name in odd else None
            earlier = None if before is None else _earlier(Path(before), one)
            changes = None if earlier is None else _changes(earlier, one)
            statement = words.of_member(off[one.name], load, changes, len(group), LEAST_SISTERS, before is not None)
            found[one.name] = MemberResult(
                one.name, one.verdict, one.nmse, "", len(group), tuple(off[one.name]), load, changes, statement,
                one.doubts,
            )  # fmt: skip
    ordered = tuple(found[name] for name in names)
    return FleetComparison(ordered, "" if before is None else str(before), words.of_fleet(ordered))


def read_member(folder: Path, name: str) -> Member:
    """Read what ``identify`` has left of one robot.

    Raises:
        InputError: no such file, or one without intervals.
    """
    file = folder / _FILE
    inertia, bodies = read_inertia(file)
    if inertia is None:
        raise InputError(f"{file}: is missing or has no intervals, which a comparison needs; identify '{name}' again")
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        terms = {
            str(p["name"]): Quantity(_number(p["value"]), _number(p["std"]), str(p["unit"]))
            for p in content["parameters"]
            if p["status"] == "term"
        }
        errors = [_number(value) for value in list(content["fit"].values())[-1]["nmse"].values()]
        known = [value for value in errors if math.isfinite(value)]
        words = str(content["robot"]), str(content["verdict"])
        doubts = tuple(map(str, content.get("doubts", ())))
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(
            f"{file}: is no parameters.json as 'torchrbd fleet' writes it ({type(error).__name__}: {error}); remove "
            f"the folder and identify '{name}' again"
        ) from None
    nmse = sum(known) / len(known) if known else math.nan
    return Member(name, *words, nmse, inertia, bodies, terms, doubts)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _earlier(before: Path, one: Member) -> Member | None:
    return read_member(before / one.name, one.name) if (before / one.name / _FILE).is_file() else None


def _changes(before: Member, after: Member) -> dict[str, Difference]:
    """Return the parameters that changed for certain, see ``changes/results.py`` for the probability."""
    inertial = inertial_differences(_side(before), _side(after)) or {}
    found = {name: d for name, d in inertial.items() if d.probability >= CERTAIN}
    if len(found) < LEAST_CHANGED:
        found = {}
    for name in before.terms.keys() & after.terms.keys():
        one, other = before.terms[name], after.terms[name]
        d = difference(one, other, max(abs(one.value), abs(other.value)), among=len(after.terms))
        if d.probability >= CERTAIN:
            found[name] = d
    return dict(sorted(found.items(), key=lambda item: -abs(item[1].difference / item[1].std)))


def _side(one: Member, inertia: Inertia | None = None) -> Side:
    """Return one of the two that are compared, with the base parameters of another robot if they are given."""
    return Side(one.name, one.robot, (), (), math.nan, (), (), (), (), inertia or one.inertia, one.bodies)
