"""Scan a recording once: its clock, its motion, its noise, and the cut-off that suits it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from torchrbd.display import Remark
from torchrbd.errors import RecordingError
from torchrbd.recordings.clock import Census, Clock, uniform_blocks
from torchrbd.recordings.recording import Recording
from torchrbd.recordings.spectrum import HIGHEST_SHARE, Spectrum, two_digits

# _PEAK: in RMS; larger peaks are no motion. _VELOCITY_ERROR: a measured velocity with a larger relative error is not
# dq/dt. _FOLLOWS: a position behind the gear with a larger relative error belongs to another joint; this needs a range
# of _MOVES [rad, m]. _STUCK_S: a torque that is constant for so long [s] while its joint moves by _MOVES is not
# recorded, or its drive is off.
_PEAK, _VELOCITY_ERROR, _FOLLOWS, _MOVES, _STUCK_S = 30.0, 0.2, 0.2, 0.01, 1.0
# Largest range of noise, in its standard deviations.
_NOISE_REACHES = 20.0
# Relative changes below this are no signal of a sensor: interpolation changes a constant in its last digits.
_SAME = 1e-9


@dataclass(frozen=True)
class Survey:
    """The result of one pass over a recording.

    Attributes:
        name: the recording's name.
        clock: the uniform clock, and its limits for gaps.
        rate_hz: 1 / clock.dt.
        rows: rows read. duplicates, incomplete: of these, dropped as repeated in time, or with a missing value.
        segments: (from, to) of the uninterrupted pieces [s].
        duration_s: their total length.
        q_min, q_max: (n,) [rad or m].
        velocity_rms, velocity_max: (n,) over 50 ms [rad/s or m/s].
        tau_rms: (n,) [N m or N], NaN where not measured.
        q_noise_std: (n,) white noise of the positions, from the spectrum above the motion [rad or m].
        q_resolution, tau_resolution: (n,) quantisation steps, NaN if none is seen [rad or m, N m or N].
        qd_noise_std: (n,) white noise of the measured velocity for joints whose measured velocity is used instead of
            the differentiated position; NaN for the others [rad/s or m/s].
        motion_share: (n, F) share of the positions' power that is motion and not noise, at ``share_hz`` (F,) [Hz].
        acceleration_density: (n, F) power density of the positions, differentiated twice, there [rad²/s³ or m²/s³].
        link_ratio: (n,) slope of the position behind the gear over q, by least squares; NaN if it is not recorded or q
            hardly moves.
        link_differs: (n,) bool, whether it differs from q anywhere; False if it is not recorded.
        temperature_min, temperature_max: (n,) [deg C], NaN where not recorded.
        cutoff_hz: the cut-off that suits this recording.
        torque_ends_hz: frequency above which no torque has more than rounding [Hz]; NaN if one has.
        constant_q, constant_tau: joints whose position or torque never changes.
        notes: what a user should know of it.
    """

    name: str
    clock: Clock
    rate_hz: float
    rows: int
    duplicates: int
    incomplete: int
    segments: tuple[tuple[float, float], ...]
    duration_s: float
    q_min: np.ndarray
    q_max: np.ndarray
    velocity_rms: np.ndarray
    velocity_max: np.ndarray
    tau_rms: np.ndarray
    q_noise_std: np.ndarray
    q_resolution: np.ndarray
    tau_resolution: np.ndarray
    qd_noise_std: np.ndarray
    motion_share: np.ndarray
    share_hz: np.ndarray
    acceleration_density: np.ndarray
    link_ratio: np.ndarray
    link_differs: np.ndarray
    temperature_min: np.ndarray
    temperature_max: np.ndarray
    cutoff_hz: float
    torque_ends_hz: float
    constant_q: tuple[str, ...]
    constant_tau: tuple[str, ...]
    notes: tuple[Remark, ...]

    @property
    def qd_error_std(self) -> np.ndarray:
        """Standard deviation of the error of velocities estimated from noisy positions (Wiener), (n,) [rad/s or m/s].

        At each frequency the error's density is the share that is motion times the density of the noise.
        """
        density = 2.0 * self.clock.dt * self.q_noise_std**2
        power = self.motion_share * (2.0 * np.pi * self.share_hz) ** 2
        return np.sqrt(density * np.trapezoid(power, self.share_hz, axis=1))

    @property
    def at_rest(self) -> bool:
        """Whether the positions of all joints are only noise."""
        return bool((self.q_max - self.q_min <= _NOISE_REACHES * self.q_noise_std).all())

    @property
    def link_follows(self) -> np.ndarray:
        """Whether each joint's position behind the gear moves like q, as far as q moves at all, (n,) bool."""
        return ~(np.abs(self.link_ratio - 1.0) > _FOLLOWS)


def choose_cutoff(surveys: Sequence[Survey]) -> float:
    """Choose one cut-off [Hz] for a data set: the median of the recordings' cut-offs, within the limits of all clocks.

    Recordings at rest have no motion and do not count.
    """
    moving = [survey for survey in surveys if not survey.at_rest] or surveys
    proposal = float(np.median([survey.cutoff_hz for survey in moving]))
    return two_digits(min(proposal, *(HIGHEST_SHARE * survey.rate_hz for survey in surveys)))


