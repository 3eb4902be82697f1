"""What was found, how large it is, what it is worth on held-out data, and what else it could be."""

from __future__ import annotations

import math
from dataclasses import astuple

from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.results import HELD_OUT, Deflection, Finding, Quantity, Where
from torchrbd.effects import known_effects
from torchrbd.report.text.names import (
    alternatives,
    at,
    guessed,
    known,
    most_changed,
    parameter_words,
    properties,
    value,
    values,
    when,
    with_article,
)
from torchrbd.report.text.numbers import (
    as_many_as_fit,
    capital,
    joined,
    measure,
    number,
    percent,
    ratio_with_interval,
    with_unit,
)

NOT_CONFIRMED = "Not confirmed on held-out data"
SHARED = "The probability is shared with what it could also be."
CERTAINLY_MISSING = "An effect is certainly missing here."
# Words of a sentence that names what else it could be.
_ALIKE_WORDS = 14


def finding_statement(finding: Finding) -> str:
    """Say what was found, how large it is, what it is worth on held-out data, and what else it could be."""
    if finding.deflection is not None:
        shown = (
            "The torque shows it too." if finding.torque_rms or finding.nmse_before else "The torque does not show it."
        )
        return f"{deflection_statement(finding.deflection)} {shown}"
    more = "It adds to the same effect in all recordings." if finding.adds_to_all else ""
    sizes = _subject(finding), more, _no_size(finding) if finding.confirmed else "", _in_motion(finding)
    worth = _not_confirmed(finding), _worth(finding), _stability(finding)
    parts = (*sizes, *worth, _alike(finding), _variant(finding))
    return " ".join(filter(None, parts))


def _subject(finding: Finding) -> str:
    """Return e.g. "Payload on hand (in load.csv, 2.0 to 8.0 s): mass 1.20 ± 0.10 kg (95 %)."."""
    quantities, where = properties(finding), finding.where
    if any(q.value in (r.low, r.high) for q in quantities.values() for r in where.region or ()):
        where = Where(where.recordings, where.time_s)
    inside, sizes = when(where), values(finding)
    interval = " (95 % intervals)" if any(q.std > 0 for q in quantities.values()) else ""
    words = guessed(finding) + (at(finding.joints, finding.links) or " on the whole robot")
    words += f" ({inside})" if inside else ""
    return capital(words) + (f": {', '.join(sizes)}{interval}." if sizes else ".")


def _no_size(finding: Finding) -> str:
    """Say that nothing that would be zero without it differs from zero; of several correlated numbers, all may."""
    own, sizes = known_effects().get(finding.effect), known(finding)
    whole = own is not None and finding.parameters.keys() >= own.units.keys()
    shape = own.coefficients({name: q.value for name, q in finding.parameters.items()})[1] if own and whole else {}
    free = {name: q for name, q in sizes.items() if name not in shape}
    alone = len(properties(finding)) < 2 or len(free) == 1 < len(sizes)
    if alone or any(abs(q.value) >= 1.96 * q.std for q in free.values()):
        return ""
    if len(free) == len(sizes):
        return "No single parameter differs significantly from zero; together they do."
    names = joined(parameter_words(name) for name in free)
    return f"{capital(names)} do not differ significantly from zero one by one; together they do."


def _in_motion(finding: Finding) -> str:
    """Say what Coulomb friction a joint has whose findings each have a part of it."""
    q = finding.coulomb_in_motion
    if q is None:
        return ""
    return f"All friction laws of {joined(finding.joints)} together: Coulomb friction {value(q)} (95 % interval)."


def _not_confirmed(finding: Finding) -> str:
    """Say why cross-validation does not confirm it, if so."""
    elpd = finding.elpd
    if elpd is None or finding.confirmed:
        return ""
    if elpd.matters or elpd.log_evidence <= 0.0:
        left_out = f"{number(elpd.log_evidence)} nats" if elpd.se > 0.0 else "unknown"
        search = f"{number(finding.log_evidence_gain)} nats in the search"
        return f"Cross-validation does not confirm it: log evidence {left_out} on left-out blocks, {search}."
    share, torque = percent(max(elpd.share, 0.0)), percent(elpd.torque_share)
    return f"It is negligible: {share} of the squared error of left-out blocks, {torque} of the torque."


