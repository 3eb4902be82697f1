"""Typed exceptions: what was expected, what came, where, and what to do about it."""


class TorchRBDError(Exception):
    """Base of everything torchrbd raises on purpose."""


class InputError(TorchRBDError, ValueError):
    """Input that cannot be used. The message names the place and the remedy; the command line exits with code 2."""


class RobotError(InputError):
    """A robot description that cannot be used: names the file, the link or joint, and the remedy."""


class RecordingError(InputError):
    """A recording or mapping that cannot be used: names the file, the column or row, and the remedy."""


class OptionError(InputError):
    """An option that does not fit the robot or the recordings."""


class PhysicalError(TorchRBDError, ValueError):
    """Inertial parameters that no rigid body can have, where a computation needs a physical one."""
