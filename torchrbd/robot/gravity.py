"""Gravity in the axes of a robot's base."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchrbd.errors import OptionError

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
"""Of a robot whose base stands upright [m/s^2]."""
# On no planet is it larger, and in no centrifuge for robots.
_LARGEST = 1e3


def checked_gravity(gravity: Sequence[float] | Tensor) -> Tensor:
    """Return gravity (3,) [m/s^2] as a tensor.

    Raises:
        OptionError: it is no vector, or larger than any.
    """
    vector = torch.as_tensor(gravity, dtype=torch.float64)
    if vector.shape != (3,) or not bool((vector.abs() <= _LARGEST).all()):
        raise OptionError(
            f"gravity is {vector.tolist()}; expected three numbers of at most {_LARGEST:g} m/s^2, e.g. 0, 0 and -9.81"
        )
    return vector
