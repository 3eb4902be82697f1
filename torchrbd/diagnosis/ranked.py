"""What was considered: hypotheses and their evidence, as results."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from torchrbd.display import brief, few
from torchrbd.likelihood.misfit import Misfit


@dataclass(frozen=True)
class Ranked:
    """One hypothesis of a ranking.

    Attributes:
        effect: its id.
        joints, links: where; both empty if it acts on the whole robot.
        log_evidence: against leaving it out, in nats, averaged over shapes, sizes and windows of time.
        parameters: physical ones, by name, SI units.
        other: the joint on whose motion it depends, if that is another one.
        window: recording, from and to [s], where it acts for a time.
        shape: nonlinear parameters.
    """

    effect: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    log_evidence: float
    parameters: dict[str, float]
    other: str | None = None
    window: tuple[str, float, float] | None = None
    shape: dict[str, float] = field(default_factory=dict)

    @property
    def place(self) -> tuple[object, ...]:
        """Effect and place, and when it acts."""
        return self.effect, self.joints, self.links, self.other, self.window


@dataclass(frozen=True)
class Ranking:
    """Hypotheses by their log evidence, best first.

    Attributes:
        band_hz: up to which torques were compared.
        ordinary: baseline friction of each joint: evidence against leaving it out. Where ``misfit`` says that its law
            is wrong, coefficients are those of plain least squares, which predict.
        delay_s: by recording, how much later the torque is than the motion, given what was adopted, and its standard
            deviation.
        first: given a rigid body with baseline friction.
        adopted: those that were taken into the model, one after the other.
        last: given these; the adopted ones among them, each against leaving it out.
        considered: number of effects at their places.
        misfit: by joint, whether whitened rows and plain least squares agree on its friction (Hausman's test).
        evidence_source: what answers ``evidence_of``.
    """

    band_hz: float
    ordinary: tuple[Ranked, ...]
    delay_s: dict[str, tuple[float, float]]
    first: tuple[Ranked, ...]
    adopted: tuple[Ranked, ...]
    last: tuple[Ranked, ...]
    considered: int
    misfit: dict[str, Misfit]
    evidence_source: Callable[..., float] = field(repr=False, compare=False)

    def __repr__(self) -> str:
        best = [
            f"{one.effect} at {', '.join((*one.joints, *one.links)) or 'whole robot'}: {one.log_evidence:.3g}"
            for one in self.first
        ]
        return brief(self, considered=self.considered, adopted=len(self.adopted), band_hz=self.band_hz, first=few(best))

    def evidence_of(
        self,
        effect_id: str | None = None,
        joints: Sequence[str] = (),
        links: Sequence[str] = (),
        shape: Mapping[str, Any] | None = None,
        window: tuple[str, float, float] | None = None,
        **more: Any,
    ) -> float:
        """Return the log evidence of one given hypothesis, given the curves that the data need.

        Args:
            effect_id: of the effect; ``effect`` does as well.
            joints, links: where; all joints, or none, for the whole robot.
            shape: nonlinear parameters; ``other`` in it names the joint on whose motion the effect depends.
            window: recording, from and to [s].
        """
        return self.evidence_source(effect_id or more["effect"], joints, links, dict(shape or {}), window)
