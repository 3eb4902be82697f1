"""Torques, regressor and features of any candidate, through one low-pass filter: the rows of every regression.

Rows are kept in memory. If recordings are too long for that, tiles spread over all of them are read.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NoReturn

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.dataset.reading import Reading
from torchrbd.dataset.remembered import Remembered
from torchrbd.dataset.spreading import Density
from torchrbd.effects import Signals
from torchrbd.effects.base import ShowsBodies
from torchrbd.errors import RecordingError
from torchrbd.recordings import States, Survey

_DENSITY = Density(most_states=100_000, least_rate_hz=100.0, rate_cycles=16.0)
# Largest count of cached feature values.
_MOST_REMEMBERED = 40_000_000
# Spacing of the times [s] at which to check that a recording is held out as a whole: blocks are longer.
_LOOK_S = 0.1
# Largest number of blocks of time per recording.
_MOST_BLOCKS = 64

KeptBack = Callable[[str, Tensor], Tensor]
"""Returns which times (N,) of a recording are held out, bool."""


@dataclass(frozen=True)
class Tile:
    """A piece of a recording: states, the signals of effects, and which outputs count (M,) bool."""

    states: States
    signals: Signals
    kept: Tensor


@dataclass(frozen=True)
class Rows:
    """M band-limited samples of a robot with n joints, without the held-out ones.

    Attributes:
        columns: of the robot; their ``pi`` gives the load, and their ``friction`` adds to it.
        tiles: inputs of the features.
        recordings: names.
        rigid: per joint, its row of the regressor (M, p_j), of the bodies that it moves: see ``Columns.inertial``.
        tau: (n, M) measured torque, 0 where ``measured`` (n, M) is not.
        q, qd, qdd: (n, M) band-limited.
        driven: (n,) bool, joints whose torque is that of a drive.
        run: (M,) number of the uninterrupted run that a sample belongs to.
        recording: (M,) index into ``recordings``.
        t: (M,) seconds since that recording's start.
        block: (M,) number of the block of time, of one recording.
        encoder_std: (n,) noise of the positions [rad or m].
        torque_step: (n,) quantisation of the torques [N m or N], NaN if none is seen.
        noise_share: (n,) share of the positions' power that is noise at the edge of the band.
        speed_std: (n,) error of the velocities [rad/s or m/s].
        dt: clock interval of the slowest recording [s].
        dt_out: time between two rows [s].
    """

    columns: Columns
    tiles: tuple[Tile, ...]
    recordings: tuple[str, ...]
    rigid: tuple[np.ndarray, ...]
    tau: np.ndarray
    measured: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    driven: np.ndarray
    run: np.ndarray
    recording: np.ndarray
    t: np.ndarray
    block: np.ndarray
    encoder_std: np.ndarray
    torque_step: np.ndarray
    noise_share: np.ndarray
    speed_std: np.ndarray
    dt: float
    dt_out: float
    _known: Remembered = field(default_factory=partial(Remembered, _MOST_REMEMBERED), repr=False)
    _rms: dict[Hashable, np.ndarray] = field(default_factory=dict, repr=False)

    @property
    def n_dof(self) -> int:
        """Number of joints."""
        return len(self.tau)

    @property
    def seen(self) -> list[bool]:
        """Which joints have a torque, (n,)."""
        return [bool(m.any()) for m in self.measured]

    @property
    def seen_recordings(self) -> list[str]:
        """Names of the recordings that have rows, in their order."""
        return [self.recordings[k] for k in np.unique(self.recording)]

    def load(self, pi: np.ndarray) -> np.ndarray:
        """Return the torque (n, M) of a rigid body with pi (n_params,)."""
        return np.stack([Y @ pi[own] for Y, own in zip(self.rigid, self.columns.inertial, strict=True)])

    def features(self, candidate: Candidate) -> np.ndarray:
        """Return the features of a candidate, (K, M) at its joint, or (K, n, M) for the whole robot."""

        key = _key(candidate)

        def evaluated() -> np.ndarray:
            F = self.evaluated(lambda signals: torch.stack(list(candidate.features(signals).values())))
            self._rms[key] = np.sqrt(np.mean(F**2, axis=-1))
            return F

        return self._known.of(key, evaluated)

    def rms(self, candidate: Candidate) -> np.ndarray:
        """Return the root mean square of the features of a candidate, (K,) at its joint, or (K, n)."""
        key = _key(candidate)
        if key not in self._rms:
            self.features(candidate)
        return self._rms[key]

    def through_bodies(self, effect: ShowsBodies, coefficients: np.ndarray) -> list[np.ndarray]:
        """Return per joint the derivative of its torque by inertial parameters through an effect, like ``rigid``."""
        w = torch.from_numpy(coefficients)
        parts = []
        for tile in self.tiles:
            Y = effect.through_bodies(tile.signals, w)
            own = (tile.states.decimate(Y[j, at]) for j, at in enumerate(self.columns.inertial))
            parts.append([one[:, tile.kept].T.numpy() for one in own])
        return [np.concatenate(own) for own in zip(*parts, strict=True)]

    def evaluated(self, function: Callable[[Signals], Tensor]) -> np.ndarray:
        """Return a function of the signals, (..., N) of each tile, through the same filter as the torque."""
        parts = [tile.states.decimate(function(tile.signals))[..., tile.kept].numpy() for tile in self.tiles]
        return np.concatenate(parts, axis=-1)

    def around(self, pi: Tensor, friction: Tensor, rest_width: np.ndarray) -> Rows:
        """Return the same rows with the torque of pi (n_params,) as load, and with friction in their signals.

        Args:
            pi: (n_params,) inertial parameters.
            friction: (n, 3), see ``Signals``.
            rest_width: (n,) speeds over which friction changes its sign [rad/s, m/s].
        """
        load = np.abs(self.load(pi.numpy())).max(1)
        scales = [
            replace(s, rest_width=float(w), load_max=float(most))
            for s, w, most in zip(self.columns.scales, rest_width, load, strict=True)
        ]
        return self._with(self.columns.of_candidates((), pi, friction).at_scales(scales))

    def at_widths(self, rest_width: np.ndarray) -> Rows:
        """Return the same rows, friction changing its sign over other speeds (n,) [rad/s, m/s]."""
        each = zip(self.columns.scales, rest_width.tolist(), strict=True)
        return self._with(self.columns.at_scales([replace(s, rest_width=w) for s, w in each]))

    def _with(self, columns: Columns) -> Rows:
        tiles = tuple(replace(t, signals=columns.signals(t.states)) for t in self.tiles)
        return replace(self.without_cache, columns=columns, tiles=tiles)

    @property
    def without_cache(self) -> Rows:
        """The same rows, none of whose features are cached."""
        return replace(self, _known=Remembered(_MOST_REMEMBERED), _rms={})


def read_rows(reading: Reading, columns: Columns, kept_back: KeptBack) -> Rows:
    """Stream recordings once and keep their rows.

    Args:
        reading: the recordings and their filters.
        columns: of the robot.
        kept_back: held-out times, which are not read.

    Raises:
        RecordingError: nothing remains to read.
    """
    tiles, parts, rigid = [], [], []
    looked_at = not_held_out(reading, kept_back)
    surveys = [reading.surveys[k] for k in looked_at]
    for k, states in _DENSITY.tiles(reading, looked_at):
        kept = ~kept_back(states.recording, states.t_out)
        if not kept.any():
            continue
        measured = reading.measured(k).unsqueeze(1)
        tau = states.decimate_torque(torch.where(measured, torch.nan_to_num(states.tau), 0.0))
        states = _DENSITY.thinned(states, reading.filtering.cutoff_hz)
        tiles.append(Tile(states, columns.signals(states), kept))
        Y = columns.robot.regressor_batch_last(states.q, states.qd, states.qdd)
        rigid.append([states.decimate(Y[j, own])[:, kept].T.numpy() for j, own in enumerate(columns.inertial)])
        part = {
            "tau": tau,
            "measured": measured.expand_as(tau),
            "q": states.decimate(states.q),
            "qd": states.decimate(states.qd),
            "qdd": states.decimate(states.qdd),
        }
        place = torch.tensor([k, states.segment, states.dt_out], dtype=torch.float64).expand(int(kept.sum()), 3)
        parts.append(
            {name: x[:, kept].numpy() for name, x in part.items()}
            | {"place": torch.cat((states.t_out[kept, None], place), 1).numpy()}
        )
    if not parts:
        _nothing_left(reading)
    joined = {name: np.concatenate([p[name] for p in parts], axis=int(name != "place")) for name in parts[0]}
    t, recording, segment, dt_out = joined.pop("place").T
    begins = (np.diff(t, prepend=-np.inf) > 1.5 * dt_out) | (np.diff(t, prepend=0.0) < 0)
    begins |= (np.diff(recording, prepend=-1) != 0) | (np.diff(segment, prepend=-1) != 0)
    return Rows(
        columns=columns,
        tiles=tuple(tiles),
        rigid=tuple(map(np.concatenate, zip(*rigid, strict=True))),
        recordings=tuple(r.name for r in reading.recordings),
        driven=reading.driven.numpy(),
        run=np.cumsum(begins),
        recording=recording.astype(int),
        t=t,
        block=_blocks(t, recording, reading.block_s),
        encoder_std=np.sqrt(np.mean([s.q_noise_std**2 for s in surveys], axis=0)),
        torque_step=np.fmax.reduce([s.tau_resolution for s in surveys]),
        noise_share=np.max([_noise_share(s, reading.filtering.cutoff_hz) for s in surveys], axis=0),
        speed_std=np.sqrt(np.mean([s.qd_error_std**2 for s in surveys], axis=0)),
        dt=max(s.clock.dt for s in surveys),
        dt_out=float(dt_out.max()),
        **joined,  # type: ignore[arg-type]
    )


def _key(candidate: Candidate) -> tuple[Hashable, ...]:
    return candidate.effect, candidate.site, *candidate.shape.items()


def _noise_share(survey: Survey, band_hz: float) -> np.ndarray:
    """Return the share (n,) of the positions' power that is noise at a frequency [Hz]."""
    return np.array([1.0 - np.interp(band_hz, survey.share_hz, share) for share in survey.motion_share])


def _blocks(t: np.ndarray, recording: np.ndarray, block_s: float) -> np.ndarray:
    """Number blocks of about ``block_s`` of one recording each, longer ones if there would be too many, (M,)."""
    total = sum(np.ptp(t[recording == k]) for k in np.unique(recording))
    places = np.stack((recording, np.floor(t / max(block_s, total / _MOST_BLOCKS))), axis=1)
    return np.unique(places, axis=0, return_inverse=True)[1].ravel()


def not_held_out(reading: Reading, kept_back: KeptBack) -> list[int]:
    """Return the numbers of the recordings that are not held out as a whole.

    Raises:
        RecordingError: all are.
    """
    ends = [s.segments[-1][1] for s in reading.surveys]
    times = [torch.arange(0.0, end + _LOOK_S, _LOOK_S, dtype=torch.float64) for end in ends]
    found = [k for k, r in enumerate(reading.recordings) if not bool(kept_back(r.name, times[k]).all())]
    return found or _nothing_left(reading)


def _nothing_left(reading: Reading) -> NoReturn:
    names = ", ".join(r.name for r in reading.recordings)
    raise RecordingError(f"nothing of {names} remains outside the held-out data; hold out less")
