"""Cut a recording into tiles of filtered states, the input of all fits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchrbd._runtime.filters import convolved, thinned
from torchrbd.errors import RecordingError
from torchrbd.recordings.blocks import Block
from torchrbd.recordings.clock import uniform_blocks
from torchrbd.recordings.filtering import Filtering
from torchrbd.recordings.low_pass import LowPass
from torchrbd.recordings.recording import Recording
from torchrbd.recordings.survey import Survey
from torchrbd.robot import RobotModel

TILE_ROWS = 4096
"""Approximate number of samples in a tile."""
# Largest number of earlier turning points of a joint that a piece keeps.
_MOST_TURNS = 256


@dataclass(frozen=True)
class States:
    """One contiguous piece of one segment on the uniform clock; float64, batch last.

    Compute features from (q, qd, qdd) at all N samples, then `decimate` them, and `decimate_torque` the torque: outputs
    of consecutive tiles join without gap or repetition. The two differ by what torques had passed before.

    Attributes:
        segment: index of the segment in the recording.
        dt: clock interval [s].
        t: (N,) seconds since the recording's first row.
        q, qd, qdd: (n, N) low-passed by the state filter [rad or m, per s, per s^2].
        tau: (n, N) raw [N m or N]; NaN for joints without torque. Use it only through `decimate_torque`.
        t_out: (M,) times of the outputs of `decimate` [s].
        recording: name of the recording.
        reference: set-points q_ref, qd_ref, qdd_ref (n, N) each, low-passed like q; None if not recorded.
        q_link: (n, N) positions behind the gears [rad or m], low-passed like q, NaN for joints without such an encoder;
            None if not recorded.
        temperature: (n, N) of the joints [deg C], low-passed like q, NaN for joints without; None if not recorded.
        turned: per joint, the segment's first position and the turning points before this piece (R_j,), the latest
            ones, oldest first [rad or m]; empty in a segment's first piece.
        loaded: (n_params,) inertial parameters of a known load, whose torque is subtracted from ``tau``; None without
            one.
        known: (n, N) torque of rotors and springs in the robot's description, subtracted from ``tau`` as it would have
            been recorded; None without.
        low_pass: what recorded torques had passed; None if nothing.
    """

    segment: int
    dt: float
    t: torch.Tensor
    q: torch.Tensor
    qd: torch.Tensor
    qdd: torch.Tensor
    tau: torch.Tensor
    t_out: torch.Tensor
    _kernel: torch.Tensor
    _torque_kernel: torch.Tensor
    _stride: int
    recording: str
    reference: tuple[torch.Tensor, torch.Tensor, torch.Tensor] | None = None
    q_link: torch.Tensor | None = None
    temperature: torch.Tensor | None = None
    turned: tuple[torch.Tensor, ...] = ()
    loaded: torch.Tensor | None = None
    known: torch.Tensor | None = None
    low_pass: LowPass | None = None

    @property
    def dt_out(self) -> float:
        """Return the time between two outputs of `decimate` [s]."""
        return self._stride * self.dt

    @property
    def stride(self) -> int:
        """Return the number of samples between two outputs of `decimate`."""
        return self._stride

    def taken_off(self, robot: RobotModel) -> torch.Tensor:
        """Return the known torque (n, N) taken off ``tau``: of a load, and of the robot's rotors and springs."""
        known = torch.zeros_like(self.tau) if self.known is None else self.known
        if self.loaded is None:
            return known
        return known + robot.inverse_dynamics(self.q.T, self.qd.T, self.qdd.T, self.loaded).T

    @property
    def motion_out(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return q, qd and qdd at the times of the outputs, (n, M) each, without a second low-pass."""
        half, last = self._kernel.shape[0] // 2, (self.t_out.shape[0] - 1) * self._stride
        q, qd, qdd = (x[:, half : half + last + 1 : self._stride] for x in (self.q, self.qd, self.qdd))
        return q, qd, qdd

    def thinned(self, step: int) -> States:
        """Return every `step`-th sample, with the same outputs; `step` divides `stride`. Torques are not filtered."""
        half = self._kernel.shape[0] // 2
        kernel, torque_kernel = (k[half % step :: step] for k in (self._kernel, self._torque_kernel))

        def thin(x: torch.Tensor) -> torch.Tensor:
            # A copy: a view would keep all samples in memory.
            return x[..., half % step :: step].contiguous()

        cut = {name: thin(getattr(self, name)) for name in ("t", "q", "qd", "qdd", "tau")}
        return replace(
            self,
            dt=step * self.dt,
            _kernel=kernel / kernel.sum(),
            _torque_kernel=torque_kernel / torque_kernel.sum(),
            _stride=self._stride // step,
            reference=None if self.reference is None else tuple(map(thin, self.reference)),
            q_link=None if self.q_link is None else thin(self.q_link),
            temperature=None if self.temperature is None else thin(self.temperature),
            known=None if self.known is None else thin(self.known),
            **cut,
        )

    def decimate(self, x: torch.Tensor) -> torch.Tensor:
        """Low-pass x (..., N) with the feature filter and keep every `stride`-th sample: (..., M). Differentiable."""
        return thinned(x, self._kernel, self._stride, self.t_out.shape[0])

    def as_recorded(self, x: torch.Tensor) -> torch.Tensor:
        """Return torques x (..., N) as they would have been recorded; near both ends only roughly."""
        if self.low_pass is None:
            return x
        kernel = torch.from_numpy(self.low_pass.kernel(self.dt)).to(x)
        half = len(kernel) // 2
        padded = torch.cat((x[..., :1].expand(*x.shape[:-1], half), x, x[..., -1:].expand(*x.shape[:-1], half)), -1)
        return thinned(padded, kernel, 1, x.shape[-1])

    def decimate_torque(self, x: torch.Tensor) -> torch.Tensor:
        """Return the same of recorded torques x (..., N), which had passed a part of the feature filter before."""
        return thinned(x, self._torque_kernel, self._stride, self.t_out.shape[0])


def tiles(recording: Recording, survey: Survey, filtering: Filtering, rows: int = TILE_ROWS) -> Iterator[States]:
    """Stream a recording as tiles of about `rows` new samples each (plus the feature filter's length at both ends).

    The ends of segments, where the filters do not fit, have no output; shorter segments have none at all.

    Raises: RecordingError if no segment is long enough for the filters.
    """
    cutter = _Cutter(recording, survey, filtering, rows)
    for block in uniform_blocks(recording, survey.clock):
        yield from cutter.push(block)
    yield from cutter.finish()
    if not cutter.produced:
        longest = max((end - start for start, end in survey.segments), default=0.0)
        raise RecordingError(
            f"{recording.path or recording.name}: the longest uninterrupted piece lasts {longest:.3g} s, but the "
            f"filters at {filtering.cutoff_hz:g} Hz need {2 * cutter.reach * survey.clock.dt:.3g} s; "
            f"leave the recording out or raise the cut-off"
        )


def skipped_segments(survey: Survey, filtering: Filtering) -> tuple[tuple[float, float], ...]:
    """Return the segments (from, to) [s] that are too short for the filters, which `tiles` omits."""
    shortest = 2 * filtering.reach(survey.clock.dt) * survey.clock.dt
    return tuple((start, end) for start, end in survey.segments if end - start < shortest * (1 - 1e-9))


class _Cutter:
    """Collect samples, and cut tiles from them."""

    def __init__(self, recording: Recording, survey: Survey, filtering: Filtering, rows: int):
        self._name, self._dt = recording.name, survey.clock.dt
        self._linked, self._thermal = torch.from_numpy(recording.linked), torch.from_numpy(recording.thermal)
        self._referenced = torch.from_numpy(recording.referenced)
        self._use_velocity = torch.from_numpy(~np.isnan(survey.qd_noise_std))
        # If the velocity is measured, positions are not differentiated, and their noise is small.
        share = np.where(np.isnan(survey.qd_noise_std)[:, None], survey.motion_share, 1.0)
        self._kernels = filtering.motion_kernels(self._dt, share, survey.acceleration_density, survey.share_hz)
        self._feature_kernel, self._torque_kernel = (
            filtering.feature_kernel(self._dt),
            filtering.torque_kernel(self._dt),
        )
        self._low_pass = filtering.low_pass
        self._stride = filtering.stride(self._dt)
        self._state_half = self._kernels.shape[2] // 2
        self._feature_half = self._feature_kernel.shape[0] // 2
        self._outputs = max(1, rows // self._stride)
        self.reach = filtering.reach(self._dt)
        self.produced = False
        self._segment, self._origin, self._index, self._x = -1, 0.0, 0, np.empty((0, 0))
        self._ends = 0, 0, 0
        self._turned: tuple[torch.Tensor, ...] = ()

    def push(self, block: Block) -> Iterator[States]:
        """Add samples; yield the tiles that are now complete."""
        if block.segment != self._segment:
            yield from self.finish()
            self._segment, self._origin, self._index, self._x = block.segment, float(block.t[0]), 0, block.channels
            self._ends, self._turned = block.ends, ()
        else:
            self._x = np.concatenate([self._x, block.channels], axis=1)
        while self._available() >= self._outputs:
            yield self._cut(self._outputs)

    def finish(self) -> Iterator[States]:
        """Close the segment: yield the remaining samples as a shorter tile."""
        if self._available() > 0:
            yield self._cut(self._available())
        self._x = np.empty((0, 0))

    def _available(self) -> int:
        return (self._x.shape[1] - 2 * self.reach - 1) // self._stride + 1

    def _cut(self, outputs: int) -> States:
        length = (outputs - 1) * self._stride + 2 * self._feature_half + 1
        n, half = len(self._use_velocity), self._state_half
        raw = torch.from_numpy(self._x[:, : length + 2 * half])
        q, qd, qdd = convolved(raw[:n], self._kernels)
        if self._use_velocity.any():
            measured = convolved(raw[2 * n : self._ends[0]], self._kernels[:, :2])
            qd = torch.where(self._use_velocity[:, None], measured[0], qd)
            qdd = torch.where(self._use_velocity[:, None], measured[1], qdd)
        reference = None
        if self._ends[1] > self._ends[0] and self._referenced.all():
            q_ref, qd_ref, qdd_ref = convolved(raw[self._ends[0] : self._ends[1]], self._kernels)
            reference = q_ref, qd_ref, qdd_ref
        q_link = self._partly(raw[self._ends[1] : self._ends[2]], self._linked)
        temperature = self._partly(raw[self._ends[2] :], self._thermal)
        t = self._origin + self._dt * torch.arange(self._index + half, self._index + half + length, dtype=torch.float64)
        t_out = t[self._feature_half : length - self._feature_half : self._stride]
        tau = raw[n : 2 * n, half : half + length].clone()
        passed = outputs * self._stride
        self._x = self._x[:, passed:]
        self._index += passed
        self.produced = True
        filters = self._feature_kernel, self._torque_kernel, self._stride
        optional = reference, q_link, temperature, self._turned
        low_pass = self._low_pass
        self._turned = tuple(
            _turns(torch.cat(path)) for path in zip(self._turned or q[:, :0], q[:, :passed], strict=True)
        )
        return States(
            self._segment, self._dt, t, q, qd, qdd, tau, t_out, *filters, self._name, *optional, low_pass=low_pass
        )

    def _partly(self, x: torch.Tensor, there: torch.Tensor) -> torch.Tensor | None:
        """Return x (m, samples), low-passed like positions, for all joints (n, N), NaN for those not in ``there``."""
        if not there.any():
            return None
        filtered = convolved(x, self._kernels[there, :1])[0]
        whole = filtered.new_full((len(there), filtered.shape[1]), torch.nan)
        whole[there] = filtered
        return whole


def _turns(path: torch.Tensor) -> torch.Tensor:
    """Return the first and the last position of a path (N,), and its turning points between them: (R,)."""
    ways = torch.sign(torch.diff(path))
    ends = ways.new_full((1,), torch.nan)
    turns = torch.cat((ends, ways)) != torch.cat((ways, ends))
    return path[turns][-_MOST_TURNS:]
