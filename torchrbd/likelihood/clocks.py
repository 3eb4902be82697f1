"""Clocks of torque and motion: brought together where they are far apart, told by the rest.

A torque that is recorded early, in all joints alike, may be a command that actuators follow as a first-order system of
time constant T. Beside a torque tau_s that was moved by as much, a command has at joint j

    g_j (tau_s(t - T) + T dtau_s(t - T)/dt - tau_s(t))

with g = 1, and what was early has g = 0: with m the mean of the g_j by their precision and s^2 its variance, log odds
are (m - 1/2) / s^2 for the command. This is of second order, g T^2/2 d2tau_s/dt2, and s^2 is that of the fit, of the
joints' scatter, and of samples dt apart, which tell a reversal's friction, and so T^2/2, to about dt^2. Where a command
is likelier, recorded torques are not moved in time but sent through such actuators.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from torch import Tensor

from torchrbd.effects import Signals
from torchrbd.effects.band_limits import below
from torchrbd.effects.time_delay import delayed
from torchrbd.likelihood.columns import Columns
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import OFFSET_HZ, Machine
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
        lags: whether torques have been sent through actuators that lag by so much less, instead of being moved.
        lag_odds: log odds of that against being moved; 0 where they are not told apart.
    """

    fit: Likelihood
    shift_s: Mapping[str, float]
    lags: bool = False
    lag_odds: float = 0.0

    @cached_property
    def delay_s(self) -> dict[str, tuple[float, float]]:
        """By recording, how much later the torque is than the motion, and its standard deviation [s]."""
        machine, size = self.fit.machine, self.fit.machine.timing_std
        estimates = [self._estimates.estimate([k]) for k in machine.timing]
        return {
            name: (self.shift_s[name] - size * float(z[0]), size * float(np.sqrt(C[0, 0])))
            for name, (z, C) in zip(machine.rows.seen_recordings, estimates, strict=True)
        }

    @cached_property
    def against(self) -> float:
        """Log evidence against clocks that agree."""
        machine = self.fit.machine
        moved = np.array([self.shift_s[name] for name in machine.rows.seen_recordings])
        return self._estimates.against(machine.timing, moved / machine.timing_std)

    @cached_property
    def _estimates(self) -> TwoEstimates:
        return TwoEstimates(self.fit)

    def read_with(self, reading: Reading, late_s: Mapping[str, float]) -> Reading:
        """Return a reading of torques that are later than the motion by ``late_s``, in the way that was likelier."""
        if self.lags:
            return replace(reading, lag_s={name: max(0.0, -late) for name, late in late_s.items()})
        return replace(reading, delay_s=late_s)


def in_time(reading: Reading, columns: Columns, kept_back: KeptBack, held: frozenset[str]) -> Clocks:
    """Learn the likelihood of ordinary physics, torque and motion brought together where their clocks are far apart.

    The offset of the clocks is a linear term of every model; where it is not small, torques are read anew by so much
    earlier.
    """
    rows = read_rows(reading, columns, kept_back)
    fit = learn(Machine(rows, held))
    shift = dict.fromkeys((r.name for r in reading.recordings), 0.0)

    def brought_together(now: Clocks) -> Clocks:
        for _ in range(_MOST_READINGS):
            found = dict(zip(rows.seen_recordings, now.fit.delay_s.tolist(), strict=True))
            if max(map(abs, found.values())) < _NEAR_SAMPLES * rows.dt:
                break
            shift = {name: late + found.get(name, 0.0) for name, late in now.shift_s.items()}
            again = read_rows(now.read_with(reading, shift), columns, kept_back)
            now = replace(now, fit=learn(Machine(again, held)), shift_s=shift)
        return now

    moved = brought_together(Clocks(fit, shift))
    if not all(-moved.shift_s[name] > rows.dt for name in rows.seen_recordings):
        return moved
    odds = _command_odds(moved)
    if odds <= 0:
        return replace(moved, lag_odds=odds)
    return brought_together(Clocks(fit, shift, lags=True, lag_odds=odds))


def _command_odds(moved: Clocks) -> float:
    """Return the log odds of a command that actuators follow against torques that were recorded early."""
    fit = moved.fit

    def beyond(signals: Signals) -> Tensor:
        assert signals.recording is not None
        t, lag, torque = signals.sequence(), -moved.shift_s[signals.recording], signals.supplied
        dt = float(t[1] - t[0])
        return below(delayed(torque + lag * signals.rate(torque), lag / dt) - torque, dt, OFFSET_HZ)

    rows = fit.machine.rows.around(fit.pi, fit.hyper.friction, fit.hyper.rest_width)
    features, seen = rows.evaluated(beyond), [j for j, at in enumerate(fit.index) if len(at)]
    augmented = fit.extended([Extra(j, features[j : j + 1], np.ones(1)) for j in seen]).refit
    g = np.array([augmented.coefficients(k)[0] for k in range(len(seen))])
    weight = np.array([1.0 / augmented.coefficients_covariance(k)[0, 0] for k in range(len(seen))])
    mean = weight @ g / weight.sum()
    scatter = weight @ (g - mean) ** 2 / weight.sum() / max(1, len(seen) - 1)
    lag = float(np.mean([moved.shift_s[name] for name in rows.seen_recordings]))
    return float((mean - 0.5) / (1.0 / weight.sum() + scatter + 4.0 * (rows.dt / lag) ** 4))


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