def _worth(finding: Finding) -> str:
    """Say what it does to the error on held-out data, or on its own time where that has none of it."""
    joint = most_changed(finding)
    absent = "" if finding.judged_on == HELD_OUT else f"{NOT_CONFIRMED}: it does not act there."
    if joint is None:
        return absent and f"{absent} Its own window of time is too short for cross-validation."
    before, after = finding.nmse_before[joint], finding.nmse_after[joint]
    if absent:
        return f"{absent} Cross-validated in its own window, {_moved(f'the NMSE of {joint}', before, after)}"
    if abs(before - after) <= DECISIONS.no_change * max(before, after):
        return f"{NOT_CONFIRMED}: the NMSE of {joint} is {number(after)} with it and without it."
    error = capital(_moved(f"the NMSE of {joint} on held-out data", before, after, "with it"))
    ratio = finding.held_out_ratio
    if ratio is None:
        return error
    part = f"Its torque there is {ratio_with_interval(*astuple(ratio), of='the fitted torque')}."
    return f"{error} {part}" if ratio.low > 0.0 else f"{error} {part} {NOT_CONFIRMED}."


def _moved(subject: str, before: float, after: float, behind: str = "") -> str:
    verb = "falls" if after < before else "rises"
    return " ".join(filter(None, (subject, verb, "from", number(before), "to", number(after), behind))) + "."


def _stability(finding: Finding) -> str:
    """Say how often it is found again, if the search was repeated."""
    share = finding.stability
    return "" if share is None else f"{capital(percent(share))} of the repeated searches find it again."


def _alike(finding: Finding) -> str:
    others = alternatives(finding)
    if not others:
        return ""
    words = as_many_as_fit([*map(with_article, others)], _ALIKE_WORDS, "or", "others")
    return f"This data cannot distinguish it from {words}."


def _variant(finding: Finding) -> str:
    v = finding.variant
    if v is None:
        return ""
    return (
        f"It would be {v.distance:.2g} m from the origin of {v.parent}; the URDF says {v.given:.2g} m. "
        "Is this the URDF of another variant of the robot?"
    )


def deflection_statement(found: Deflection) -> str:
    """Say what the encoder behind one joint's gear shows."""
    length = found.lost_motion.unit
    if found.stiffness is None:
        least = with_unit(number(found.stiffness_at_least), f"N m/{length}" if length == "rad" else "N/m")
        words = f"No elasticity at {found.joint}: the encoder behind the gear shows a stiffness above {least} (95 %)."
    else:
        words = (
            f"Joint elasticity at {found.joint}: stiffness {value(found.stiffness)} (95 % interval). "
            "The difference between the encoders before and behind the gear follows the load."
        )
        before, after = number(found.nmse_before), number(found.nmse_after)
        if found.held_out:
            words += f" The spring lowers the NMSE of that difference on held-out data from {before} to {after}."
        elif math.isfinite(found.nmse_before):
            words += f" {NOT_CONFIRMED}: the NMSE of that difference is {before} without it and {after} with it."
    if found.stiffness is not None and found.inertial_share > DECISIONS.inertial_load:
        words += (
            f" {percent(found.inertial_share)} of the load is inertia about this joint. "
            "If part of that is rotor inertia, the true stiffness is lower."
        )
    if _sure(found.delay) and abs(found.delay.value) > DECISIONS.shortest_delay_s:
        order = "after" if found.delay.value > 0 else "before"
        ms = measure(1e3 * abs(found.delay.value), 1.96e3 * found.delay.std)
        words += f" The encoder behind the gear is read {ms} ms {order} the other."
    if _sure(found.lost_motion) and found.lost_motion.value > 0:
        words += f" At reversals the link lags by {_small(found.lost_motion)}: friction behind the gear, or backlash."
    return words


def _sure(q: Quantity) -> bool:
    return abs(q.value) > DECISIONS.spring_sure * q.std


def _small(q: Quantity) -> str:
    """Return a length with its interval in thousandths of its unit."""
    return with_unit(measure(1e3 * q.value, 1.96e3 * q.std), f"m{q.unit}")
