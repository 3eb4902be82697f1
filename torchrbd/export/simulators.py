"""The files for simulators by the name of their format, and what they cannot hold, in sentences."""

from __future__ import annotations

from torchrbd.errors import OptionError
from torchrbd.export.gathered import named
from torchrbd.export.mjcf import mjcf_unsaid, to_mjcf
from torchrbd.export.urdf import to_urdf
from torchrbd.model import RigidBodyDynamics
from torchrbd.robot import STANDARD_GRAVITY

FORMATS = {"urdf": to_urdf, "mjcf": to_mjcf}
"""What writes them."""


def written(model: RigidBodyDynamics, to: str) -> bytes:
    """Return the file of a format.

    Raises:
        OptionError: there is no such format.
    """
    if to not in FORMATS:
        raise OptionError(f"there is no format '{to}'; expected {' or '.join(FORMATS)}")
    return FORMATS[to](model)


def unsaid(model: RigidBodyDynamics, to: str = "mjcf") -> tuple[str, ...]:
    """Return what a file for a simulator cannot hold of a model, in sentences.

    Args:
        model: that is written.
        to: "mjcf" or "urdf", as ``to_mjcf`` and ``to_urdf`` write them.

    Raises:
        OptionError: there is no such format.
        PhysicalError: MJCF of a link whose inertial parameters are those of no rigid body.
    """
    if to not in FORMATS:
        raise OptionError(f"there is no format '{to}'; expected {' or '.join(FORMATS)}")
    if to == "mjcf":
        return mjcf_unsaid(model)
    sentences = []
    for term in model.terms:
        if not term.site.always:
            sentences.append(f"{named(term, model.robot)}: does not act always, and the file is of one condition")
        elif not term.effect.urdf_dynamics(term.parameters_by_name()):
            sentences.append(f"{named(term, model.robot)}: URDF has no word for it")
    if bool((model.robot.gravity != model.robot.gravity.new_tensor(STANDARD_GRAVITY)).any()):
        x, y, z = (f"{v:.4g}" for v in model.robot.gravity.tolist())
        sentences.append(f"gravity, which is {x} {y} {z} m/s^2 in the base's axes: tell the simulator")
    return tuple(sentences)
