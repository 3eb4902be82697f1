"""What a search has found: terms of a model, and what else was considered."""

from __future__ import annotations

from dataclasses import dataclass

from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.discrepancy import Discrepancy
from torchrbd.diagnosis.hypotheses import Hypothesis
from torchrbd.diagnosis.posterior import log_odds
from torchrbd.likelihood.likelihood import Likelihood


@dataclass(frozen=True)
class Term:
    """A hypothesis in a model, and its rivals in its place; all evidence is given the other terms."""

    own: Hypothesis
    rivals: tuple[Hypothesis, ...]

    def best(self, rows: Rows) -> Hypothesis:
        """Return the likeliest of them."""
        return max((self.own, *self.rivals), key=lambda h: log_odds(h, rows))


@dataclass(frozen=True)
class SearchOutcome:
    """The terms that a search has found.

    Attributes:
        base: rigid body and baseline friction alone.
        fit: with the terms, in their order.
        rows: those of the base, whose signals carry the load and friction of a fit.
        terms: those of the model.
        first, last: all other hypotheses given the base, and given the model, likeliest first.
        considered: number of hypotheses.
        discrepancy: curves and noise that hypotheses were compared with.
        complete: whether the search ended since nothing else was likelier than not.
    """

    base: Likelihood
    fit: Likelihood
    rows: Rows
    terms: tuple[Term, ...]
    first: list[Hypothesis]
    last: list[Hypothesis]
    considered: int
    discrepancy: Discrepancy
    complete: bool = True
