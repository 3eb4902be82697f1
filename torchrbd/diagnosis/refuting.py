"""What was found and cannot stand in the fit to all data: physics forbids it, or it may as well be zero."""

from __future__ import annotations

from collections.abc import Sequence

from torchrbd.diagnosis.search.options import BACKGROUND, INSIGNIFICANT
from torchrbd.diagnosis.search.unnamed import proper
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.physical.terms import significance, term_parameters
from torchrbd.likelihood.columns import Candidate


def refuted(model: FittedModel, found: Sequence[Candidate]) -> list[Candidate]:
    """Return the terms that physics forbids or whose parameters contradict each other.

    Without such, the one told least from zero, if it is within chance of it.

    Of two alike the other may stand alone.
    """
    forbidden = [c for c in found if not _sound(model, c)]
    if forbidden:
        return forbidden
    told = {c: significance(model, c) for c in proper(found)}
    weakest = min(told, key=lambda c: told[c], default=None)
    return [weakest] if weakest is not None and told[weakest] < INSIGNIFICANT else []


def allowed(model: FittedModel, term: Candidate, chance: float = 0.0) -> bool:
    """Say whether the physics allows a term's parameters, those within so many standard deviations of zero aside."""
    return term.effect.plausible(_but_chance(model, term, chance), model.columns.scale(term.site))


def _sound(model: FittedModel, term: Candidate) -> bool:
    """Say whether the physics allows what was found of a term, and its parameters agree.

    What is within chance of zero is no contradiction; plain friction that is so is none, unless the URDF has some.
    """
    if term.effect.id in BACKGROUND:
        some = any(_but_chance(model, term, INSIGNIFICANT).values()) or model.columns.urdf_value(term) != 0
        return some and allowed(model, term, INSIGNIFICANT)
    if term.effect.contradicted(term_parameters(model, term)):
        return False
    return allowed(model, term) or allowed(model, term, INSIGNIFICANT)


def _but_chance(model: FittedModel, term: Candidate, chance: float) -> dict[str, float]:
    found = term_parameters(model, term).items()
    return {name: 0.0 if abs(value) < chance * std else value for name, (value, std) in found}
