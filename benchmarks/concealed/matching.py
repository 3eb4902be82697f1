"""Say of every finding which concealed effect it names: exactly, in its class, or none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

Json = Mapping[str, Any]
Kind = Literal["exact", "class", "background", "companion", "false"]

# Effects that contain another one as a special case: where they are found, the other one is not missing.
CONTAINS: Mapping[str, frozenset[str]] = {
    "asymmetric_coulomb_friction": frozenset({"coulomb_friction"}),
    "stribeck_friction": frozenset({"coulomb_friction", "asymmetric_coulomb_friction"}),
    "time_varying_friction": frozenset({"coulomb_friction", "asymmetric_coulomb_friction"}),
    "position_dependent_friction": frozenset({"coulomb_friction", "asymmetric_coulomb_friction"}),
    "presliding_hysteresis": frozenset({"coulomb_friction", "asymmetric_coulomb_friction"}),
    "power_law_friction": frozenset({"viscous_friction"}),
    "thermal_viscosity": frozenset({"viscous_friction"}),
}
# c+ and c- for the two directions are their mean and an offset: whoever finds these two has found the friction.
PARTS: Mapping[str, frozenset[str]] = {
    "asymmetric_coulomb_friction": frozenset({"coulomb_friction", "torque_offset"}),
    # Viscosity that changes with temperature is some viscosity at the mean temperature.
    "thermal_viscosity": frozenset({"viscous_friction"}),
}
RIGID_BODY = "rigid_body"


@dataclass(frozen=True)
class Judgement:
    """What a finding is; ``effect`` counts the truth's effects where it names one of them."""

    kind: Kind
    effect: int | None = None

    @property
    def right(self) -> bool:
        """Return whether what the finding says is true of the robot."""
        return self.kind != "false"


def same_place(named: Json, true: Json, joints: Sequence[str]) -> bool:
    """Say whether joints and links agree.

    Args:
        named: a finding or an alternative.
        true: a concealed effect; joints or links that it does not name do not matter.
        joints: all of the robot; an effect of all of them may be named without any.
    """
    own, told = set(true.get("joints") or ()), set(named.get("joints") or ())
    whole = own == set(joints) and not told
    links = set(true.get("links") or ())
    return (not own or own == told or whole) and (not links or links == set(named.get("links") or ()))


def relation(finding: Json, true: Json, joints: Sequence[str]) -> Literal["exact", "class"] | None:
    """Say how a finding names a concealed effect, if it does."""
    if finding["effect"] == true["effect"]:
        if same_place(finding, true, joints):
            return "exact"
        if set(finding.get("joints") or ()) & set(true.get("joints") or ()) and set(true["joints"]) == set(joints):
            return "class"
    told = [a for a in finding.get("indistinguishable_from", ()) if a["effect"] == true["effect"]]
    known = [a for a in true.get("indistinguishable", ()) if a["effect"] == finding["effect"]]
    if any(same_place(a, true, joints) for a in told) or any(same_place(finding, a, joints) for a in known):
        return "class"
    return None


def judge(findings: Sequence[Json], truth: Json) -> list[Judgement]:
    """Judge every finding; each concealed effect is given to one of them, exact before in class, then by probability.

    Args:
        findings: of diagnosis.json.
        truth: contents of the truth file.
    """
    joints, effects = truth["robot"]["joints"], truth["effects"]
    pairs = sorted(
        (how != "exact", -float(f["probability"]), number, k)
        for number, f in enumerate(findings)
        for k, e in enumerate(effects)
        if (how := relation(f, e, joints)) is not None
    )
    given: dict[int, Judgement] = {}
    for inexact, _, number, k in pairs:
        if number not in given and k not in {j.effect for j in given.values()}:
            given[number] = Judgement("class" if inexact else "exact", k)
    return [given.get(number) or _beside(f, truth) for number, f in enumerate(findings)]


def _beside(finding: Json, truth: Json) -> Judgement:
    """Judge a finding that names no concealed effect."""
    joints = truth["robot"]["joints"]
    for kind in ("background", "companions"):
        for e in truth.get(kind, ()):
            if _is_part(finding, e, joints) or relation(finding, e, joints) is not None:
                return Judgement("background" if kind == "background" else "companion")
    parts = any(_is_part(finding, e, joints) for e in truth["effects"])
    return Judgement("companion" if parts else "false")


def _is_part(finding: Json, true: Json, joints: Sequence[str]) -> bool:
    return finding["effect"] in PARTS.get(true["effect"], ()) and same_place(finding, true, joints)


def covers(findings: Sequence[Json], true: Json, joints: Sequence[str]) -> bool:
    """Say whether findings hold a background effect: itself, a part of it, or an effect that contains it."""
    return any(
        relation(f, true, joints) is not None
        or (
            same_place(f, true, joints)
            and (true["effect"] in CONTAINS.get(f["effect"], ()) or f["effect"] in PARTS.get(true["effect"], ()))
            and f["effect"] != "torque_offset"
        )
        for f in findings
    )


def new_findings(findings: Sequence[Json], baseline: Sequence[Json]) -> list[Json]:
    """Return the findings that a diagnosis of the untouched recordings does not have.

    A finding is old if the baseline has it, lists it as indistinguishable, or has one that contains it or is contained.
    """

    def old(f: Json) -> bool:
        for b in baseline:
            at_place = set(f["joints"]) == set(b["joints"]) and set(f["links"]) == set(b["links"])
            nested = b["effect"] in CONTAINS.get(f["effect"], ()) or f["effect"] in CONTAINS.get(b["effect"], ())
            alike = any(
                a["effect"] == f["effect"] and set(a["joints"]) == set(f["joints"])
                for a in b.get("indistinguishable_from", ())
            )
            if alike or (at_place and (f["effect"] == b["effect"] or nested)):
                return True
        return False

    return [f for f in findings if not old(f)]
