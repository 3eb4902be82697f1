"""Diagnoses without findings, of input that cannot be right. Their model is the rigid body with plain friction."""

from __future__ import annotations

from torchrbd.dataset.reading import Progress
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.ranked import Ranking
from torchrbd.inference.identification import Identification
from torchrbd.inference.identify import marked, summarise
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.settings import Settings
from torchrbd.inference.suspicions import Suspicions


def suspect(
    prepared: Prepared,
    settings: Settings,
    progress: Progress,
    suspected: Suspicions,
    ranked: Ranking | None = None,
) -> Diagnosis:
    """Return a diagnosis of the recordings alone, without findings.

    Args:
        prepared: the data.
        settings: the user's choices.
        progress: called with the stage and the part of it that is done.
        suspected: of the recordings.
        ranked: what was considered, if it came to that.
    """
    identification = _plain(prepared, settings, progress, suspected)
    return Diagnosis(identification, "suspect", (), simulated=_simulated(prepared), ranking=ranked)


def _plain(prepared: Prepared, settings: Settings, progress: Progress, suspected: Suspicions) -> Identification:
    progress("fitting", 0.0)
    models = {"rigid_body": prepared.fit(), "extended": prepared.fit(prepared.columns.urdf_friction)}
    return marked(summarise(prepared, models, settings, progress, suspected))


def _simulated(prepared: Prepared) -> tuple[str, ...]:
    return tuple(one.name for one in prepared.reading.simulated)
