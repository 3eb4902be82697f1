"""The offset between the clocks of torque and motion: large offsets are removed, small ones are linear terms.

A torque that is early, at all joints alike, may be a command that the actuators follow as a first-order system of time
constant T. Relative to a torque tau_s that was only shifted by the same time, a command adds at joint j

    g_j (tau_s(t - T) + T dtau_s(t - T)/dt - tau_s(t))

with g = 1; an early torque has g = 0. Let m be the precision-weighted mean of the g_j and s^2 its variance: the log
odds of the command are (m - 1/2) / s^2. The term is of second order, g T^2/2 d2tau_s/dt2. s^2 includes the variance of
the fit, the scatter of the joints, and the sampling interval dt, which limits T^2/2 at a reversal's friction to about
dt^2. Where a command is more probable, recorded torques are not shifted in time but passed through such actuators.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from torch import Tensor

from torchrbd.dataset.columns import Columns
from torchrbd.dataset.reading import Progress, Reading
from torchrbd.dataset.rows import KeptBack, not_held_out, read_rows
from torchrbd.dataset.scales import covered_scales
from torchrbd.effects import Signals
from torchrbd.effects.band_limits import below
from torchrbd.effects.time_delay import delayed
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.misspecification import TwoEstimates
from torchrbd.nuisance.clock_offset import OFFSET_HZ
from torchrbd.recordings import Filtering

# Largest offset [samples] that counts as synchronous; largest number of readings to get there.
_NEAR_SAMPLES, _MOST_READINGS = 0.5, 2


@dataclass(frozen=True)
class Clocks:
    """The likelihood after torque and motion were synchronised.

    Attributes:
        fit: the likelihood.
        shift_s: by recording, time by which its torque was read earlier [s].
        lags: whether torques were passed through actuators with this lag instead of being shifted.
        lag_odds: log odds of a lag against a shift; 0 where the data cannot distinguish them.
    """

    fit: Likelihood
    shift_s: Mapping[str, float]
    lags: bool = False
    lag_odds: float = 0.0

    @cached_property
    def delay_s(self) -> dict[str, tuple[float, float]]:
        """By recording, the delay of the torque relative to the motion, and its standard deviation [s].

        Empty for drives.
        """
        if self.fit.machine.rows.driven.any():
            return {}
        machine, size = self.fit.machine, self.fit.machine.clocks.std
        estimates = [self._estimates.estimate([k]) for k in machine.clocks.index]
        return {
            name: (self.shift_s[name] - size * float(z[0]), size * float(np.sqrt(C[0, 0])))
            for name, (z, C) in zip(machine.rows.seen_recordings, estimates, strict=True)
        }

    @cached_property
    def against(self) -> float:
        """Log evidence against synchronous clocks."""
        machine = self.fit.machine
        moved = np.array([self.shift_s[name] for name in machine.rows.seen_recordings])
        return self._estimates.against(machine.clocks.index, moved / machine.clocks.std)

    @cached_property
    def _estimates(self) -> TwoEstimates:
        return TwoEstimates(self.fit)

    def read_with(self, reading: Reading, late_s: Mapping[str, float]) -> Reading:
        """Return a reading for torques with delays ``late_s``, by shift or lag, whichever was more probable."""
        if self.lags:
            return replace(reading, lag_s={name: max(0.0, -late) for name, late in late_s.items()})
        return replace(reading, delay_s=late_s)


def in_time(reading: Reading, columns: Columns, kept_back: KeptBack, held: frozenset[str]) -> Clocks:
    """Learn the likelihood of the baseline model, and synchronise torque and motion if their offset is large.

    The clock offset is a linear term of every model. Where it is not small, torques are read again with that shift.
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
    augmented = fit.extended([Extra(j, features[j : j + 1], np.ones(1)) for j in seen]).renoised().rewidened().refit
    g = np.array([augmented.coefficients(k)[0] for k in range(len(seen))])
    weight = np.array([1.0 / augmented.coefficients_covariance(k)[0, 0] for k in range(len(seen))])
    mean = weight @ g / weight.sum()
    scatter = weight @ (g - mean) ** 2 / weight.sum() / max(1, len(seen) - 1)
    lag = float(np.mean([moved.shift_s[name] for name in rows.seen_recordings]))
    return float((mean - 0.5) / (1.0 / weight.sum() + scatter + 4.0 * (rows.dt / lag) ** 4))


def in_band(
    reading: Reading, band_hz: float, kept_back: KeptBack, held: frozenset[str], progress: Progress = lambda *_: None
) -> Clocks:
    """Return the same for recordings that are read again in a band [Hz], with Wiener-filtered states."""
    progress("learning the noise", 0.0)
    surveys = [reading.surveys[k] for k in not_held_out(reading, kept_back)]
    reading = replace(
        reading, filtering=Filtering(band_hz, of_motion=True, low_pass=reading.filtering.low_pass), smoothed=()
    )
    columns = Columns(reading.robot, (), covered_scales(surveys, reading.filtering))
    return in_time(reading, columns, kept_back, held)


def of_one_machine(
    found: Mapping[str, tuple[float, float]], recordings: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Return the offsets of all recordings' clocks and their standard deviations [s].

    A held-out recording is of the same machine: it gets the mean of the others, with their scatter as its uncertainty.

    Args:
        found: of those that are fitted, one or more.
        recordings: names of all.
    """
    late, std = np.array(list(found.values())).T
    weight = std**-2.0
    mean = float(weight @ late / weight.sum())
    scatter = float(weight @ (late - mean) ** 2 / weight.sum())
    return dict.fromkeys(recordings, (mean, float(np.sqrt(1.0 / weight.sum() + scatter)))) | dict(found)
