"""A result as a card in a notebook: verdict, errors joint by joint, findings and unexplained residuals."""

from __future__ import annotations

from dataclasses import dataclass

from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.results import Finding
from torchrbd.inference.identification import Identification
from torchrbd.inference.results import ParameterEstimate
from torchrbd.report.cards import PlainRow, plain_rows, plain_titles
from torchrbd.report.templates import environment
from torchrbd.report.text.names import at, guessed, more_values, place, values, when
from torchrbd.report.text.numbers import measure, unit
from torchrbd.report.text.verdict import badge, headline, model_words

# White on these is readable, and they are on white and on black.
TONES = {
    "consistent": "#00795a",
    "identified": "#00795a",
    "parameters": "#0072b2",
    "doubtful": "#9a6200",
    "missing_physics": "#c24f00",
    "worse": "#b3261e",
    "suspect": "#b3261e",
    "unexplained": "#a8578a",
}
MODELS = {"urdf": "URDF", "baseline": "baseline", "rigid_body": "re-fitted", "extended": "extended"}
STATUSES = {
    "identified": "identified",
    "combination": "in combination",
    "unexcited": "not excited",
    "not identifiable": "not identifiable",
    "held": "held",
    "not judged": "not judged",
}


def card(result: Identification | Diagnosis) -> str:
    """Return a result as an HTML element that needs nothing else: no scripts, no style sheet, no pictures.

    Its colours are those of the notebook around it, light or dark, but for the verdict's. Every name is escaped.

    Args:
        result: what ``identify`` or ``diagnose`` returned.
    """
    return environment().get_template("notebook.html.j2").render(card=Card(result))


@dataclass(frozen=True)
class Row:
    """A finding in a table: where, what, how large, how sure."""

    place: str
    words: str
    values: list[str]
    probability: float


class Card:
    """Everything the template shows."""

    def __init__(self, result: Identification | Diagnosis) -> None:
        self.diagnosis = result if isinstance(result, Diagnosis) else None
        self.result = result.identification if isinstance(result, Diagnosis) else result
        self.badge, self.tone = badge(result), TONES[result.verdict]
        self.headline = headline(result)
        self.models = {m: MODELS[m] for m in self.result.fits} | {"urdf": model_words(result)}
        self.joints = list(self.result.fits["urdf"].nmse)

    def errors(self, joint: str | None) -> list[float]:
        """Return the held-out nmse of every model at a joint, or its mean."""
        fits = [self.result.fits[m] for m in self.models]
        return [fit.mean_nmse if joint is None else fit.nmse[joint] for fit in fits]

    @property
    def findings(self) -> list[Row]:
        """The named effects, strongest first, without plain friction that has its table."""
        folded = {id(f) for row in self.friction for f in row.findings}
        found = self.diagnosis.findings if self.diagnosis else ()
        return [_row(f) for f in found if id(f) not in folded]

    @property
    def friction(self) -> list[PlainRow]:
        """Viscous and Coulomb friction and offsets, a row per joint, if there are many."""
        return plain_rows(self.diagnosis.findings, self.result.series.joints) if self.diagnosis else []

    @property
    def friction_titles(self) -> list[str]:
        """What the columns of that table are called."""
        return plain_titles(self.friction)

    @property
    def unexplained(self) -> list[str]:
        """Residuals that no known effect explains, in sentences."""
        return [item.statement for item in self.diagnosis.unexplained] if self.diagnosis else []

    @property
    def not_confirmed(self) -> list[str]:
        """Likely effects that cross-validation does not confirm, with their places."""
        every = () if self.diagnosis is None else self.diagnosis.not_confirmed
        return [guessed(f) + (at(f.joints, f.links) or " on the whole robot") for f in every]

    @property
    def terms(self) -> list[tuple[ParameterEstimate, str]]:
        """Of an identification alone: fitted coefficients of friction and other terms, ± 95 %, with their units."""
        found = [p for p in self.result.parameters if p.status == "term"] if self.diagnosis is None else []
        return [(p, f"{measure(p.value, 1.96 * p.std)} {unit(p.unit)}".rstrip()) for p in found]

    @property
    def statuses(self) -> dict[str, int]:
        """How many inertial parameters are what, in words."""
        found = [p.status for p in self.result.parameters]
        return {words: found.count(status) for status, words in STATUSES.items() if status in found}


def _row(finding: Finding) -> Row:
    inside = when(finding.where)
    shown = values(finding)
    more = more_values(finding)
    return Row(
        place(finding) + (f" ({inside})" if inside else ""),
        guessed(finding),
        [*shown, *([f"{more} more"] if more else [])],
        finding.probability,
    )
