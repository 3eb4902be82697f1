"""From second moments to what a fit needs, whether they lie in files or are made of recordings here and now.

One pass over each recording has made them: clocks are taken to agree, samples at rest count as all others do, and what
position noise does to a fit is not asked. That is the price of moments that add.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from torchrbd.dataset.columns import Columns
from torchrbd.dataset.reading import Progress, Reading
from torchrbd.effects import effect
from torchrbd.errors import OptionError, RecordingError
from torchrbd.inference.data.bodies import check_masses
from torchrbd.inference.data.holdout import check_enough, held_out_recordings, held_out_runs
from torchrbd.inference.input_noise import InputNoise
from torchrbd.inference.preparation import Prepared, read
from torchrbd.inference.settings import Settings
from torchrbd.inference.statistics.building import conditions, moment_effects, of_reading
from torchrbd.inference.statistics.files import read_head
from torchrbd.inference.statistics.merging import merged
from torchrbd.inference.statistics.results import MOST_BLOCKS, Conditions, Statistics, added
from torchrbd.likelihood.urdf_prior import data_prior
from torchrbd.recordings import Filtering, InMemory, NamedSource, RecordingSource
from torchrbd.recordings.formats.opening import STATISTICS
from torchrbd.robot import RobotModel

MOMENTS = "moments"
"""The estimator."""


def is_statistics(source: object) -> bool:
    """Say whether a source is a statistics file, by its name."""
    return isinstance(source, Path) and source.suffix == STATISTICS


def of_moments(sources: Sequence[NamedSource], settings: Settings) -> bool:
    """Say whether a fit is to be made of second moments alone.

    Raises:
        OptionError: of statistics files with what needs recordings.
    """
    files = [source for source in (*sources, *settings.holdout) if is_statistics(source)]
    if not files:
        return settings.estimator == MOMENTS
    others = [source for source in (*sources, *settings.holdout) if not is_statistics(source)]
    if others:
        name = others[0] if isinstance(others[0], Path) else others[0].name
        raise OptionError(f"{files[0]} holds statistics, {name} does not; give either, 'torchrbd stats' makes them")
    if settings.estimator not in ("auto", MOMENTS):
        raise OptionError(
            f"{files[0]}: '{settings.estimator}' needs recordings; from statistics parameters are fitted by '{MOMENTS}'"
        )
    if settings.payload:
        raise OptionError(
            f"{files[0]}: known loads are subtracted when statistics are made; give 'torchrbd stats' these"
        )
    return True


def prepare_moments(
    robot: RobotModel, sources: Sequence[NamedSource], settings: Settings, progress: Progress
) -> Prepared:
    """Read statistics files, or make statistics of recordings, and choose the blocks to keep back.

    Raises:
        InputError: what cannot be used, or was made under other conditions.
    """
    check_masses(robot)
    if settings.simulated:
        raise OptionError(f"simulated recordings need recordings of the robot and another estimator than '{MOMENTS}'")
    if any(map(is_statistics, sources)):
        parts = _heads(robot, sources, settings)
        whole = merged(parts, progress=progress)
    else:
        parts = _made(robot, sources, settings, progress)
        whole = added(parts)
    made = whole.conditions
    columns = Columns(robot, [effect(name) for name in made.effects], whole.scales)
    statistics = whole.of_columns(columns).coarsened(MOST_BLOCKS)
    filtering, kept = Filtering(made.cutoff_hz), {o.name for one in parts[len(sources) :] for o in one.origins}
    runs = None if kept else (settings.holdout_fraction, settings.seed)
    if runs is None:
        held_out, words = held_out_recordings(statistics.blocks, kept)
    else:
        held_out, words = held_out_runs(statistics.blocks, *runs)
    block_s = float(np.median([b.end_s - b.start_s for b in statistics.blocks]))
    check_enough(held_out, words, block_s, made.cutoff_hz, runs)
    used = torch.tensor([name in made.used for name in robot.joint_names])
    if not statistics.torque[..., 0].any():
        raise RecordingError("no torque that changes is recorded for any of the joints in use; nothing can be fitted")
    noise = torch.tensor([one.position_noise for one in whole.origins if one.name not in kept], dtype=torch.float64)
    noise, unknown = noise.square().nanmean(0).sqrt(), torch.full((robot.n_dof,), torch.nan, dtype=torch.float64)
    return Prepared(
        robot=robot,
        reading=Reading(robot, (), (), filtering, used, {}),
        columns=columns,
        statistics=statistics,
        held_out=held_out,
        holdout_words=words,
        prior=data_prior(statistics.select(~held_out), settings.held_bodies(robot), settings.kappa),
        found_encoder_noise=noise,
        input_noise=InputNoise(noise, unknown, torch.zeros_like(noise), 1.0, ()),
        states=None,
        facts=tuple(note.of(one.name) for one in whole.origins for note in one.notes),
    )


def _heads(robot: RobotModel, sources: Sequence[NamedSource], settings: Settings) -> list[Statistics]:
    """Read the heads of files, and see that they are of this robot and of what the options ask for."""
    heads = []
    for source in (*sources, *settings.holdout):
        assert isinstance(source, Path)
        heads.append(read_head(source))
        own = heads[-1].conditions
        own.check(_asked(robot, own, settings), str(source), "what was asked for")
    return heads


def _asked(robot: RobotModel, made: Conditions, settings: Settings) -> Conditions:
    """Return the conditions of a file, with those of this robot and of the options that were given in their place."""
    asked = conditions(robot, replace(settings, cutoff_hz=settings.cutoff_hz or made.cutoff_hz))
    left_open = {
        "effects": settings.effects is None and not settings.exclude,
        "used": settings.joints is None,
        "time": settings.time is None,
        "mapping_sha256": settings.mapping is None,
        "encoder_noise": settings.encoder_noise is None,
    }
    return replace(asked, **{name: getattr(made, name) for name, it_is in left_open.items() if it_is})


def _made(
    robot: RobotModel, sources: Sequence[RecordingSource | InMemory], settings: Settings, progress: Progress
) -> list[Statistics]:
    """Make statistics of recordings, each as if it were alone, as their files would have them."""
    moment_effects(settings)
    reading, _ = read(robot, sources, settings, progress)
    made, parts = conditions(robot, replace(settings, cutoff_hz=reading.filtering.cutoff_hz)), []
    for k, (recording, seen) in enumerate(zip(reading.recordings, reading.surveys, strict=True)):
        progress("building the statistics", k / len(reading.recordings))
        alone: Reading = replace(reading, recordings=(recording,), surveys=(seen,))
        parts.append(of_reading(alone, settings, made, lambda *_: None))
    return parts
