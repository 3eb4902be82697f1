"""Rounding: b sin(2 pi tau_s / D) + b' cos(2 pi tau_s / D), if the torque is recorded in steps D.

The error of rounding is a function of the torque, a sawtooth that noise smooths to its first harmonic (Widrow and
Kollar, "Quantization Noise", 2008).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.rows import Rows
from torchrbd.effects import Signals
from torchrbd.nuisance.component import Along, Learnt, OfEachJoint, nothing

_COEFFICIENTS = 2


class TorqueQuantisation(OfEachJoint):
    """First harmonic of the error of rounding.

    Args:
        rows: the data.
    """

    def __init__(self, rows: Rows) -> None:
        super().__init__(rows.n_dof, _COEFFICIENTS)
        self._rows = rows

    def along(self) -> Mapping[str, Callable[[Signals], Tensor]]:
        return {"rounding": self._harmonic}

    def _harmonic(self, signals: Signals) -> Tensor:
        """Return both parts (2, n, N) [N m or N]; zero where torques have no steps."""
        step = torch.from_numpy(np.nan_to_num(self._rows.torque_step, nan=np.inf)).unsqueeze(1)
        turns = 2.0 * math.pi * signals.supplied / step
        amplitude = torch.where(step.isinf(), 0.0, step / math.pi)
        return torch.stack((amplitude * turns.sin(), amplitude * turns.cos()))

    def columns(self, joint: int, learnt: Learnt, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        return nothing(len(self._rows.t)) if along is None else (along["rounding"][:, joint], self.at(joint))
