"""What a diagnosis returns, and how it is written as diagnosis.json."""

from __future__ import annotations

from dataclasses import dataclass, field

from torchrbd.inference.results import Identification


@dataclass(frozen=True)
class Quantity:
    """A parameter of a finding with its posterior standard deviation; ``urdf`` is what the URDF says of it."""

    value: float
    std: float
    unit: str
    urdf: float = 0.0


@dataclass(frozen=True)
class Region:
    """An interval of one signal, e.g. ``q_joint2`` from -0.1 to 0.3 rad."""

    signal: str
    low: float
    high: float


@dataclass(frozen=True)
class Where:
    """Where a mismatch sits; None means everywhere."""

    recordings: tuple[str, ...] | None = None
    time_s: tuple[tuple[float, float], ...] | None = None
    region: tuple[Region, ...] | None = None


@dataclass(frozen=True)
class Alternative:
    """An effect that this data cannot tell from the finding."""

    effect: str
    joints: tuple[str, ...] = ()
    links: tuple[str, ...] = ()


@dataclass(frozen=True)
class Finding:
    """One named effect. ``statement`` is a sentence for a person."""

    effect: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    probability: float
    log_evidence_gain: float
    parameters: dict[str, Quantity]
    where: Where
    indistinguishable_from: tuple[Alternative, ...]
    nmse_before: dict[str, float]
    nmse_after: dict[str, float]
    statement: str


@dataclass(frozen=True)
class Unexplained:
    """What is left at a joint and depends on something, nameless; ``share`` is its part of the leftover's power."""

    joints: tuple[str, ...]
    depends_on: tuple[str, ...]
    where: Where
    share: float
    statement: str


@dataclass(frozen=True)
class Diagnosis:
    """Verdict, findings strongest first, and the identification they belong to.

    ``verdict`` is "consistent" (the URDF as given explains the data), "parameters" (a rigid body with other parameters
    does), "missing_physics" (named effects are needed) or "unexplained" (something is left that no known effect
    explains).
    """

    identification: Identification
    verdict: str
    statement: str
    findings: tuple[Finding, ...]
    unexplained: tuple[Unexplained, ...] = field(default=())
