"""The files for simulators by the name of their format, and what they cannot hold, in sentences."""

from __future__ import annotations

from torchrbd.errors import OptionError
from torchrbd.export.isaac_lab import not_in_isaac_lab, to_isaac_lab
from torchrbd.export.mjcf import not_in_mjcf, to_mjcf
from torchrbd.export.urdf import not_in_urdf, to_urdf
from torchrbd.model import RigidBodyDynamics

FORMATS = {"urdf": to_urdf, "mjcf": to_mjcf, "isaaclab": to_isaac_lab}
"""What writes them."""
_LACKING = {"urdf": not_in_urdf, "mjcf": not_in_mjcf, "isaaclab": not_in_isaac_lab}


def written(model: RigidBodyDynamics, to: str) -> bytes:
    """Return the file of a format.

    Raises:
        OptionError: there is no such format.
    """
    if to not in FORMATS:
        raise OptionError(f"there is no format '{to}'; expected {', '.join(FORMATS)}")
    return FORMATS[to](model)


def not_exported(model: RigidBodyDynamics, to: str = "mjcf") -> tuple[str, ...]:
    """Return what a file for a simulator cannot hold of a model, in sentences.

    Args:
        model: that is written.
        to: "mjcf", "urdf" or "isaaclab", as ``to_mjcf``, ``to_urdf`` and ``to_isaac_lab`` write them.

    Raises:
        OptionError: there is no such format.
        PhysicalError: MJCF of a link whose inertial parameters are those of no rigid body.
    """
    if to not in FORMATS:
        raise OptionError(f"there is no format '{to}'; expected {', '.join(FORMATS)}")
    return tuple(map(str, _LACKING[to](model)))
