"""Choose the terms that a model lacks.

Friction is the normal case: viscous and Coulomb friction and an offset stand at every joint from the start, so that
they hide nothing, and go at the end where the data does without them. Between, the best addition is taken, as long as
there is one that the left-out blocks accept; of several that are as good, the simplest. After each, all that was chosen
is chosen again among what explains the same. Where names have ended, smooth functions of single signals may follow, and
take the place of a name that they beat clearly: its law is not the one that acts there.
"""

from __future__ import annotations

from collections.abc import Sequence

from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.search.grid import Grid
from torchrbd.diagnosis.search.lawless import challenged, lawful
from torchrbd.diagnosis.search.options import plausible
from torchrbd.diagnosis.search.partial import partial
from torchrbd.diagnosis.search.pruning import pruned
from torchrbd.diagnosis.search.steps import Steps
from torchrbd.diagnosis.search.terms import names, place
from torchrbd.likelihood.columns import Candidate

MOST_UNNAMED = 4


class Search(Steps):
    """The search for the terms of one robot's model; its arguments and attributes are those of its ``Steps``."""

    def run(self) -> Fit:
        """Return the fit with the chosen terms."""
        return self._completed(self.loaded(self.start))

    def without(self, fit: Fit, refuted: Sequence[Candidate]) -> Fit:
        """Return a fit that does without some effects at their places, whatever may be chosen instead.

        Nothing is chosen instead of plain friction: what shows too little of it shows no other kind.
        """
        samples, plain = fit.rows.samples, all(c in self.background for c in refuted)
        self._refuted |= {place(c) for c in refuted}
        self.grid = Grid(samples, self.possible(self.grid.candidates))
        self.background = self.possible(self.background)
        kept = self.possible(fit.terms)
        if plain:
            return fitted(samples, self.prior, kept, fit.rows.noise)
        return self._completed(fitted(samples, self.prior, self.restored(kept), fit.rows.noise))

    def _completed(self, fit: Fit) -> Fit:
        """Add names, then functions without one, and drop what is not needed."""
        fit = challenged(self, partial(self, self.named(fit)))
        visited = {frozenset(names(fit.terms))}
        for _ in range(MOST_UNNAMED):
            smooth = self.smooth(fit)
            if smooth is None:
                break
            fit = fitted(fit.rows.samples, self.prior, (*fit.terms, smooth.candidate), fit.rows.noise)
            fit = self.named(self.settled(fit))
            if (reached := frozenset(names(fit.terms))) in visited:
                break
            visited.add(reached)
        fit = lawful(self, fit)
        if not all(plausible(fit, c) for c in fit.terms):
            fit = self.settled(fit)
        return pruned(self, fit)
