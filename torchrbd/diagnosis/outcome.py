"""What a search has found: terms of a model, and what else was considered."""

from __future__ import annotations

from dataclasses import dataclass, replace

from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.discrepancy import Discrepancy
from torchrbd.diagnosis.hypotheses import Hypothesis
from torchrbd.diagnosis.posterior import limit_evidence, log_odds
from torchrbd.diagnosis.results import Elpd
from torchrbd.likelihood.likelihood import Likelihood


@dataclass(frozen=True)
class Term:
    """A hypothesis in a model, and its rivals in its place; all evidence is given the other terms."""

    own: Hypothesis
    rivals: tuple[Hypothesis, ...]

    def nested_law(self, rows: Rows, elpd: Elpd) -> Term | None:
        """Return the likeliest rival that is this law with some columns at zero, in its place; None if none is likely.

        The law is the rival and these columns: its odds against the rival are those of the columns alone.

        Args:
            rows: of the search.
            elpd: what left-out blocks say for the law against the rival.
        """
        site, labels = self.own.candidate.site, set(self.own.candidate.labels)
        parts = [h for h in self.rivals if h.candidate.site == site and set(h.candidate.labels) < labels]
        best = max(parts, key=lambda h: log_odds(h, rows), default=None)
        if best is None or log_odds(best, rows) <= 0.0:
            return None
        (alone, _), odds = limit_evidence(self.own, (), elpd), log_odds(self.own, rows)
        more = log_odds(best, rows) + min(log_odds(alone, rows), 0.0) - odds
        own = replace(self.own, log_evidence=self.own.log_evidence + more)
        return Term(best, (own, *(h for h in self.rivals if h is not best)))


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
