"""A simulator's recording of the same commands, used in place of the URDF's prediction.

The simulator's torque beyond the URDF, at its own states s_s,

    x(t) = tau_s - tau_urdf(s_s),   tau_urdf(s) = Y(s) pi_urdf + f_urdf(s)

is subtracted from the real torque at the same time. It is moved to the recorded states s by the viscous and Coulomb
friction f_x that fits it best. The residual of the URDF's prediction is then

    tau - [x + f_x(s) - f_x(s_s)] - tau_urdf(s) = tau - [tau_s + tau_m(s) - tau_m(s_s)],   tau_m = tau_urdf + f_x

the difference to the simulated torque at the recorded states; where both motions are the same, tau_m cancels. Both pass
the same filters, so that their effect cancels too. A simulator's other inertials are part of x: the fitted inertials
are those of the URDF plus the difference between robot and simulator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np
import torch
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import convolve1d
from scipy.optimize import minimize_scalar
from torch import Tensor

from torchrbd.display import Remark
from torchrbd.errors import RecordingError
from torchrbd.recordings import Filtering, Recording, States, Survey, survey, tiles
from torchrbd.robot import RobotModel

# Differences of two motions, as fractions of a joint's RMS speed, above which there is a warning or an error.
WARNED, USELESS = 0.1, 0.5
# Largest clock offset and step of the search [s]; a shift is made if it reduces the difference to below this fraction.
_FURTHEST, _STEP, _BETTER = 2.0, 0.02, 0.5
_MOST_TIMES, _COARSE = 4000, 10
# Joints slower than this fraction of the fastest one are not compared.
_STILL = 0.01


@dataclass(frozen=True)
class Simulated:
    """A simulator's torque beyond the URDF, on the clock of a real recording.

    Attributes:
        name: of its recording.
        recording: name of the real one.
        shift_s: shift of the simulator's clock that fits the motion [s].
        difference: per joint that moves, RMS difference of the velocities over the RMS speed.
        begin_s, end_s: the part of the real recording that it covers.
    """

    name: str
    recording: str
    shift_s: float
    difference: dict[str, float]
    begin_s: float
    end_s: float
    _friction: _Friction
    _rest: BSpline

    def taken_off(self, states: States) -> States:
        """Return the states of a tile of the real recording with the simulator's extra torque subtracted."""
        inside = np.clip(states.t.numpy() + self.shift_s, self._rest.t[0], self._rest.t[-1])
        extra = torch.from_numpy(self._rest(inside).T) + self._friction.torque(states.qd)
        return replace(states, tau=states.tau - states.as_recorded(extra))


@dataclass(frozen=True)
class _Friction:
    """Viscous and Coulomb friction (n_dof,) each; the direction is softened below speeds ``width`` (n_dof,)."""

    viscous: Tensor
    coulomb: Tensor
    width: Tensor

    @classmethod
    def fitted(cls, qd: Tensor, tau: Tensor, width: Tensor) -> _Friction:
        """Fit velocities and torques (n_dof, N)."""
        features = torch.stack((qd, torch.tanh(qd / width.unsqueeze(1))), -1)
        viscous, coulomb = torch.linalg.lstsq(features, tau.unsqueeze(-1), driver="gelsd").solution.squeeze(-1).T
        return cls(viscous, coulomb, width)

    def torque(self, qd: Tensor) -> Tensor:
        """Return the torque (n_dof, N) at velocities (n_dof, N)."""
        viscous, coulomb, width = (x.unsqueeze(1) for x in (self.viscous, self.coulomb, self.width))
        return viscous * qd + coulomb * torch.tanh(qd / width)


