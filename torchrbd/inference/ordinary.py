"""Ordinary machine physics of an identification: friction at every joint, and clocks that are apart.

Friction is estimated beside the inertial parameters, not searched for: parameters of a machine that is fitted without
its friction are those of another machine. By how much torque and motion are apart in time, and whether joints stick,
is learnt by least squares in the band of the fit.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from torchrbd.inference.preparation import Prepared
from torchrbd.inference.settings import Settings
from torchrbd.likelihood.likelihood import learn
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.rows import read_rows
from torchrbd.likelihood.urdf_prior import data_prior
from torchrbd.physics import Effect, effect

ORDINARY = ("viscous_friction", "asymmetric_coulomb_friction")
# Coulomb friction that is one number for both directions is the same physics.
_SAME = ("coulomb_friction",)
# Clocks that are apart by less than so many standard deviations are not.
_TOLD = 3.0
# Where a joint sticks, its friction makes rows count less than so much.
_STICKS = 0.5


def with_friction(settings: Settings) -> tuple[Effect, ...]:
    """Return the effects that the user names, and ordinary friction if none of it is named or excluded."""
    named = settings.chosen_effects() if settings.effects else ()
    taken = {e.id for e in named} | set(settings.exclude)
    ordinary = ORDINARY if not taken.intersection((*ORDINARY, *_SAME)) else ()
    return (*named, *(effect(identifier) for identifier in ordinary))


def with_machine(prepared: Prepared, settings: Settings) -> Prepared:
    """Return the same data with clocks as late and joints as sticky as least squares has them.

    States that have been smoothed stay as they are.
    """
    if prepared.states is not None:
        return prepared
    held = frozenset(settings.held_bodies(prepared.robot))
    fit = learn(Machine(read_rows(prepared.reading, prepared.columns, prepared.kept_back), held), white=True)
    spread = fit.machine.timing_std * fit.gaussian.covariance(fit.machine.timing).diagonal() ** 0.5
    clocks = zip(fit.machine.rows.seen_recordings, fit.delay_s, spread, strict=True)
    late = {name: float(d) for name, d, std in clocks if abs(d) > _TOLD * std}
    sticky = torch.tensor([bool((noise.weight < _STICKS).any()) for noise in fit.hyper.noise])
    columns = prepared.columns.sticking(prepared.columns.stick_levels * sticky)
    reading = replace(prepared.reading, delay_s=late)
    statistics = reading.statistics(columns, lambda *_: None)
    prior = data_prior(statistics, settings.held_bodies(prepared.robot), settings.kappa)
    return replace(prepared, reading=reading, columns=columns, statistics=statistics, prior=prior)
