"""What a recorder makes of a simulation: 125 Hz, 15 bits a turn, torque with coloured noise, drift, perhaps steps.

Robots without torque sensors record set-points of their drives in place of the torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pyarrow as pa

RATE_HZ, BITS, NOISE = 125.0, 15, 0.03


@dataclass(frozen=True)
class Sensors:
    """Of a case.

    Attributes:
        size: (n,) RMS of the joints' torque [N m], which all else is a part of.
        colour_s: (n,) times in which torque noise forgets itself.
        drift: part of the torque's RMS.
        wanders: whether drift is a random walk rather than a slow wave.
        step: (n,) of the torque [N m]; zeros for none.
    """

    size: np.ndarray
    colour_s: np.ndarray
    drift: float
    wanders: bool
    step: np.ndarray

    @staticmethod
    def draw(rng: np.random.Generator, tau: np.ndarray) -> Sensors:
        """Draw the sensors of a robot that takes torques (N, n); two in five have coarse ones."""
        size, n = np.sqrt(np.mean(tau**2, axis=0)), tau.shape[1]
        coarse = rng.random() < 0.4
        steps = np.abs(tau).max(0) / rng.uniform(60, 200)
        colour = np.exp(rng.uniform(np.log(0.008), np.log(0.03), n))
        return Sensors(size, colour, float(rng.uniform(0.004, 0.01)), bool(rng.random() < 0.5), steps * coarse)

    def describe(self, joints: Sequence[str]) -> dict[str, object]:
        """Return the truth file's entry."""
        known = asdict(self)
        return {
            "torque_rms_share": NOISE, "torque_colour_s": known["colour_s"].tolist(), "drift_rms_share": self.drift,
            "drift": "walk" if self.wanders else "wave", "encoder_bits": BITS,
            "torque_step": dict(zip(joints, self.step.tolist(), strict=True)),
        }  # fmt: skip

    def torque(self, rng: np.random.Generator, t: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Return the recorded torques (N, n) of true ones at times t (N,)."""
        pole, level = np.exp(-1 / (RATE_HZ * self.colour_s)), rng.standard_normal(tau.shape[1])
        noise = np.empty_like(tau)
        for k, fresh in enumerate(rng.standard_normal(tau.shape)):
            noise[k] = level
            level = pole * level + np.sqrt(1 - pole**2) * fresh
        tau = tau + self.size * (NOISE * noise + self.drift * self._drift(rng, t, tau.shape[1]))
        return np.where(self.step > 0, np.round(tau / np.where(self.step > 0, self.step, 1)) * self.step, tau)

    def _drift(self, rng: np.random.Generator, t: np.ndarray, n: int) -> np.ndarray:
        if self.wanders:
            walk = np.cumsum(rng.standard_normal((len(t), n)), axis=0)
        else:
            walk = np.sin(2 * np.pi * rng.uniform(0.01, 0.06, n) * t[:, None] + rng.uniform(-np.pi, np.pi, n))
        walk -= walk.mean(0)
        return walk / np.sqrt(np.mean(walk**2, axis=0))


@dataclass(frozen=True)
class Drives:
    """Drives that made the torques of a robot: tau(t) = kp (q_ref(t - delay) - q(t)) - kd qd(t).

    Attributes:
        kp, kd: (n,) [N m/rad], [N m s/rad].
        delay: of the set-points, in samples.
    """

    kp: np.ndarray
    kd: np.ndarray
    delay: int

    @staticmethod
    def draw(rng: np.random.Generator, tau: np.ndarray) -> Drives:
        """Draw the drives of a robot that takes torques (N, n): they give way by 5 to 30 mrad, and 0 to 4 samples."""
        kp = np.sqrt(np.mean(tau**2, axis=0)) / rng.uniform(0.005, 0.03, tau.shape[1])
        return Drives(kp, kp * rng.uniform(0.02, 0.08, tau.shape[1]), int(rng.integers(5)))

    def set_points(self, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Return the set-points (N, n) that were recorded while the drives made torques tau (N, n)."""
        felt = q + (tau + self.kd * qd) / self.kp
        return np.concatenate((felt[self.delay :], np.repeat(felt[-1:], self.delay, axis=0)))

    def mapping(self, joints: Sequence[str]) -> str:
        """Return the mapping file that states them."""
        each = [
            f"  {name}: {{drive: {{kp: {kp:.6g}, kd: {kd:.6g}}}}}"
            for name, kp, kd in zip(joints, self.kp, self.kd, strict=True)
        ]
        return "\n".join((f"set_point_delay: {self.delay / RATE_HZ:.6g}", "joints:", *each, ""))


def recording(joints: Sequence[str], t: np.ndarray, q: np.ndarray, channel: str, values: np.ndarray) -> pa.Table:
    """Return t, q_<joint> in steps of the encoder, and another channel (N, n): tau_<joint>, q_ref_<joint>."""
    tick = 2 * np.pi / 2**BITS
    columns = {"t": t}
    columns |= {f"q_{name}": np.round(q[:, k] / tick) * tick for k, name in enumerate(joints)}
    columns |= {f"{channel}_{name}": values[:, k] for k, name in enumerate(joints)}
    return pa.table(columns)
