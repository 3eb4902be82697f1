"""Inertial parameters: physical validity, log-Cholesky coordinates, and which of them a robot's motion identifies."""

from torchrbd.parameters.base import BaseParameters, base_parameters
from torchrbd.parameters.inertial import (
    BASIS,
    ORTHONORMAL,
    PARAMETERS_PER_BODY,
    UNITS,
    is_extended,
    is_physical,
    nearest_physical,
    thickened,
)
from torchrbd.parameters.log_cholesky import from_log_cholesky, to_log_cholesky

__all__ = [
    "BASIS",
    "ORTHONORMAL",
    "PARAMETERS_PER_BODY",
    "UNITS",
    "BaseParameters",
    "base_parameters",
    "from_log_cholesky",
    "is_extended",
    "is_physical",
    "nearest_physical",
    "thickened",
    "to_log_cholesky",
]
