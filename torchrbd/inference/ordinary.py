"""Baseline friction of an identification, and clock offsets between torque and motion.

Friction is estimated with the inertial parameters, not searched for: without it these would be biased. The clock
offset, the width of friction's sign change, and whether joints stick show at high frequencies, above all at reversals.
They are therefore learnt from whitened rows. Coefficients are those of least squares in the band of the fit: they
predict even where the law of friction is not quite right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from torchrbd.dataset.band import band_hz
from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.reading import Progress
from torchrbd.dataset.rows import not_held_out
from torchrbd.effects import Effect, JointScale, effect
from torchrbd.effects.registry import OF_DRIVES, PLAIN
from torchrbd.errors import RecordingError
from torchrbd.inference.data.opening import have_drives
from torchrbd.inference.physical.fitting import fit_model, term_candidates
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.settings import Settings
from torchrbd.likelihood.clocks import Clocks, in_band, of_one_machine
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.urdf_prior import data_prior
from torchrbd.model import OTHERS
from torchrbd.recordings import NamedSource

# Clocks that are apart by less than so many standard deviations are not.
_SIGNIFICANT = 3.0


def with_friction(settings: Settings, sources: Sequence[NamedSource] = ()) -> tuple[Effect, ...]:
    """Return the effects to fit: those that the user names, baseline friction if that is left open.

    Drives have gears, and so rotor inertia, too.
    """
    if settings.effects is not None:
        return settings.chosen_effects() if settings.effects else ()
    ordinary = (*PLAIN, *([OF_DRIVES] if have_drives(sources, settings) else []))
    return tuple(effect(identifier) for identifier in ordinary if identifier not in settings.exclude)


def drop_rotors_without_drive(prepared: Prepared, settings: Settings, terms: Sequence[Candidate]) -> list[Candidate]:
    """Return terms without the rotor inertia of joints that have no drive, unless the user asks for effects."""
    driven = prepared.reading.driven
    asked = settings.effects is not None
    return [c for c in terms if asked or c.effect.id != OF_DRIVES or (c.joint is not None and bool(driven[c.joint]))]


def with_machine(
    prepared: Prepared,
    settings: Settings,
    effects: Sequence[Effect],
    progress: Progress,
    known: Clocks | None = None,
    laws: Sequence[Candidate] = (),
) -> Prepared:
    """Return the same data with clocks and sign changes of friction as the likelihood has them.

    States that have been smoothed stay as they are, as do data to which no friction is fitted where nothing is known.

    Args:
        prepared: the data.
        settings: the user's choices.
        effects: that are fitted.
        progress: called with the stage and the part of it that is done.
        known: clocks and likelihood in the wide band, if they have been learnt.
        laws: of friction that refine it, in that likelihood.
    """
    frictionless = not any(e.is_baseline for e in effects)
    if prepared.states is not None or (known is None and frictionless):
        return prepared
    progress("learning clocks and friction", 0.0)
    held = frozenset(settings.held_bodies(prepared.robot))
    clocks = _learnt(prepared, held) if known is None else known
    found, wide = _estimate_at_speed(prepared, clocks)
    late = {} if not found else of_one_machine(found, [*(r.name for r in prepared.recordings), OTHERS])
    late = {name: (d, std) for name, (d, std) in late.items() if abs(d) > _SIGNIFICANT * std}
    offsets = {name: d for name, (d, _) in late.items()}
    reading = prepared.reading if clocks is None else clocks.read_with(prepared.reading, offsets)
    prepared = replace(prepared, reading=reading, late=late)
    # High frequencies may give a width that low ones contradict: each joint gets the width with the smaller residual.
    narrow = prepared.columns.scales
    better = _left(prepared, wide, effects, held) < _left(prepared, narrow, effects, held)
    if laws and known is not None:
        refined = torch.tensor([any(c.site.joint == j for c in laws) for j in range(len(narrow))])
        given = laws, known.fit
        with_laws = _left(prepared, wide, effects, held, *given) < _left(prepared, narrow, effects, held, *given)
        better = torch.where(refined, with_laws, better)
    scales = [new if less else old for old, new, less in zip(narrow, wide, better.tolist(), strict=True)]
    columns = prepared.columns.softened(scales)
    statistics = reading.statistics(columns, progress)
    prior = data_prior(statistics.together(~prepared.held_out), held, settings.kappa)
    return replace(prepared, columns=columns, statistics=statistics, prior=prior)


def _left(
    prepared: Prepared,
    scales: Sequence[JointScale],
    effects: Sequence[Effect],
    held: frozenset[str],
    laws: Sequence[Candidate] = (),
    known: Likelihood | None = None,
) -> torch.Tensor:
    """Return the squared errors (n_dof,) that least squares leaves with such scales, all samples counting alike.

    Args:
        prepared: the data.
        scales: of the joints.
        effects: of which baseline friction is fitted.
        held: bodies that are not fitted.
        laws: of friction that are fitted too.
        known: whose load and friction these depend on.
    """
    columns = prepared.columns.at_scales(scales).unweighted
    own = [columns.candidate(c.effect, c.site, c.shape) for c in laws]
    if known is not None:
        supplied = known.around_its_fit(alone=True)
        columns = columns.of_candidates((*columns.candidates, *own), supplied.pi, supplied.friction)
    training = prepared.reading.statistics(columns, lambda *_: None).together(~prepared.held_out)
    terms = (*term_candidates(columns, [e.id for e in effects if e.is_baseline]), *own)
    fit = fit_model(training, data_prior(training, held, prepared.prior.kappa), terms)
    return training.squared_error(fit.x).sum(0)


def _learnt(prepared: Prepared, held: frozenset[str]) -> Clocks | None:
    """Return clocks and friction estimated from whitened rows of a wide band; None if they cannot be."""
    seen = [prepared.reading.surveys[k] for k in not_held_out(prepared.reading, prepared.kept_back)]
    try:
        return in_band(prepared.reading, band_hz(seen, prepared.filtering.low_pass), prepared.kept_back, held)
    except RecordingError:
        return None


def _estimate_at_speed(
    prepared: Prepared, clocks: Clocks | None
) -> tuple[dict[str, tuple[float, float]], list[JointScale]]:
    """Return clock offsets, and widths of friction's sign change, estimated from rows of a wide band.

    If plain least squares disagrees, the law of friction is wrong: such clock offsets are taken between the two
    estimates. Widths are those of plain least squares and of the machine alone, as the baseline has them. A law such as
    presliding may take the sharp part of friction, and leave a wide sign change that predicts worse.

    Returns:
        by recording, the offset of its clocks and its standard deviation [s]; the scales of each joint.
    """
    scales = list(prepared.columns.scales)
    if clocks is None:
        return {}, scales
    alone = clocks.fit.extended(())
    for j, width in enumerate(alone.least_squares.rewidened().hyper.rest_width.tolist()):
        if clocks.fit.machine.rows.seen[j]:
            scales[j] = replace(scales[j], rest_width=max(width, scales[j].rest_width))
    return clocks.delay_s, scales
