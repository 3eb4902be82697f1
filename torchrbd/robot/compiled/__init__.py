"""Compiled kernels of rigid-body dynamics, with the same results as `eager`; built by the machine's C compiler."""

from torchrbd.robot.compiled.kernel import INVERSE_DYNAMICS, MASS_MATRIX, REGRESSOR, log_cholesky_kernel
from torchrbd.robot.compiled.switch import call, call_physical_torque, call_torque_slopes, is_available, only_eager
from torchrbd.robot.compiled.tables import NO_ROBOT, Tables, build_tables

__all__ = [
    "INVERSE_DYNAMICS",
    "MASS_MATRIX",
    "NO_ROBOT",
    "REGRESSOR",
    "Tables",
    "build_tables",
    "call",
    "call_physical_torque",
    "call_torque_slopes",
    "is_available",
    "log_cholesky_kernel",
    "only_eager",
]
