"""Springs that encoders behind the gear show, as findings: one each, whether or not the torque shows them too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from torchrbd.diagnosis.results import Curve, Deflection, Finding, Where, strongest_first
from torchrbd.effects import effect


def with_springs(findings: Sequence[Finding], measured: Sequence[Deflection]) -> tuple[Finding, ...]:
    """Return findings in the torque and springs that the deflection shows, strongest first.

    A spring that the torque shows too keeps its place there, with the stiffness of the deflection.
    """
    springs = {d.joint: d for d in measured if d.stiffness is not None}
    found = []
    for finding in findings:
        spring = springs.pop(finding.joints[0], None) if effect(finding.effect).is_gear_spring else None
        found.append(finding if spring is None else _merged(finding, spring))
    found += [_finding(spring) for spring in springs.values()]
    return strongest_first(found)


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
        curve=_curve(spring),
        deflection=spring,
    )


def _merged(finding: Finding, spring: Deflection) -> Finding:
    assert spring.stiffness is not None
    return replace(
        finding,
        probability=max(finding.probability, spring.probability),
        log_evidence_gain=finding.log_evidence_gain + spring.log_evidence_gain,
        parameters={"stiffness": spring.stiffness},
        indistinguishable_from=(),
        curve=_curve(spring),
        deflection=spring,
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
