"""From files to block statistics: the streaming passes that every fit and diagnosis starts with.

survey (clock, noise, band) -> one cut-off for all -> states, regressor and features, tile by tile -> block statistics

Here it is decided whose states are used. Position noise is sent through the chain (``input_noise.py``); where it would
bias a fit on filtered states, the states are smoothed together with the parameters and the statistics are built anew.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics, nearest_block
from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.dataset.reading import Progress, Reading
from torchrbd.dataset.scales import covered_scales, with_loads
from torchrbd.dataset.simulated import Simulated, check_motion, cut, read_simulated, simulation_notes
from torchrbd.display import Remark
from torchrbd.effects import Effect, Site
from torchrbd.effects.requested import requested_sites
from torchrbd.errors import RecordingError
from torchrbd.inference.data.bodies import check_masses
from torchrbd.inference.data.gains import with_estimated_gains
from torchrbd.inference.data.holdout import held_out_blocks
from torchrbd.inference.data.notes import input_notes, rest_notes
from torchrbd.inference.data.opening import open_all, open_simulated
from torchrbd.inference.data.payload import payload_parameters
from torchrbd.inference.data.torque_filter import find_low_pass
from torchrbd.inference.input_noise import InputNoise, input_noise
from torchrbd.inference.physical.fitting import FittedModel, fit_model
from torchrbd.inference.physical.uncertain_states import UncertainStates
from torchrbd.inference.settings import Settings
from torchrbd.inference.smoothing import smooth, smoothable
from torchrbd.inference.stick_levels import stick_levels
from torchrbd.likelihood.urdf_prior import Prior, data_prior
from torchrbd.recordings import Filtering, InMemory, Recording, RecordingSource, States, Survey, choose_cutoff, survey
from torchrbd.robot import RobotModel


@dataclass(frozen=True)
class Prepared:
    """A robot, its recordings, and the statistics of both.

    Attributes:
        robot: as the URDF gives it.
        reading: the recordings and how they are read.
        columns: layout of x.
        statistics: all blocks.
        held_out: (B,) bool, held-out blocks.
        holdout_words: the same for a person.
        prior: around the URDF.
        found_encoder_noise: (n_dof,) standard deviation of the positions estimated from the recordings to fit, whatever
            the user states; root mean square over them, NaN where it cannot be estimated, [rad] or [m].
        input_noise: effect of position noise on a fit on filtered states.
        states: information lost to uncertain states; None if the states are filtered ones.
        facts: what the user should know of the input.
        prior_stds: by effect and site, standard deviations (K,) of its coefficients, where the prior knows more than
            that their torque is no larger than the joint's.
        known_shapes: by effect and site, standard deviations of its shapes by another fit.
        late: by recording, how much later its torque is than its motion, and the standard deviation [s], where that is
            identified: it is read so much earlier. Under "" that of other recordings. None if it was not estimated.
    """

    robot: RobotModel
    reading: Reading
    columns: Columns
    statistics: BlockStatistics
    held_out: Tensor
    holdout_words: str
    prior: Prior
    found_encoder_noise: Tensor
    input_noise: InputNoise
    states: UncertainStates | None
    facts: tuple[Remark, ...]
    prior_stds: Mapping[tuple[str, Site], Sequence[float]] = field(default_factory=dict)
    known_shapes: Mapping[tuple[str, Site], Mapping[str, float]] = field(default_factory=dict)
    late: Mapping[str, tuple[float, float]] | None = None

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """In the order given, held-out ones last."""
        return self.reading.recordings

    @property
    def filtering(self) -> Filtering:
        """The one filter pair of all."""
        return self.reading.filtering

    @property
    def fitted(self) -> tuple[str, ...]:
        """Names of the recordings that are not held out as a whole."""
        kept_back = zip(self.statistics.blocks, self.held_out.tolist(), strict=True)
        return tuple(dict.fromkeys(block.recording for block, held in kept_back if not held))

    @property
    def training(self) -> BlockStatistics:
        """Blocks to fit and choose with."""
        return self.statistics.select(~self.held_out)

    @cached_property
    def unweighted(self) -> BlockStatistics:
        """The same blocks as every reported error has them: all rows count alike, errors are parts of all torque.

        Another pass over the recordings, where fits weigh rows near rest less, have smoothed the states, or know a part
        of the torque. States are filtered, as those of ``TorqueSeries``. Torque that is late is read at the time of the
        motion: by so much, other rows stand at the ends of what is held out.
        """
        columns, reading = self.columns.unweighted, replace(self.reading, smoothed=())
        as_fitted = columns is self.columns and not self.reading.smoothed and not reading.has_known
        if as_fitted or not self.recordings:
            return self.statistics
        return reading.statistics(columns, lambda *_: None, known_too=True)

    @property
    def judging(self) -> BlockStatistics:
        """Held-out blocks, ``unweighted``."""
        return self.unweighted.select(self.held_out)

    @property
    def judging_fitted(self) -> BlockStatistics:
        """Blocks to fit with, ``unweighted``: for errors to compare with those of ``judging``."""
        return self.unweighted.select(~self.held_out)

    def fit(self, terms: Sequence[Candidate] = (), noise: Tensor | None = None) -> FittedModel:
        """Fit the rigid body and terms to the training blocks and what is known of their states."""
        return fit_model(self.training, self.prior, terms, noise, self.states)

    def measured(self, k: int) -> Tensor:
        """Return (n_dof,) bool, the joints whose torque in recording k counts."""
        return self.reading.measured(k)

    def tiles(self, k: int) -> Iterator[States]:
        """Stream the states of recording k."""
        return self.reading.tiles(k)

    def kept_back(self, recording: str, t: Tensor) -> Tensor:
        """Say which times (N,) of a recording lie in held-out blocks, bool."""
        block = nearest_block(self.statistics.blocks, recording, t)
        return (block >= 0) & self.held_out[block]


def prepare(
    robot: RobotModel,
    recordings: Sequence[RecordingSource | InMemory],
    settings: Settings,
    effects: Sequence[Effect],
    progress: Progress = lambda *_: None,
) -> Prepared:
    """Read everything.

    Args:
        robot: the robot.
        recordings: files, opened recordings or data in memory to fit.
        settings: the user's choices.
        effects: physics to have columns for.
        progress: called with the stage and the part of it that is done.

    Raises:
        RobotError, RecordingError, OptionError: input that cannot be used.
    """
    check_masses(robot)
    reading, found = read(robot, recordings, settings, progress, with_gains=True)
    opened, surveys, filtering, simulated = reading.recordings, reading.surveys, reading.filtering, reading.simulated
    sites, windows = requested_sites(settings.requested_effects(), robot, [r.name for r in opened])
    unloaded = [e for e in effects if not e.uses_load]
    columns = Columns(robot, unloaded, covered_scales(surveys, filtering), windows, sites=sites)
    used, held = reading.used, settings.held_bodies(robot)
    statistics = reading.statistics(columns, progress)
    held_out, words = held_out_blocks(statistics.blocks, opened[len(recordings) :], reading, settings)
    weight = statistics.torque[..., 0].sum(0)
    if not weight.any():
        raise RecordingError("no torque that changes is recorded for any of the joints in use; nothing can be fitted")
    training = statistics.select(~held_out)
    prior = data_prior(training, held, settings.kappa)
    rough = fit_model(training, prior)
    levels, loaded = stick_levels(training, prior), len(unloaded) < len(effects)
    if loaded:
        # The URDF's own load may be far off; what depends on it is built around a first fit.
        scales = with_loads(columns.scales, reading, rough.pi)
        columns = Columns(robot, effects, scales, windows, rough.pi, sites=sites)
    if loaded or bool(levels.any()):
        columns = columns.sticking(levels)
        statistics = reading.statistics(columns, progress)
        training = statistics.select(~held_out)
        prior = data_prior(training, held, settings.kappa)
        rough = fit_model(training, prior)
    prepared = Prepared(
        robot=robot,
        reading=reading,
        columns=columns,
        statistics=statistics,
        held_out=held_out,
        holdout_words=words,
        prior=prior,
        found_encoder_noise=_encoder_noise(found[: len(recordings)]),
        input_noise=input_noise(reading, columns, training, rough),
        states=None,
        facts=(
            *_gain_notes(reading),
            *simulation_notes(simulated),
            *input_notes(columns, surveys, filtering, prior, held, used & (weight == 0)),
            *rest_notes(training),
        ),
    )
    if settings.estimator == "smoother" or (settings.estimator == "auto" and prepared.input_noise.matters):
        return _smoothed(prepared, rough, held, settings, progress)
    return prepared


def _gain_notes(reading: Reading) -> list[Remark]:
    """Return what is to be known of estimated gains."""
    sliding = dict(zip(reading.robot.joint_names, reading.robot.prismatic.tolist(), strict=True))
    per = {"kp": ("N m/rad", "N/m"), "torque_constant": ("N m/A", "N/A")}
    units = [per[gain.kind][sliding[gain.joint]] for gain in reading.gains]
    return [Remark("estimated gains", {"gains": [*map(asdict, reading.gains)], "units": units})] if units else []


def read(
    robot: RobotModel,
    recordings: Sequence[RecordingSource | InMemory],
    settings: Settings,
    progress: Progress = lambda *_: None,
    *,
    with_gains: bool = False,
) -> tuple[Reading, list[Survey]]:
    """Open recordings, look through them, and decide how they are read.

    Args:
        robot, recordings, settings, progress: see ``prepare``.
        with_gains: whether unknown gains are estimated; if not, recordings that have some cannot be used.

    Returns:
        how they are read, and what each shows, whatever the user knows of its noise.

    Raises:
        RecordingError, OptionError: input that cannot be used.
    """
    opened, noise, found = open_all(robot, recordings, settings), settings.known_encoder_noise(robot).numpy(), []
    simulations = open_simulated(robot, settings, opened)
    gains = ()
    if with_gains:
        opened, gains = with_estimated_gains(robot, opened, len(recordings), settings, progress)
    for k, recording in enumerate(opened):
        progress("looking through the recordings", k / len(opened))
        found.append(survey(recording))
    surveys = [_without_known_noise(one, noise) for one in found]
    filtering = Filtering(choose_cutoff(surveys) if settings.cutoff_hz is None else settings.cutoff_hz)
    opened, surveys, simulated = _simulated(robot, opened, surveys, simulations, filtering, progress)
    payload = payload_parameters(robot, [r.name for r in opened], settings.payload)
    reading = Reading(robot, opened, tuple(surveys), filtering, settings.used_joints(robot), payload, simulated)
    reading = replace(reading, gains=gains)
    low_pass = find_low_pass(reading, fitted=len(recordings))
    if low_pass is not None:
        cutoff_hz = settings.cutoff_hz or min(filtering.cutoff_hz, low_pass.end_hz)
        reading = replace(reading, filtering=Filtering(cutoff_hz, low_pass=low_pass))
    return reading, found


def _simulated(
    robot: RobotModel,
    recordings: tuple[Recording, ...],
    surveys: list[Survey],
    simulations: Sequence[Recording],
    filtering: Filtering,
    progress: Progress,
) -> tuple[tuple[Recording, ...], list[Survey], tuple[Simulated, ...]]:
    """Match a simulator's recordings with the real ones, which are cut to what they have in common.

    Raises:
        RecordingError: a simulated recording that cannot be used, or that moves otherwise.
    """
    if not simulations:
        return recordings, surveys, ()
    width, found = torch.tensor([s.rest_width for s in covered_scales(surveys, filtering)], dtype=torch.float64), []
    kept: list[tuple[Recording, Survey]] = []
    for k, (real, seen, one) in enumerate(zip(recordings, surveys, simulations, strict=True)):
        progress("matching the simulation", k / len(recordings))
        found.append(read_simulated(robot, real, seen, one, filtering, width))
        check_motion(found[-1])
        shorter = found[-1].begin_s > seen.segments[0][0] or found[-1].end_s < seen.segments[-1][1]
        real = cut(real, found[-1]) if shorter else real
        kept.append((real, replace(survey(real), q_noise_std=seen.q_noise_std) if shorter else seen))
    return tuple(r for r, _ in kept), [s for _, s in kept], tuple(found)


def _without_known_noise(found: Survey, noise: np.ndarray) -> Survey:
    """Return a survey with the position noise (n,) that the user knows; NaN leaves what was found."""
    return replace(found, q_noise_std=np.where(np.isnan(noise), found.q_noise_std, noise))


def _encoder_noise(surveys: Sequence[Survey]) -> Tensor:
    """Return the root mean square over recordings of the positions' noise, (n_dof,)."""
    return torch.stack([torch.from_numpy(s.q_noise_std) for s in surveys]).square().nanmean(0).sqrt()


def _smoothed(
    prepared: Prepared, rough: FittedModel, held: Collection[str], settings: Settings, progress: Progress
) -> Prepared:
    """Return the same with smoothed states in place of filtered ones."""
    reading = prepared.reading
    slow = [
        r.name for r, s in zip(reading.recordings, reading.surveys, strict=True) if not smoothable(s, reading.filtering)
    ]
    if slow:
        return replace(prepared, facts=(*prepared.facts, Remark("states not smoothed", {"recordings": slow})))
    found = smooth(
        reading,
        prepared.prior,
        rough,
        prepared.input_noise,
        prepared.kept_back,
        lambda part: progress("smoothing states and parameters together", part),
    )
    reading = replace(reading, smoothed=found.trajectories)
    statistics = reading.statistics(found.columns, progress)
    return replace(
        prepared,
        reading=reading,
        columns=found.columns,
        statistics=statistics,
        prior=data_prior(statistics.select(~prepared.held_out), held, settings.kappa),
        input_noise=replace(prepared.input_noise, encoder_std=found.encoder_std),
        states=found.states,
    )
