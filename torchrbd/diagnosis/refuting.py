"""What held-out data refutes: findings with which it is predicted worse than with baseline friction alone."""

from __future__ import annotations

from dataclasses import replace

from torchrbd._runtime.deadline import is_over
from torchrbd.dataset.reading import Progress
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.explain import Explained, explain
from torchrbd.diagnosis.final_model import FinalModel, fit_final_model
from torchrbd.diagnosis.held_out_checks import held_out_ratio, over_blocks
from torchrbd.diagnosis.ranking import SearchResult
from torchrbd.diagnosis.results import Finding, Ratio, Unexplained, strongest_first
from torchrbd.diagnosis.search import search_effects
from torchrbd.diagnosis.unexplained import functions
from torchrbd.inference.ordinary import with_friction, with_machine
from torchrbd.inference.physical.fitting import FittedModel, nmse_of_blocks
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.settings import Settings


def is_refuted(first: Explained, asked: Prepared) -> bool:
    """Say whether held-out data refutes what was found besides baseline friction.

    Args:
        first: of the extended model.
        asked: the data without it.
    """
    return bool(first.model.terms) and refuted(first.model.prepared, first.model.model, asked, shown_of(first.model))


def shown_of(final: FinalModel) -> Ratio | None:
    """Return the size on held-out data of what a model adds to the plain one, see ``held_out_ratio``."""
    prepared = final.prepared
    return held_out_ratio(prepared.judging, final.model, prepared.fit(prepared.columns.urdf_friction).x)


def refuted(prepared: Prepared, model: FittedModel, asked: Prepared, there: Ratio | None) -> bool:
    """Say whether held-out data refutes what was found: the plain model predicts it better, joints taken together.

    The difference has to count. It also has to be certain (by a bootstrap over blocks of time), or held-out data has to
    show less of what was found.

    Args:
        prepared, model: with what was found.
        asked: the same data without it; its model is the plain one.
        there: size of what was found on held-out data, see ``held_out_ratio``.
    """
    plain = asked.fit(asked.columns.urdf_friction)
    found, without = nmse_of_blocks(prepared.judging, model.x), nmse_of_blocks(asked.judging, plain.x)
    worse, less = over_blocks(found.numpy(), without.numpy()), there is not None and there.high < 1.0
    return worse.value > 1.0 + DECISIONS.no_change and (worse.low > 1.0 or less)


def friction_alone(
    prepared: Prepared, first: Explained, search: SearchResult, settings: Settings, progress: Progress
) -> Explained:
    """Return the findings of a search that has found nothing; what it had found becomes "not confirmed".

    Args:
        prepared: the data, as they were read.
        first: what held-out data refutes.
        search: without its terms, see ``without_terms``.
        settings: the user's choices.
        progress: called with the stage and the part of it that is done.
    """
    alike = with_machine(prepared, settings, with_friction(settings), progress, search.clocks)
    return _instead(
        first, fit_final_model(alike, search.explanation, [e.id for e in settings.chosen_effects()], progress)
    )


def what_counts(first: Explained) -> Explained:
    """Return the findings of the model without the terms that are negligible."""
    return _instead(first, first.model.without(first.apart))


def functions_alone(
    prepared: Prepared, search: SearchResult, settings: Settings, progress: Progress
) -> tuple[Unexplained, ...]:
    """Return smooth functions in the place of laws that held-out data refutes, unless it refutes the functions too.

    Args:
        prepared: the data.
        search: what was considered.
        settings: the user's choices.
        progress: called with the stage and the part of it that is done.
    """
    if is_over():
        return ()
    progress("trying functions without laws", 0.0)
    before = search.explanation
    found = search_effects(before.base, (), lambda _: None, before.discrepancy)
    if not found.terms:
        return ()
    alike = with_machine(prepared, settings, with_friction(settings), progress, replace(search.clocks, fit=found.fit))
    model = fit_final_model(alike, found, [e.id for e in settings.chosen_effects()], progress)
    if refuted(model.prepared, model.model, prepared, shown_of(model)):
        return ()
    return tuple(one for one in functions(model) if one.where.recordings is None)


def _instead(first: Explained, model: FinalModel) -> Explained:
    """Return the findings of another model; findings of the first that this one lacks become "not confirmed"."""
    other = explain(model)
    known = {_kind(f) for f in (*other.findings, *other.not_confirmed)}
    apart = [f for f in (*first.findings, *first.not_confirmed) if _kind(f) not in known]
    return replace(other, not_confirmed=strongest_first((*apart, *other.not_confirmed)))


def _kind(one: Finding) -> tuple[object, ...]:
    return one.effect, one.joints, one.links, one.where