def read_simulated(
    robot: RobotModel,
    real: Recording,
    found: Survey,
    simulated: Recording,
    filtering: Filtering,
    rest_width: Tensor,
) -> Simulated:
    """Read a simulator's recording and match it with the real one.

    Args:
        robot: as described by the URDF.
        real: the real recording, and ``found``, its survey.
        simulated: that of the simulator.
        filtering: of all.
        rest_width: (n_dof,) speed below which a joint's direction is uncertain.

    Raises:
        RecordingError: torques are missing, the clock has gaps or is too slow, or the motion is another one.
    """
    seen = survey(simulated)
    _check(robot, real, simulated, seen, filtering)
    t, q, qd, qdd, tau = _states(simulated, seen, filtering)
    rigid = (robot.inverse_dynamics(q.T, qd.T, qdd.T) + robot.known_torque(q.T, qdd.T)).T
    urdf = rigid + _Friction(robot.damping, robot.friction, rest_width).torque(qd)
    extra = torch.where(torch.from_numpy(real.measured).unsqueeze(1), tau - urdf, 0.0)
    friction = _Friction.fitted(qd, extra, rest_width)
    rest = (extra - friction.torque(qd)).T.numpy()
    if found.clock.dt > seen.clock.dt:
        # Remove frequencies that would alias into the band of the slower clock.
        kernel = Filtering(1.0 / (3.0 * found.clock.dt)).feature_kernel(seen.clock.dt).numpy()
        rest = convolve1d(rest, kernel, axis=0, mode="nearest")
    speed = make_interp_spline(t.numpy(), qd.T.numpy(), k=3)
    shift, difference = _matched(real, found, speed, filtering)
    lost = (filtering.state_kernels(found.clock.dt).shape[1] // 2) * found.clock.dt
    begin, end = float(t[0]) - shift - lost, float(t[-1]) - shift + lost
    spline = make_interp_spline(t.numpy(), rest, k=3)
    return Simulated(simulated.name, real.name, shift, difference, begin, end, friction, spline)


def cut(recording: Recording, to: Simulated) -> Recording:
    """Return the part of a real recording that a simulated one covers."""
    begin, end = recording.time or (-np.inf, np.inf)
    return recording.of_joints(recording.joints, (max(begin, to.begin_s), min(end, to.end_s)))


def check_motion(found: Simulated) -> None:
    """Raise an error if the simulation moved differently.

    Raises:
        RecordingError: a joint's velocity differs too much to compare its torque.
    """
    far = {j: d for j, d in found.difference.items() if d > USELESS}
    if far:
        raise RecordingError(
            f"{found.name}: moves otherwise than {found.recording}: the velocities differ by "
            f"{_parts(far)} of the RMS speed; both must follow the same commands from the same start, and simulated "
            "recordings stand in the order of the real ones"
        )


def motion_doubts(found: Sequence[Simulated]) -> tuple[Remark, ...]:
    """Return where motions differ so much that the simulator's torque belongs to another motion."""
    doubts = []
    for one in found:
        far = {j: d for j, d in one.difference.items() if d > WARNED}
        if far:
            values = {"simulated": one.name, "recording": one.recording, "differences": far}
            doubts.append(Remark("other simulated motion", values))
    return tuple(doubts)


def simulation_notes(found: Sequence[Simulated]) -> tuple[Remark, ...]:
    """Return notes on the model that all is compared with."""
    if not found:
        return ()
    shifts = (
        Remark("simulation's clock moved", {"recording": one.recording, "shift_s": float(one.shift_s)}, one.name)
        for one in found
        if one.shift_s
    )
    return Remark("compared with a simulation", {"pairs": [[one.name, one.recording] for one in found]}), *shifts


def _check(robot: RobotModel, real: Recording, simulated: Recording, seen: Survey, filtering: Filtering) -> None:
    missing = list(compress(robot.joint_names, real.measured & ~simulated.measured))
    if missing:
        raise RecordingError(
            f"{simulated.path or simulated.name}: no torque for {', '.join(missing)}, which {real.name} has; let the "
            "simulator record it"
        )
    if len(seen.segments) > 1:
        raise RecordingError(
            f"{simulated.path or simulated.name}: {len(seen.segments)} pieces with gaps between them; a simulated "
            "recording must be whole"
        )
    slowest = 3.0 * filtering.cutoff_hz
    if seen.rate_hz < slowest * (1 - 1e-6):
        raise RecordingError(
            f"{simulated.path or simulated.name}: recorded at {seen.rate_hz:.4g} Hz; the cut-off "
            f"{filtering.cutoff_hz:g} Hz needs {slowest:.4g} Hz; record faster or lower --cutoff"
        )


def _states(recording: Recording, seen: Survey, filtering: Filtering) -> list[Tensor]:
    """Return t (N,) and filtered q, qd, qdd and raw tau (n, N) of a whole recording."""
    parts: list[list[Tensor]] = []
    latest = -np.inf
    for states in tiles(recording, seen, filtering):
        fresh = states.t > latest + 0.5 * states.dt
        parts.append([x[..., fresh] for x in (states.t, states.q, states.qd, states.qdd, states.tau)])
        latest = float(states.t[-1])
    return [torch.cat(x, -1) for x in zip(*parts, strict=True)]


def _matched(real: Recording, found: Survey, speed: BSpline, filtering: Filtering) -> tuple[float, dict[str, float]]:
    """Return the shift [s] of the simulator's clock with the best fit of velocities, and the differences left."""
    t, _, qd, *_ = (x.numpy() for x in _states(real, found, filtering))
    qd = qd.T
    step = max(1, len(t) // _MOST_TIMES)
    t, qd = t[::step], qd[::step]
    rms = np.sqrt(np.mean(qd**2, axis=0))
    moving = rms > _STILL * rms.max()
    least = 0.5 * min(1.0, (speed.t[-1] - speed.t[0]) / (t[-1] - t[0]))

    def difference(shift: float, every: int = 1) -> np.ndarray:
        at = t[::every] + shift
        inside = (at >= speed.t[0]) & (at <= speed.t[-1])
        if inside.mean() < least:
            return np.full(moving.sum(), np.inf)
        off = (qd[::every][inside] - speed(at[inside]))[:, moving]
        return np.sqrt(np.mean(off**2, axis=0)) / rms[moving]

    def total(shift: float, every: int = 1) -> float:
        return float((difference(shift, every) ** 2).sum())

    best = min(np.arange(-_FURTHEST, _FURTHEST + _STEP, _STEP), key=lambda shift: total(float(shift), _COARSE))
    finest: Any = minimize_scalar(total, bounds=(best - _STEP, best + _STEP), method="bounded")
    shift = float(finest.x)
    if abs(shift) < 0.25 * found.clock.dt or not total(shift) < _BETTER * total(0.0):
        shift = 0.0
    return shift, dict(zip(compress(real.joints, moving), difference(shift).tolist(), strict=True))


def _parts(joints: dict[str, float]) -> str:
    return ", ".join(f"{100 * d:.0f} % at {joint}" for joint, d in joints.items())
