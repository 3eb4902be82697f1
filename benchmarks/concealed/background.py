"""The friction that every joint of a real arm has, beside what is concealed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .contract import Effect, Now, rms
from .friction import AsymmetricCoulomb
from .motion import Motion, direction
from .viscosity import Viscous


@dataclass(frozen=True)
class Background:
    """Viscous friction, and Coulomb friction that is uneven from joint to joint and by direction.

    Attributes:
        viscous: (n,) [N m s/rad].
        coulomb: (n,) mean of both directions [N m].
        asymmetry: (n,) what it is more forwards, in parts of the mean.
    """

    viscous: np.ndarray
    coulomb: np.ndarray
    asymmetry: np.ndarray

    @staticmethod
    def none(n: int) -> Background:
        """Return no friction."""
        return Background(*np.zeros((3, n)))

    @staticmethod
    def draw(rng: np.random.Generator, x: Motion) -> Background:
        """Draw friction in parts of each joint's torque; a joint that carries next to nothing has some all the same."""
        tau, n = rms(x.load), x.robot.n
        tau = np.maximum(tau, 0.01 * tau.max())
        speed = np.maximum(rms(x.qd), 0.1)
        uneven = rng.uniform(0.03, 0.12, n) * tau
        return Background(rng.uniform(0.02, 0.08, n) * tau / speed, uneven, rng.uniform(-0.15, 0.15, n))

    def torque(self, x: Motion) -> np.ndarray:
        """Return the torque along a motion, (N, n)."""
        return self.viscous * x.qd + self._level(x.qd) * x.direction()

    def compensation(self, qd: np.ndarray) -> np.ndarray:
        """Return what a controller adds for a set-point's speed (N, n), softly at reversals."""
        return self.viscous * qd + self._level(qd) * direction(qd / 10.0)

    def _level(self, qd: np.ndarray) -> np.ndarray:
        return self.coulomb * (1.0 + self.asymmetry * np.sign(qd))

    def act(self, now: Now) -> None:
        """Add to the friction of a step."""
        now.level += self._level(now.qd)
        now.damping += self.viscous

    def parts(self) -> list[Effect]:
        """Return what it is made of, by joint; nothing if there is none."""
        found: list[Effect] = []
        for j in np.flatnonzero(self.coulomb).tolist():
            found.append(Viscous(j, float(self.viscous[j])))
            found.append(AsymmetricCoulomb(j, float(self.coulomb[j]), float(self.asymmetry[j])))
        return found
