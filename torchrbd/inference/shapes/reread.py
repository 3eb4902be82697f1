"""Another pass over the data, for other columns than those that it was prepared with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import nn

from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.dataset.reading import Progress
from torchrbd.dataset.shapes import ShapeSlope, axes
from torchrbd.inference.input_noise import input_noise
from torchrbd.inference.physical.fitting import fit_model
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.smoothing.smooth import Trajectory
from torchrbd.inference.smoothing.smoother import StateSmoother
from torchrbd.likelihood.urdf_prior import data_prior


def reread(prepared: Prepared, columns: Columns, progress: Progress) -> Prepared:
    """Return the same data with other columns; what it says of uncertain states is left as it was.

    Slopes have a prior as wide as their grid, or as another fit's uncertainty, centred where they stand; terms that
    share no column have their ``prior_stds``.
    """
    prior = prepared.prior
    held = [name for b, name in enumerate(prepared.robot.body_names) if b not in prior.bodies]
    statistics = prepared.reading.statistics(columns, progress)
    prior = data_prior(statistics.select(~prepared.held_out), held, prior.kappa)
    for c in columns.candidates:
        if isinstance(c, ShapeSlope):
            (k,) = columns.of(c)
            known = prepared.known_shapes.get((c.effect.id, c.site), {}).get(c.parameter, math.inf)
            prior.scale[k, k] = min(float(prior.scale[k, k]), axes(columns, c)[c.parameter].std, known)
            continue
        others = {k for other in columns.candidates if other is not c for k in columns.of(other)}
        for k, std in zip(columns.of(c), prepared.prior_stds.get((c.effect.id, c.site), ()), strict=False):
            if k not in others:
                prior.scale[k, k] = min(float(prior.scale[k, k]), std)
    return replace(prepared, columns=columns, statistics=statistics, prior=prior)


def with_input_noise(prepared: Prepared, terms: Sequence[Candidate]) -> Prepared:
    """Return the same with what is known of noisy positions or uncertain states, for the columns as they are now."""
    if prepared.states is None:
        rough = fit_model(prepared.training, prepared.prior)
        found = input_noise(prepared.reading, prepared.columns, prepared.training, rough)
        return replace(prepared, input_noise=found)
    x = fit_model(prepared.training, prepared.prior, terms).x
    parts = [
        part
        for one in prepared.reading.smoothed
        if isinstance(one, Trajectory)
        for part in one.parts
        if bool(part[0].counts.any())
    ]
    variance, encoder = prepared.states.torque_variance, prepared.input_noise.encoder_std
    silent = torch.zeros(0, dtype=torch.long)
    stretches = [stretch for stretch, _ in parts]
    smoother = StateSmoother(prepared.columns, prepared.prior, stretches, silent, x, variance.sqrt(), encoder)
    smoother.trajectories = nn.ParameterList([c for _, c in parts])
    said = smoother.refresh(torch.arange(prepared.columns.n))
    return replace(prepared, states=said.uncertain_states(variance))
