"""The relative noise of a joint's rows: s^2 = 1 - k + k m^2 / mean m^2 + l^2 u^2.

Encoder noise is differentiated twice and multiplied by the row of the mass matrix, m^2 = sum_k M_jk^2 s_k^2. Friction
is uncertain where the velocity does not show its direction; u is the standard deviation of that direction.
"""

from __future__ import annotations

import numpy as np
import torch

from torchrbd.dataset.rows import Rows
from torchrbd.nuisance.directions import Directions


class RowNoise:
    """Which rows are noisier than others.

    Args:
        rows: the data.
        directions: of the motion.
    """

    def __init__(self, rows: Rows, directions: Directions) -> None:
        mass = rows.columns.robot.mass_matrix(torch.from_numpy(rows.q.T)).numpy()
        self._carried = np.einsum("mjk,k->jm", mass**2, rows.encoder_std**2)
        self._directions = directions

    def spread(self, joint: int, encoder_share: float, loose: float = 0.0, stick: float = 1.0) -> np.ndarray:
        """Return the relative noise s of a joint's rows, (M,).

        Args:
            joint: its index.
            encoder_share: k, mean share of the noise that comes from encoders.
            loose: l, Coulomb friction in units of the noise.
            stick: multiple of the velocity's error below which a joint may be at rest, see ``STICKS``.
        """
        m = self._carried[joint]
        # Encoders add no noise at a joint whose links have no mass: its rows are equally noisy.
        encoders = 1.0 - encoder_share + encoder_share * (m / m.mean() if m.any() else np.ones_like(m))
        return np.sqrt(encoders + (loose * self._directions.unsure[stick][joint]) ** 2)
