"""The model with what was found: physically valid, in the band of the fit, as identification fits it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from torchrbd.diagnosis.friction import Friction, ordinary_friction
from torchrbd.diagnosis.search import Explanation
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.shapes.refine import fit_with_shapes, refined_from
from torchrbd.inference.shapes.reread import reread
from torchrbd.likelihood.columns import Candidate
from torchrbd.likelihood.reading import Progress


@dataclass(frozen=True)
class Extended:
    """A model with ordinary friction and all that was found.

    Attributes:
        prepared: the data, with columns of all terms.
        model: the fit.
        friction: ordinary friction, in the order of the model's first terms.
        terms: what was found, in the order of the explanation, their shapes final.
    """

    prepared: Prepared
    model: FittedModel
    friction: tuple[Friction, ...]
    terms: tuple[Candidate, ...]


def extended(prepared: Prepared, found: Explanation, may: Sequence[str], progress: Progress) -> Extended:
    """Fit ordinary friction and what was found to all that is not held out.

    Args:
        prepared: the data.
        found: what was found.
        may: ids of the effects that may be there.
        progress: told how far the work is.
    """
    columns = prepared.columns
    own = [t.own.candidate for t in found.terms]
    shifted = {c.joint for c in own if c.effect.id == "torque_offset" and c.site.always}
    friction = ordinary_friction(found.fit, columns, may, shifted)
    # A curve is no larger than the likelihood believes: ordinary friction is not displaced.
    believed = {
        (t.own.candidate.effect.id, t.own.candidate.site): t.own.extra(found.fit, found.rows).std for t in found.terms
    }
    prepared = replace(prepared, believed=believed)
    terms = (*(f.candidate for f in friction), *(columns.candidate(c.effect, c.site, c.shape) for c in own))
    wider = columns.of_candidates(terms, found.fit.pi, found.fit.hyper.friction)
    prepared, terms = refined_from(reread(prepared, wider, progress), terms, progress)
    return Extended(prepared, fit_with_shapes(prepared, terms), friction, terms[len(friction) :])
