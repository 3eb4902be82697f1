"""The size of an effect: what is left of its torque after projection on rigid-body and friction columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from .contract import Effect, Window
from .motion import Motion, direction
from .simulate import Refused

RATE_HZ = 100.0
"""Of the motions that sizes are computed on."""
_BAND_HZ, _EVERY = 10.0, 4
_LEAST = 0.002  # of the largest torque of all joints: joints with less carry nothing worth a name
_CLOSE = 0.03


@dataclass(frozen=True)
class Size:
    """Of an effect's torque, in parts of the RMS of the joint's torque.

    Attributes:
        left: (n,) after projection.
        raw: (n,) before.
    """

    left: np.ndarray
    raw: np.ndarray


class Yardstick:
    """Measure torques along fit recordings, in the band below 10 Hz, joints weighed by their torque.

    Columns: Pinocchio's regressor of all inertial parameters; qd and sign(qd) of each joint.
    """

    def __init__(self, motions: Sequence[Motion], torques: Sequence[np.ndarray]) -> None:
        """Take motions at RATE_HZ and their recorded torques (N, n)."""
        self.motions = motions
        self.total = np.concatenate([_smooth(tau) for tau in torques])
        self.rms = np.sqrt(np.mean(self.total**2, axis=0))
        self.joints = np.flatnonzero(self.rms > _LEAST * self.rms.max())
        n, rigid, friction = motions[0].robot.n, [], []
        for x in motions:
            q, qd, qdd = x.q[::_EVERY], _smooth(x.qd), _smooth(x.qdd)
            rigid.append(x.robot.regressor(q, qd, qdd) / self.rms[:, None])
            signs = _smooth(direction(x.qd))
            friction.append(np.concatenate([np.eye(n) * qd[:, None], np.eye(n) * signs[:, None]], axis=2))
        Y = np.concatenate(rigid).reshape(-1, 10 * n)
        both = np.concatenate([Y, np.concatenate(friction).reshape(-1, 2 * n)], axis=1)
        self._bases = {False: _basis(Y), True: _basis(both)}

    def size(self, torques: Sequence[np.ndarray], beside_friction: bool = True, window: Window | None = None) -> Size:
        """Measure torques (N, n), one for each motion; inside a window only, if the effect has one."""
        e = np.concatenate([_smooth(tau) for tau in torques]) / self.rms
        Q = self._bases[beside_friction]
        left = (e.ravel() - Q @ (Q.T @ e.ravel())).reshape(e.shape)
        total = self.total / self.rms
        if window is not None:
            rows = np.concatenate([np.broadcast_to(window.holds(x), x.t.shape)[::_EVERY] for x in self.motions])
            left, e, total = left[rows], e[rows], total[rows]
        unit = np.sqrt(np.mean(total**2, axis=0))
        return Size(np.sqrt(np.mean(left**2, axis=0)) / unit, np.sqrt(np.mean(e**2, axis=0)) / unit)

    def of(self, effect: Effect) -> Size:
        """Measure an effect by the torque it adds along the motions."""
        return self.size([effect.torque(x) for x in self.motions], effect.beside_friction, effect.window)

    def largest(self, effect: Effect, sizes: np.ndarray) -> float:
        """Return the one of sizes (n,) that is the effect's: at its joint, or the largest if it has none of its own."""
        own = effect.joint >= 0 and not effect.whole_robot
        return float(sizes[effect.joint] if own else sizes[self.joints].max())

    def scaled(self, effect: Effect, target: float, *, raw: bool = False, largest_raw: float = 0.7) -> Effect:
        """Return the effect as strong as it takes to have a size.

        Args:
            target: size at the joint where it is largest.
            raw: take the size before projection.
            largest_raw: part of the joint's torque that is still plausible, before projection.

        Raises:
            Refused: that takes an implausible strength.
        """
        first, limit = self.motions[0], effect.limit(self.motions[0])
        effect = effect.of_strength(min(effect.strength, 0.5 * limit))
        for _ in range(10):
            size = self.of(effect)
            reached = self.largest(effect, size.raw if raw else size.left)
            if abs(reached / target - 1.0) < _CLOSE and self.largest(effect, size.raw) < largest_raw:
                return effect
            if reached <= 1e-9 * target:
                raise Refused(f"{effect.id} leaves nothing beside the rigid body")
            factor = np.clip(target / reached, 0.1, None)
            if effect.strength >= limit and factor > 1.0:
                raise Refused(f"{effect.id} reaches {reached:.3f} of {target:.3f} at {first.robot.name}")
            effect = effect.of_strength(float(min(effect.strength * factor, limit)))
        raise Refused(f"{effect.id} cannot be brought to {target:.3f} plausibly")


def _smooth(x: np.ndarray) -> np.ndarray:
    """Return (N, n) below 10 Hz, each fourth sample."""
    sos = butter(4, _BAND_HZ, fs=RATE_HZ, output="sos")
    return sosfiltfilt(sos, x, axis=0)[::_EVERY]


def _basis(A: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the columns' span."""
    scale = np.sqrt(np.mean(A**2, axis=0))
    A = A[:, scale > 1e-12] / scale[scale > 1e-12]
    values, vectors = np.linalg.eigh(A.T @ A)
    kept = values > 1e-11 * values[-1]
    return A @ (vectors[:, kept] / np.sqrt(values[kept]))
