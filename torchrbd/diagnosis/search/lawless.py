"""Smooth functions against names: a name stands only where its law does as well as no law at all."""

from __future__ import annotations

from torchrbd.diagnosis.rows.gain import gain
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.search.options import COMMON, certain, clearly_worse, judged
from torchrbd.diagnosis.search.steps import Steps
from torchrbd.diagnosis.search.terms import without
from torchrbd.diagnosis.search.unnamed import is_smooth
from torchrbd.likelihood.columns import Candidate
from torchrbd.physics import JointEffect
from torchrbd.physics.smooth_torque import SmoothTorque

# A smooth function takes the place of a name if it gains so much more, in units and in parts of its own gain.
BEATEN_GAIN, BEATEN_PART = 10.0, 0.25


def challenged(search: Steps, fit: Fit) -> Fit:
    """Put smooth functions in the place of names that they beat clearly."""
    for term in fit.terms:
        if term in search.background or term.place is None or term not in fit.terms:
            continue
        rest = _without(search, fit, term)
        own, smooth = judged(rest, term), search.smooth(rest, term.place)
        if smooth is not None:
            lead = gain(own.errors, smooth.errors, fit.rows.counts)
            if certain(lead) and lead.total > max(BEATEN_GAIN, BEATEN_PART * smooth.worth.total):
                fit = search.settled(Fit(fit.rows, (*rest.terms, smooth.candidate)))
    return fit


def lawful(search: Steps, fit: Fit) -> Fit:
    """Drop names that a smooth function of their own signal makes needless."""
    return _ahead_of_its_function(search, _clearly_several(search, fit))


def _clearly_several(search: Steps, fit: Fit) -> Fit:
    """Put a smooth function in the place of several names over one signal of a joint, unless they are clearly better.

    Together they bend almost as a function does.
    """
    for joint, signal in dict.fromkeys(filter(None, map(_curve, fit.terms))):
        laws = [c for c in fit.terms if _curve(c) == (joint, signal)]
        if len(laws) < 2:
            continue
        rest = Fit(fit.rows, search.restored(tuple(c for c in fit.terms if c not in laws))).renoised()
        smooth = search.smooth(rest, joint)
        if smooth is None or not _of_its_signal(smooth.candidate, laws[0]):
            continue
        named = Fit(fit.rows, (*rest.terms, *laws)).renoised()
        if not clearly_worse(gain(smooth.errors, named.errors, fit.rows.counts), smooth.worth.total):
            fit = search.settled(Fit(fit.rows, (*rest.terms, smooth.candidate)))
    return fit


def _ahead_of_its_function(search: Steps, fit: Fit) -> Fit:
    """Drop names beside a smooth function of their own signal that gains more than they do."""
    for smooth in [c for c in fit.terms if is_smooth(c)]:
        for term in fit.terms:
            if term in search.background or not _of_its_signal(smooth, term) or not {term, smooth} <= {*fit.terms}:
                continue
            rest = {c: _without(search, fit, c) for c in (term, smooth)}
            if judged(rest[term], term).worth.total < judged(rest[smooth], smooth).worth.total:
                fit = search.settled(rest[term])
    return fit


def _without(search: Steps, fit: Fit, term: Candidate) -> Fit:
    return Fit(fit.rows, search.restored(without(fit.terms, term))).renoised()


def _curve(term: Candidate) -> tuple[int | None, str] | None:
    """Return the joint and the signal over which a law is drawn; None of plain friction and of what is no such law."""
    if is_smooth(term) or not isinstance(term.effect, JointEffect) or not term.site.always:
        return None
    return None if term.effect.id in COMMON else (term.place, term.effect.drawn_over)


def _of_its_signal(smooth: Candidate, term: Candidate) -> bool:
    """Say whether a smooth function is of the signal of the joint over which an effect is drawn."""
    if not isinstance(term.effect, JointEffect) or not isinstance(smooth.effect, SmoothTorque):
        return False
    same = smooth.place == term.place and term.site.always
    return same and not smooth.effect.other and smooth.effect.signal == term.effect.drawn_over
