"""Baseline friction: d qd + c_+ max(g, 0) + c_- min(g, 0), viscous and two-sided Coulomb friction, g = tanh(qd / w)."""

from __future__ import annotations

import numpy as np

from torchrbd.dataset.rows import Rows
from torchrbd.nuisance.component import Along, Learnt, OfEachJoint
from torchrbd.nuisance.directions import Directions

FRICTION_EFFECTS = ("viscous_friction", "asymmetric_coulomb_friction")
"""The effects that these coefficients are."""
_COEFFICIENTS = 3


class JointFriction(OfEachJoint):
    """Friction of each joint; none of its coefficients can be negative.

    Args:
        rows: the data.
        directions: of the motion.
        torque_rms: (n,) [N m or N].
    """

    def __init__(self, rows: Rows, directions: Directions, torque_rms: np.ndarray) -> None:
        super().__init__(rows.n_dof, _COEFFICIENTS)
        self._rows, self._directions, self._torque_rms = rows, directions, torque_rms

    @property
    def index(self) -> np.ndarray:
        """Indices of all its coefficients, (3 n_dof,)."""
        return self.first + np.arange(self.n)

    def features(self, joint: int, width: float) -> np.ndarray:
        """Return qd, max(g, 0) and min(g, 0), (3, M)."""
        d = self._directions
        return np.concatenate((self._rows.qd[[joint]] * d.moving[joint], d.sign(joint, width)))

    def std(self, joint: int, features: np.ndarray) -> np.ndarray:
        """Return the prior standard deviations of the coefficients of features, (K,): all of the joint's torque."""
        size = np.sqrt(np.mean(features**2, axis=1))
        return np.where(size > 0, self._torque_rms[joint] / np.maximum(size, 1e-300), 0.0)

    def size(self, joint: int, learnt: Learnt) -> np.ndarray:
        """Return the friction (3,) of a joint for coefficients of one."""
        return self.std(joint, self.features(joint, float(learnt.rest_width[joint])))

    def of(self, z: np.ndarray, learnt: Learnt) -> np.ndarray:
        """Return viscous and both Coulomb coefficients of each joint, (n, 3), of a model's coefficients z."""
        return np.stack([z[self.at(j)] * self.size(j, learnt) for j in range(self._rows.n_dof)])

    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        features = self.features(joint, float(learnt.rest_width[joint]))
        return features * self.std(joint, features)[:, None], self.at(joint)
