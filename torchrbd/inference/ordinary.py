"""Ordinary machine physics of an identification: friction at every joint, and clocks that are apart.

Friction is estimated beside the inertial parameters, not searched for: parameters of a machine that is fitted without
its friction are those of another machine. By how much torque and motion are apart in time, and whether joints stick,
is learnt by least squares in the band of the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from torchrbd.inference.preparation import Prepared
from torchrbd.inference.settings import Settings
from torchrbd.likelihood.likelihood import learn
from torchrbd.likelihood.machine import ORDINARY_EFFECTS, Machine
from torchrbd.likelihood.reading import Progress
from torchrbd.likelihood.rows import read_rows
from torchrbd.likelihood.urdf_prior import data_prior
from torchrbd.physics import Effect, effect

# Clocks that are apart by less than so many standard deviations are not.
_TOLD = 3.0


def with_friction(settings: Settings) -> tuple[Effect, ...]:
    """Return the effects to fit: those that the user names, ordinary friction if that is left open."""
    if settings.effects is not None:
        return settings.chosen_effects() if settings.effects else ()
    return tuple(effect(identifier) for identifier in ORDINARY_EFFECTS if identifier not in settings.exclude)


def with_machine(prepared: Prepared, settings: Settings, effects: Sequence[Effect], progress: Progress) -> Prepared:
    """Return the same data with clocks as late and joints as sticky as least squares has them.

    States that have been smoothed stay as they are, as do data to which no friction is fitted.
    """
    if prepared.states is not None or not any(e.id in ORDINARY_EFFECTS for e in effects):
        return prepared
    progress("learning clocks and sticks", 0.0)
    held = frozenset(settings.held_bodies(prepared.robot))
    fit = learn(Machine(read_rows(prepared.reading, prepared.columns, prepared.kept_back), held), white=True)
    spread = fit.machine.timing_std * fit.gaussian.covariance(fit.machine.timing).diagonal() ** 0.5
    clocks = zip(fit.machine.rows.seen_recordings, fit.delay_s, spread, strict=True)
    late = {name: float(d) for name, d, std in clocks if abs(d) > _TOLD * std}
    sticky = torch.tensor([bool((noise.spread > 2.0).any()) for noise in fit.hyper.noise])
    columns = prepared.columns.sticking(prepared.columns.stick_levels * sticky)
    reading = replace(prepared.reading, delay_s=late)
    statistics = reading.statistics(columns, progress)
    training = statistics.select(~prepared.held_out)
    prior = data_prior(training, held, settings.kappa)
    return replace(prepared, reading=reading, columns=columns, statistics=statistics, prior=prior)
