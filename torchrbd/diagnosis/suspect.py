"""Diagnoses without findings: input that cannot be right, and what was found that held-out time contradicts.

Their model is the rigid body with plain friction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import torch

from torchrbd.diagnosis.extending import extended
from torchrbd.diagnosis.proof import confirmed, over_blocks
from torchrbd.diagnosis.ranking import Ranking
from torchrbd.diagnosis.results import Diagnosis, Ratio, Unexplained, Where
from torchrbd.diagnosis.search import explained
from torchrbd.diagnosis.unexplained import functions, whatever_the_motion
from torchrbd.diagnosis.verdict_words import contradicted_sentence, contradicted_statement, suspect_statement
from torchrbd.diagnosis.words import NO_CHANGE
from torchrbd.inference.identify import summarise
from torchrbd.inference.ordinary import with_friction, with_machine
from torchrbd.inference.physical.fitting import FittedModel, beside_constant, nmse_of_blocks
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.results import Identification
from torchrbd.inference.settings import Settings
from torchrbd.inference.suspicions import Suspicions
from torchrbd.likelihood.reading import Progress


def suspect(
    prepared: Prepared,
    settings: Settings,
    progress: Progress,
    suspected: Suspicions,
    ranked: Ranking | None = None,
) -> Diagnosis:
    """Return a diagnosis that tells of the input alone.

    Args:
        prepared: the data.
        settings: the user's choices.
        progress: told how far the work is.
        suspected: of the recordings.
        ranked: what was considered, if it came to that.
    """
    identification = _plain(prepared, settings, progress, suspected)
    return Diagnosis(
        identification, "suspect", suspect_statement(suspected), (), simulated=_simulated(prepared), ranking=ranked
    )


def contradicted(
    prepared: Prepared,
    settings: Settings,
    progress: Progress,
    suspected: Suspicions,
    ranked: Ranking,
    errors: Mapping[str, float],
    shown: Sequence[Unexplained],
) -> Diagnosis:
    """Return a diagnosis of recordings that were held out and contradict what the others show.

    Args:
        prepared, settings, progress, suspected, ranked: as of ``suspect``.
        errors: held-out nmse by joint of what was found, in the mean worse than the plain model's or a constant's.
        shown: functions that it shows, see ``functions_alone``.
    """
    identification = _plain(prepared, settings, progress, suspected)
    known = {joint for one in shown for joint in one.joints}
    missed = (one for one in _missed(errors, identification) if one.joints[0] not in known)
    rest = (*shown, *whatever_the_motion(ranked.explanation), *missed)
    joints = dict.fromkeys(joint for u in rest for joint in u.joints)
    statement = contradicted_statement(list(joints), identification.fits)
    return Diagnosis(identification, "unexplained", statement, (), rest, simulated=_simulated(prepared), ranking=ranked)


def functions_alone(
    prepared: Prepared, ranked: Ranking, settings: Settings, progress: Progress
) -> tuple[Unexplained, ...]:
    """Return what smooth functions explain in the place of laws that held-out time refutes, unless it refutes them too.

    Args:
        prepared, settings, progress, ranked: as of ``suspect``.
    """
    progress("trying functions without laws", 0.0)
    found = explained(ranked.explanation.base, (), lambda _: None)
    if not found.terms:
        return ()
    alike = with_machine(prepared, settings, with_friction(settings), progress, replace(ranked.clocks, fit=found.fit))
    model = extended(alike, found, [e.id for e in settings.chosen_effects()], progress)
    plain = model.prepared.fit(model.prepared.columns.urdf_friction)
    if refuted(model.prepared, model.model, prepared, confirmed(model.prepared.judging, model.model, plain.x)):
        return ()
    return tuple(one for one in functions(model) if one.where.recordings is None)


def tells_nothing(prepared: Prepared, model: FittedModel) -> bool:
    """Say whether a model predicts held-out torque no better than a constant, in the mean over the joints."""
    error = beside_constant(prepared.training, prepared.judging, model.x)
    return bool(error.isfinite().any()) and float(torch.nanmean(error)) > 1.0


def refuted(prepared: Prepared, model: FittedModel, asked: Prepared, there: Ratio | None) -> bool:
    """Say whether held-out time refutes what was found: the plain model predicts it better, joints taken together.

    By what counts, and either that is certain (blocks of time are drawn again), or it is that held-out time has less of
    what was found.

    Args:
        prepared, model: with what was found.
        asked: the same data without it; its model is the plain one.
        there: how large held-out time has what was found, see ``confirmed``.
    """
    plain = asked.fit(asked.columns.urdf_friction)
    found, without = nmse_of_blocks(prepared.judging, model.x), nmse_of_blocks(asked.judging, plain.x)
    worse, less = over_blocks(found.numpy(), without.numpy()), there is not None and there.high < 1.0
    return worse.value > 1.0 + NO_CHANGE and (worse.low > 1.0 or less)


def _plain(prepared: Prepared, settings: Settings, progress: Progress, suspected: Suspicions) -> Identification:
    progress("fitting", 0.0)
    models = {"rigid_body": prepared.fit(), "extended": prepared.fit(prepared.columns.urdf_friction)}
    return summarise(prepared, models, settings, progress, suspected)


def _simulated(prepared: Prepared) -> tuple[str, ...]:
    return tuple(one.name for one in prepared.reading.simulated)


def _missed(errors: Mapping[str, float], plain: Identification) -> Iterator[Unexplained]:
    """Yield the joints whose held-out torque what was found predicts worse than the plain model, clearly if any is."""
    worse = {j: without for j, without in plain.fits["extended"].nmse.items() if errors.get(j, 0.0) > without}
    clearly = {j: without for j, without in worse.items() if errors[j] > (1.0 + NO_CHANGE) * without}
    for joint, without in (clearly or worse).items():
        sentence = contradicted_sentence(joint, errors[joint], without)
        yield Unexplained((joint,), (), Where(), 1.0, sentence)
