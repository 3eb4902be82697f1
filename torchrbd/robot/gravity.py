"""Gravity in the axes of a robot's base."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchrbd.errors import OptionError

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
"""For a robot whose base is upright [m/s^2]."""
# Larger than on any planet or in any centrifuge for robots [m/s^2].
_LARGEST = 1e3


def checked_gravity(gravity: Sequence[float] | Tensor) -> Tensor:
    """Return gravity (3,) [m/s^2] as a tensor.

    Raises:
        OptionError: it is not a vector of three finite numbers, or implausibly large.
    """
    vector = torch.as_tensor(gravity, dtype=torch.float64)
    if vector.shape != (3,) or not bool((vector.abs() <= _LARGEST).all()):
        raise OptionError(
            f"gravity is {vector.tolist()}; expected three numbers of at most {_LARGEST:g} m/s^2, e.g. 0, 0 and -9.81"
        )
    return vector
