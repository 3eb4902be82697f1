"""What a file for a simulator lacks, or has otherwise than the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

# Terms are named with their numbers only up to so many.
_MOST_NUMBERS = 6
_REASONS = {
    "not always": "does not act always, and the file is of one condition",
    "not finite": "has numbers that are not finite",
    "MJCF": "MJCF has no word for it",
    "URDF": "URDF has no word for it",
    "Isaac Lab": "its actuators have no word for it",
}


def _term(name: str, place: str, values: Mapping[str, tuple[float, str]]) -> str:
    """Return what a term is called in a sentence: effect, place and values."""
    listed = ", ".join(f"{key} {value:.4g} {unit}".removesuffix(" 1") for key, (value, unit) in values.items())
    return f"{name} at {place}" + (f" ({listed})" if len(values) <= _MOST_NUMBERS else "")


def _not_exported(term: Mapping[str, Any], reason: str = "", note: str = "", by_hand: Sequence[str] = ()) -> str:
    """Say why a term is not in a file, or not all of it; ``note`` is the effect's own reason."""
    return f"{_term(**term)}: {'. '.join((note or _REASONS[reason], *by_hand))}"


def _coupling_by_speeds(joints: Sequence[str], damping: float) -> str:
    return (
        f"coupling of {' and '.join(joints)} by their speeds ({damping:.4g}): one of them has less damping, and a "
        "negative damping would add energy"
    )


def _coupling(joints: Sequence[str], kind: str, size: float, at_each: Sequence[float]) -> str:
    first, other = joints
    return (
        f"coupling of {first} and {other}: a tendon acts on both alike, with {kind} {size:.4g}; the model has "
        f"{at_each[0]:.4g} at {first} and {at_each[1]:.4g} at {other}"
    )


def _dry_friction(joints: Sequence[str]) -> str:
    return (
        f"dry friction near rest, of {', '.join(joints)}: MuJoCo's is a constraint that holds the joint still. "
        "It yields the more the lighter what the joint moves"
    )


def _delays(joints: Sequence[str], step_s: float) -> str:
    return f"delays of {', '.join(joints)} need a MuJoCo that knows them, and steps of {step_s:g} s or more"


def _massless(link: str, least: float) -> str:
    return f"{link} moves and has no mass, which MuJoCo refuses: it has {least:g} kg and {least:g} kg m^2 in the file"


def _gravity(gravity: Sequence[float]) -> str:
    x, y, z = (f"{v:.4g}" for v in gravity)
    return f"gravity, which is {x} {y} {z} m/s^2 in the base's axes: set it in the simulator"


def _of_recordings(
    recordings: Sequence[str], delay_s: float = 0.0, lag_s: float = 0.0, load: float = 0.0, simulation: str = "",
    by_hand: str = "",
) -> str:  # fmt: skip
    if delay_s:
        words = f"the torque is {abs(delay_s):.4g} s {'late' if delay_s > 0 else 'early'}"
    elif lag_s:
        words = f"the torque is a command that actuators follow with a lag of {lag_s:.4g} s ({by_hand})"
    elif simulation:
        words = f"the torque includes what the simulation {simulation} has beyond the URDF"
    else:
        words = f"the robot carries a known load of {load:.4g} kg"
    return f"recordings {', '.join(recordings)}: {words}; not in this file"


def _limits(joints: Sequence[str], fault: str) -> str:
    faults = {
        "one side": "limits of {}, which are on one side only",
        "empty": "limits of {}, whose lower end is not below the upper one",
        "effort": "effort limits of {}, which are not above zero",
    }
    return faults[fault].format(", ".join(joints))


EXPORTED: dict[str, Callable[..., str]] = {
    "file for Isaac Lab": lambda robot: (
        f"Actuators of {robot} for Isaac Lab, identified by torchrbd.\n\n"
        "Import the identified URDF without its joints' friction, and set actuators=ACTUATORS in its ArticulationCfg.\n"
        "Friction needs Isaac Sim 5.0 or later"
    ),
    "step of the physics": lambda: "time step of your simulation [s]",
    "joints without drive": lambda joints: f"{', '.join(joints)}: no drive is known",
    "lag of a drive": lambda joints: (
        f"lag of {', '.join(joints)}: that of a torque, and an actuator that follows set-points has none"
    ),
    "what the file lacks": lambda: "what this file lacks, or has otherwise:",
    "not exported": _not_exported,
    "not compared": lambda term: f"{_term(**term)}: is in the file's actuators, whose course in time is not compared",
    "motor of two joints": lambda joints: (
        f"motor of {' and '.join(joints)}: torques of both are divided by the gain of the first"
    ),
    "coupling by speeds": _coupling_by_speeds,
    "coupling": _coupling,
    "dry friction near rest": _dry_friction,
    "delays": _delays,
    "damping of three numbers": lambda joints: (
        f"damping of {', '.join(joints)} has three numbers, which an older MuJoCo does not read"
    ),
    "following joints": lambda joints: f"{', '.join(joints)} follow by constraints, which yield a little in motion",
    "limits": _limits,
    "velocity limits": lambda: "velocity limits: MJCF has none",
    "shapes": lambda: "shapes to be seen and touched: geoms that are added do not change the masses",
    "massless link": _massless,
    "link without width": lambda link, lift: (
        f"{link} is a point or a line without width: {lift:.1g} kg m^2 are added to its moments"
    ),
    "gravity not in URDF": _gravity,
    "condition of recordings": _of_recordings,
}
"""By kind of remark, what says it; without a full stop."""
