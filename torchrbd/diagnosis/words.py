"""Sentences for a person: numbers as one reads them, findings, verdicts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from torchrbd.diagnosis.results import Alternative, Finding, Quantity, Unexplained
from torchrbd.inference.results import Fit
from torchrbd.physics import effect, effects

MINUS = "\N{MINUS SIGN}"
# Findings less probable than this stay out of the verdict's sentence.
LIKELY = 0.5


def number(value: float) -> str:
    """Return three significant digits, or a dash where there is no number."""
    if not math.isfinite(value):
        return "–"
    if value == 0 or 1e-4 <= abs(value) < 1e3:
        return (f"{value:#.3g}" if value else "0").rstrip(".").replace("-", MINUS)
    if 1e3 <= abs(value) < 1e6:
        return f"{value:.0f}".replace("-", MINUS)
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}·{power_of_ten(int(exponent))}".replace("-", MINUS)


def power_of_ten(exponent: int) -> str:
    """Return e.g. "10⁻⁵"."""
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def interval(q: Quantity) -> str:
    """Return the 95 % interval of a quantity with its unit."""
    return f"{number(q.value - 1.96 * q.std)} to {number(q.value + 1.96 * q.std)} {q.unit}"


def percent(part: float) -> str:
    """Return a part of one in per cent, two significant digits."""
    return f"{100 * part:.2g} %" if part < 0.995 else f"{100 * part:.0f} %"


def joined(words: Iterable[str], last: str = "and") -> str:
    """Return "a, b and c", every word once."""
    *first, end = dict.fromkeys(words)
    return f"{', '.join(first)} {last} {end}" if first else end


def words_of(identifier: str) -> str:
    """Return an effect's name in words, whether or not it is registered here."""
    return effect(identifier).words if identifier in effects() else identifier.replace("_", " ")


def finding_sentence(
    identifier: str,
    joint: str,
    quantities: Mapping[str, Quantity],
    before: Mapping[str, float],
    after: Mapping[str, float],
    alike: Sequence[Alternative],
) -> str:
    """Say what was found, how large it is, what it is worth on held-out time, and what else it could be."""
    values = (
        f"{name.replace('_', ' ')} {number(q.value)} (95 %: {interval(q)}"
        + (f"; the URDF says {number(q.urdf)})" if q.urdf else ")")
        for name, q in quantities.items()
    )
    sentence = f"{joint}: {words_of(identifier)}, {', '.join(values)}."
    if joint in before and joint in after:
        sentence += (
            f" Without it {percent(before[joint])} of the torque variance on held-out time stays unpredicted, "
            f"with it {percent(after[joint])}."
        )
    if alike:
        sentence += f" This data cannot tell it from {joined((words_of(a.effect) for a in alike), 'or')}."
    return sentence


def verdict_statement(
    verdict: str, findings: Sequence[Finding], rest: Sequence[Unexplained], fits: Mapping[str, Fit]
) -> str:
    """Say the verdict in one or two sentences."""
    urdf, rigid, extended = (percent(fits[name].mean_nmse) for name in ("urdf", "rigid_body", "extended"))
    open_end = f" Something is left unexplained at {joined(j for u in rest for j in u.joints)}." if rest else ""
    if verdict == "consistent":
        return "The URDF as given explains the recordings: nothing is missing that this data could show."
    if verdict == "parameters":
        return (
            "A rigid body explains the recordings, but not with the URDF's inertial parameters. "
            f"Re-fitted ones lower the unpredicted part of the torque variance on held-out time from {urdf} to {rigid}."
        )
    if verdict == "unexplained":
        return f"No known effect explains what the rigid body leaves.{open_end}"
    likely = [f for f in findings if f.probability > LIKELY] or findings
    missing = _places(f for f in likely if not any(q.urdf for q in f.parameters.values()))
    wrong = _places(f for f in likely if any(q.urdf for q in f.parameters.values()))
    named = " and ".join(filter(None, (missing and f"leaves out {missing}", wrong and f"has the wrong {wrong}")))
    return (
        f"The URDF {named}. The unpredicted part of the torque variance on held-out time is {urdf} with the URDF, "
        f"{rigid} with a re-fitted rigid body and {extended} with what was found.{open_end}"
    )


def _places(findings: Iterable[Finding]) -> str:
    """Return e.g. "Coulomb friction at joint1 and joint2 and joint spring at joint3", or nothing."""
    by_effect: dict[str, list[str]] = {}
    for finding in findings:
        by_effect.setdefault(words_of(finding.effect), []).extend(finding.joints)
    places = [f"{words} at {joined(joints)}" for words, joints in by_effect.items()]
    return joined(places) if places else ""
