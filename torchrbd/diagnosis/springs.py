"""Springs that encoders behind the gear show, as findings: told once, whether or not the torque shows them too."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from torchrbd.diagnosis.numbers import measure, number, percent, with_unit
from torchrbd.diagnosis.results import Curve, Deflection, Finding, Quantity, Where
from torchrbd.diagnosis.words import strongest_first, value

# Standard deviations from which on a delay or a lost motion is told of, and the shortest delay [s].
_TOLD, _LEAST_DELAY_S = 3.0, 1e-4
# A part of the unpredicted variance that held-out time does not tell from all of it.
_BETTER = 0.98
# Part of the load from which on its being inertia is told of.
_INERTIAL = 0.5


def with_springs(findings: Sequence[Finding], measured: Sequence[Deflection]) -> tuple[Finding, ...]:
    """Return findings in the torque and springs that the deflection shows, strongest first.

    A spring that the torque shows too keeps its place there, with the stiffness that the deflection tells.
    """
    springs = {d.joint: d for d in measured if d.stiffness is not None}
    found = []
    for finding in findings:
        spring = springs.pop(finding.joints[0], None) if finding.effect == "joint_elasticity" else None
        found.append(finding if spring is None else _merged(finding, spring))
    found += [_finding(spring) for spring in springs.values()]
    return strongest_first(found)


def spring_sentence(found: Deflection) -> str:
    """Say what the encoder behind one joint's gear shows."""
    length = found.lost_motion.unit
    if found.stiffness is None:
        least = with_unit(number(found.stiffness_at_least), f"N m/{length}" if length == "rad" else "N/m")
        words = f"{found.joint}: the encoder behind the gear shows no elasticity; it is stiffer than {least} (95 %)."
    else:
        words = (
            f"{found.joint}: joint elasticity, stiffness {value(found.stiffness)} (± 95 %): what lies between the "
            "encoders before and behind the gear follows the load."
        )
        before, after = percent(found.nmse_before), percent(found.nmse_after)
        if found.nmse_after < _BETTER * found.nmse_before:
            words += f" Without it {before} of its variance on held-out time stays unpredicted, with it {after}."
        elif math.isfinite(found.nmse_before):
            words += f" Held-out time does not show it: {before} of its variance stays unpredicted, with it {after}."
    if found.stiffness is not None and found.inertial_share > _INERTIAL:
        words += (
            f" {percent(found.inertial_share)} of the load is inertia about this joint; what of that is the rotor's "
            "winds no spring, which would be softer then."
        )
    if _told(found.delay) and abs(found.delay.value) > _LEAST_DELAY_S:
        order = "after" if found.delay.value > 0 else "before"
        ms = measure(1e3 * abs(found.delay.value), 1.96e3 * found.delay.std)
        words += f" The encoder behind the gear is read {ms} ms {order} the other."
    if _told(found.lost_motion) and found.lost_motion.value > 0:
        words += f" At reversals the link stays behind by {_small(found.lost_motion)}: its friction, or play."
    return words


def _told(q: Quantity) -> bool:
    return abs(q.value) > _TOLD * q.std


def _small(q: Quantity) -> str:
    """Return a length with its interval in thousandths of its unit."""
    return with_unit(measure(1e3 * q.value, 1.96e3 * q.std), f"m{q.unit}")


def _finding(spring: Deflection) -> Finding:
    assert spring.stiffness is not None
    return Finding(
        effect="joint_elasticity",
        joints=(spring.joint,),
        links=(),
        probability=spring.probability,
        log_evidence_gain=spring.log_evidence_gain,
        parameters={"stiffness": spring.stiffness},
        where=Where(),
        indistinguishable_from=(),
        nmse_before={},
        nmse_after={},
        statement=f"{spring_sentence(spring)} The torque alone does not show it.",
        curve=_curve(spring),
    )


def _merged(finding: Finding, spring: Deflection) -> Finding:
    assert spring.stiffness is not None
    return replace(
        finding,
        probability=max(finding.probability, spring.probability),
        log_evidence_gain=finding.log_evidence_gain + spring.log_evidence_gain,
        parameters={"stiffness": spring.stiffness},
        indistinguishable_from=(),
        statement=f"{spring_sentence(spring)} The torque shows it too.",
        curve=_curve(spring),
    )


def _curve(spring: Deflection) -> Curve:
    """Return the torque of the spring over its deflection; at a given load, the deflection is what is uncertain."""
    assert spring.stiffness is not None
    k, std = spring.stiffness.value, spring.stiffness.std
    low, high = min(spring.load), max(spring.load)
    torque = tuple(low + (high - low) * i / 20 for i in range(21))
    return Curve(
        f"deflection_{spring.joint}", tuple(t / k for t in torque), torque, tuple(abs(t) * std / k for t in torque)
    )