def survey(recording: Recording) -> Survey:
    """Stream a recording once and describe it.

    Raises: RecordingError if it is too short or nothing in it moves.
    """
    clock = Clock.of(recording)
    n = len(recording.joints)
    census, extent, spectrum = Census(n), _Extent(2 * n), Spectrum(clock.dt, n, recording.has_velocity)
    warmth, follower = _Extent(int(recording.thermal.sum())), _Follower(int(recording.linked.sum()))
    stuck = [_Stuck() for _ in range(n)]
    segments: dict[int, tuple[float, float]] = {}
    for block in uniform_blocks(recording, clock, census):
        start, _ = segments.setdefault(block.segment, (float(block.t[0]), 0.0))
        segments[block.segment] = (start, float(block.t[-1]))
        extent.add(block.x[: 2 * n])
        spectrum.add(block)
        for one, q, tau in zip(stuck, block.x[:n], block.x[n : 2 * n], strict=True):
            one.add(block.t, q, tau)
        if block.q_link is not None:
            follower.add(block.x[:n][recording.linked], block.q_link)
        if block.temperature is not None:
            warmth.add(block.temperature)
    spectrum.close()
    lengths = [end - start for start, end in segments.values()]
    place = recording.path or recording.name
    if not segments:
        notes = "; ".join(map(str, _notes(recording, census, 0)))
        raise RecordingError(f"{place}: no four usable rows in succession: {notes}")
    q_moves, tau_varies = np.split(extent.varies, 2)
    if not q_moves.any():
        raise RecordingError(f"{place}: nothing moves: the position of every joint is constant")
    cutoff_hz = spectrum.cutoff(q_moves, max(lengths))
    qd_noise_std = spectrum.qd_noise_std(cutoff_hz)
    coldest, warmest, link_ratio = np.full((3, n), np.nan)
    coldest[recording.thermal], warmest[recording.thermal] = warmth.low, warmth.high
    link_ratio[recording.linked] = follower.ratio
    link_differs = recording.linked.copy()
    link_differs[recording.linked] = follower.differs
    link_ratio[(extent.high - extent.low)[:n] < _MOVES] = np.nan
    suspicions = [
        *(
            note
            for k in np.flatnonzero(tau_varies & recording.measured)
            for note in stuck[k].notes(recording.joints[k])
        ),
        *_suspicions(recording, extent, spectrum, ~np.isnan(qd_noise_std)),
        *_strangers(recording, link_ratio, link_differs),
    ]
    return Survey(
        name=recording.name,
        clock=clock,
        rate_hz=1 / clock.dt,
        rows=census.rows,
        duplicates=census.duplicates,
        incomplete=census.incomplete,
        segments=tuple(segments.values()),
        duration_s=sum(lengths),
        q_min=extent.low[:n],
        q_max=extent.high[:n],
        velocity_rms=spectrum.velocity_rms,
        velocity_max=spectrum.velocity_max,
        tau_rms=extent.rms[n:],
        q_noise_std=np.fmax(spectrum.q_noise_std(), census.resolution / np.sqrt(12)),
        q_resolution=census.resolution,
        tau_resolution=census.tau_resolution,
        qd_noise_std=qd_noise_std,
        motion_share=spectrum.motion_share(step=census.resolution, regular=clock.regular),
        share_hz=spectrum.frequency,
        acceleration_density=spectrum.smooth_acceleration,
        link_ratio=link_ratio,
        link_differs=link_differs,
        temperature_min=coldest,
        temperature_max=warmest,
        cutoff_hz=cutoff_hz,
        torque_ends_hz=spectrum.torque_ends_hz,
        constant_q=tuple(compress(recording.joints, ~q_moves)),
        constant_tau=tuple(compress(recording.joints, ~tau_varies & recording.measured)),
        notes=(*recording.notes, *_notes(recording, census, len(segments)), *suspicions),
    )


def _suspicions(recording: Recording, extent: _Extent, spectrum: Spectrum, velocity_used: np.ndarray) -> list[Remark]:
    """Return hints at wrong units or bad samples."""
    joints, n, notes = recording.joints, len(recording.joints), []
    for k, joint in enumerate(joints):
        if spectrum.velocity_max[k] > _PEAK * spectrum.velocity_rms[k] > 0:
            speed, usual = float(spectrum.velocity_max[k]), float(spectrum.velocity_rms[k])
            notes.append(Remark("position jumps", {"joint": joint, "speed": speed, "ratio": speed / usual}))
        peak, rms = max(-float(extent.low[n + k]), float(extent.high[n + k])), float(extent.rms[n + k])
        if peak > _PEAK * rms > 0:
            notes.append(Remark("torque peaks", {"joint": joint, "torque": peak, "ratio": peak / rms}))
    for joint, ratio, used in zip(joints, spectrum.velocity_ratio, velocity_used, strict=True):
        if abs(ratio - 1) > _VELOCITY_ERROR and not used:
            notes.append(Remark("velocity differs from dq/dt", {"joint": joint, "ratio": float(ratio)}))
    return notes


