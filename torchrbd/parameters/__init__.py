"""Inertial parameters: pseudo-inertia, log-Cholesky coordinates, and what a robot's motion can tell of them."""

from torchrbd.parameters.base import BaseParameters, base_parameters
from torchrbd.parameters.inertial import PARAMETERS_PER_BODY, UNITS, is_physical, nearest_physical, pseudo_inertia
from torchrbd.parameters.log_cholesky import from_log_cholesky, to_log_cholesky

__all__ = [
    "PARAMETERS_PER_BODY",
    "UNITS",
    "BaseParameters",
    "base_parameters",
    "from_log_cholesky",
    "is_physical",
    "nearest_physical",
    "pseudo_inertia",
    "to_log_cholesky",
]
