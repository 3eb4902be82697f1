"""Clocks of torque and motion: brought together where they are far apart, told by the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchrbd.likelihood.columns import Columns
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.misspecification import TwoEstimates
from torchrbd.likelihood.reading import Progress, Reading
from torchrbd.likelihood.rows import KeptBack, not_held_out, read_rows
from torchrbd.likelihood.scales import covered_scales
from torchrbd.recordings import Filtering

# Torque and motion are together if their clocks are so many samples apart; readings until they are.
_NEAR_SAMPLES, _MOST_READINGS = 0.5, 2


@dataclass(frozen=True)
class Clocks:
    """What is learnt of torque and motion that have been brought together.

    Attributes:
        fit: the likelihood.
        shift_s: by recording, by how much earlier its torque has been read [s].
        against: log evidence, at the first reading, against clocks that agree.
    """

    fit: Likelihood
    shift_s: Mapping[str, float]
    against: float

    @property
    def delay_s(self) -> dict[str, tuple[float, float]]:
        """By recording, how much later the torque is than the motion, and its standard deviation [s]."""
        fit = self.fit
        spread = fit.machine.timing_std * np.sqrt(fit.gaussian.covariance(fit.machine.timing).diagonal())
        every = zip(fit.machine.rows.seen_recordings, fit.delay_s, spread, strict=True)
        return {name: (float(late) + self.shift_s[name], float(std)) for name, late, std in every}


def in_time(reading: Reading, columns: Columns, kept_back: KeptBack, held: frozenset[str]) -> Clocks:
    """Learn the likelihood of ordinary physics, torque and motion brought together where their clocks are far apart.

    The offset of the clocks is a linear term of every model; where it is not small, torques are read anew by so much
    earlier. The evidence against clocks that agree is that of the first reading, of least squares where whitened rows
    say otherwise.
    """
    fit = learn(Machine(read_rows(reading, columns, kept_back), held))
    against = TwoEstimates(fit).against(fit.machine.timing)
    shift = dict.fromkeys((r.name for r in reading.recordings), 0.0)
    for _ in range(_MOST_READINGS):
        found = dict(zip(fit.machine.rows.seen_recordings, fit.delay_s.tolist(), strict=True))
        if max(map(abs, found.values())) < _NEAR_SAMPLES * fit.machine.rows.dt:
            break
        shift = {name: late + found.get(name, 0.0) for name, late in shift.items()}
        fit = learn(Machine(read_rows(replace(reading, delay_s=shift), columns, kept_back), held))
    return Clocks(fit, shift, against)


def in_band(
    reading: Reading, band_hz: float, kept_back: KeptBack, held: frozenset[str], progress: Progress = lambda *_: None
) -> Clocks:
    """Return the same of recordings that are read anew in a band [Hz], their states what is expected of the motion."""
    progress("learning the noise", 0.0)
    surveys = [reading.surveys[k] for k in not_held_out(reading, kept_back)]
    reading = replace(reading, filtering=Filtering(band_hz, of_motion=True), smoothed=())
    columns = Columns(reading.robot, (), covered_scales(surveys, reading.filtering))
    return in_time(reading, columns, kept_back, held)


def of_one_machine(
    found: Mapping[str, tuple[float, float]], recordings: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Return the offsets of all recordings' clocks and their standard deviations [s].

    A recording that is held out is of the same machine: it has the mean of those that are not, and may differ from it
    as much as they scatter.

    Args:
        found: of those that are fitted, one or more.
        recordings: names of all.
    """
    late, std = np.array(list(found.values())).T
    weight = std**-2.0
    mean = float(weight @ late / weight.sum())
    scatter = float(weight @ (late - mean) ** 2 / weight.sum())
    return dict.fromkeys(recordings, (mean, float(np.sqrt(1.0 / weight.sum() + scatter)))) | dict(found)