def _strangers(recording: Recording, link_ratio: np.ndarray, differs: np.ndarray) -> list[Remark]:
    """Return notes on positions behind the gear that do not move like q, or are a copy of it."""
    copies = compress(recording.joints, recording.linked & ~differs)
    return [Remark("q_link equals q", {"joint": joint}) for joint in copies] + [
        Remark("q_link differs from q", {"joint": joint, "ratio": float(ratio)})
        for joint, ratio in zip(recording.joints, link_ratio, strict=True)
        if abs(ratio - 1.0) > _FOLLOWS
    ]


class _Follower:
    """Accumulate the regression of one signal on another, for several channels, and whether they differ at all."""

    def __init__(self, channels: int):
        self._start: np.ndarray | None = None
        self._sums, self._products, self._count = np.zeros((2, channels)), np.zeros((2, channels)), 0
        self.differs = np.zeros(channels, dtype=bool)

    def add(self, x: np.ndarray, y: np.ndarray) -> None:
        self.differs |= (x != y).any(1)
        if self._start is None:  # far from zero, sums of squares would lose the motion
            self._start = np.stack([x[:, :1], y[:, :1]])
        x, y = x - self._start[0], y - self._start[1]
        self._sums += np.stack([x.sum(1), y.sum(1)])
        self._products += np.stack([(x * x).sum(1), (x * y).sum(1)])
        self._count += x.shape[1]

    @property
    def ratio(self) -> np.ndarray:
        """Slope of y over x, NaN if x does not change."""
        square, product = self._products - self._sums[0] * self._sums / max(1, self._count)
        return np.divide(product, square, out=np.full_like(square, np.nan), where=square > 1e-12 * self._products[0])


class _Stuck:
    """Measure for how long a torque is constant while its joint moves."""

    def __init__(self) -> None:
        self._value, self._since = np.inf, np.array([np.nan] * 3)
        self._longest = (0.0, 0.0, 0.0)

    def add(self, t: np.ndarray, q: np.ndarray, tau: np.ndarray) -> None:
        """Add times, positions and torques (N,) that follow the earlier ones."""
        fresh = np.abs(np.diff(tau, prepend=self._value)) > _SAME * (1 + np.abs(tau))
        begins = np.union1d(0, np.flatnonzero(fresh))
        ends = np.append(begins[1:], len(t)) - 1
        runs = np.stack((t[begins], np.minimum.reduceat(q, begins), np.maximum.reduceat(q, begins)))
        if not fresh[0]:
            begin, low, high = self._since
            runs[:, 0] = begin, min(low, runs[1, 0]), max(high, runs[2, 0])
        self._value, self._since = float(tau[-1]), runs[:, -1].copy()
        lengths = (t[ends] - runs[0]) * (runs[2] - runs[1] > _MOVES)
        k = int(lengths.argmax())
        self._longest = max(self._longest, (float(lengths[k]), float(runs[0, k]), float(tau[begins[k]])))

    def notes(self, joint: str) -> list[Remark]:
        """Return a note for a joint, with the longest time."""
        length, begin, value = self._longest
        if length < _STUCK_S:
            return []
        values = {"joint": joint, "torque": value, "begin_s": begin, "end_s": begin + length}
        return [Remark("torque constant in motion", values)]


class _Extent:
    """Accumulate range and mean square of channels."""

    def __init__(self, channels: int):
        self.low, self.high = np.full(channels, np.inf), np.full(channels, -np.inf)
        self._square, self._count = np.zeros(channels), 0

    def add(self, x: np.ndarray) -> None:
        self.low, self.high = np.minimum(self.low, x.min(axis=1)), np.maximum(self.high, x.max(axis=1))
        self._square += np.sum(x**2, axis=1)
        self._count += x.shape[1]

    @property
    def rms(self) -> np.ndarray:
        return np.sqrt(self._square / max(1, self._count))

    @property
    def varies(self) -> np.ndarray:
        return self.high - self.low > _SAME * (1 + np.abs(self.high))


def _notes(recording: Recording, census: Census, segments: int) -> tuple[Remark, ...]:
    notes = []
    if census.duplicates:
        notes.append(Remark("repeated times", {"dropped": census.duplicates, "rows": census.rows}))
    if census.incomplete:
        channels = [(signal, joint) for signal in ("q", "tau") for joint in recording.joints]
        sources = (recording.source(*channels[k]) for k in np.flatnonzero(census.missing == census.rows))
        empty = [source.column for source in sources if source is not None]
        values = {"dropped": census.incomplete, "rows": census.rows, "empty": empty}
        notes.append(Remark("missing values", values))
    if segments > 1:
        notes.append(Remark("gaps in time", {"pieces": segments}))
    if census.wrapped:
        wrapped = [recording.joints[index] for index in sorted(census.wrapped)]
        notes.append(Remark("full turns unwrapped", {"joints": wrapped}))
    if recording.has_acceleration:
        notes.append(Remark("accelerations not used"))
    return tuple(notes)
