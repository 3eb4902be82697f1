"""What a user should know of a robot, of a set of recordings, and of how they were fitted and simulated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from torchrbd.report.text.names import words_of
from torchrbd.report.text.numbers import number


def _no_temperature(joints: Sequence[str]) -> str:
    return f"no temperature of {', '.join(joints)}, so that of others is not used there"


def _unphysical(body: str) -> str:
    return (
        f"the URDF's inertia of {body} is that of no extended body of its mass; the fit starts from the nearest that is"
    )


def _gravity(gravity: Sequence[float]) -> str:
    return f"gravity is ({', '.join(f'{x:.4g}' for x in gravity)}) m/s^2 in the base's axes"


def _known_parts(parts: Sequence[str], source: str) -> str:
    return (
        f"{' and '.join(parts)} of joints are those of {source}. What is fitted or found of them comes on top. "
        "NMSE is of the torque without them"
    )


def _massless(body: str) -> str:
    return f"{body} has no mass in the URDF and keeps none; give it a rough one if it has any"


def _simulation(pairs: Sequence[Sequence[str]]) -> str:
    names = ", ".join(f"{simulated} (for {recording})" for simulated, recording in pairs)
    return (
        f"compared with the simulation {names}: its torque replaces the URDF's, moved to the recorded states by the "
        "URDF's rigid body. Torques are shown without what the simulator has beyond the URDF. Identified inertials "
        "are the URDF's plus the difference between robot and simulator. The model written lacks what the simulator "
        "has beyond the URDF"
    )


def _not_smoothed(recordings: Sequence[str]) -> str:
    return (
        f"states are not smoothed: in {', '.join(recordings)} the clock leaves no room above the cut-off, or measured "
        "velocities are better than what smoothed positions would give"
    )


def _ended(limit_s: float | None) -> str:
    """Say why work ended early."""
    return "because you asked for it" if limit_s is None else f"at the time limit of {limit_s:.6g} s"


def _unfinished(limit_s: float | None) -> str:
    return (
        f"unfinished: the search ended {_ended(limit_s)}. Effects, better shapes and alternatives may be missing, and "
        "probabilities may change. Give it more time with time_limit"
    )


def _no_intervals(estimator: str, was_physical: bool, with_intervals: Sequence[str]) -> str:
    made = "" if was_physical else ", made physical"
    return (
        f"parameters are those of '{estimator}'{made}, without intervals, which come with {', '.join(with_intervals)}"
    )


def _passes(passes: int, settled: bool) -> str:
    if settled:
        return f"{passes} passes over the recordings"
    return f"stopped after {passes} passes while the weights still changed"


def _not_simulated(error: str = "") -> str:
    return f"motion was not simulated: {error or 'the recordings have no uninterrupted window'}"


def _along(terms: Sequence[Sequence[str]]) -> str:
    names = ", ".join(f"{words_of(effect)} at {place}" for effect, place in terms)
    return f"simulated motion takes the torque of these terms from the recorded motion: {names}"


def _torque_filter(half_hz: float, order: int) -> str:
    return (
        f"the torques were low-passed before they were recorded: half of the amplitude is left at {half_hz:.3g} Hz "
        f"(Butterworth, order {order}, forwards and backwards). Predicted torques pass the same filter. Recordings "
        "without it show friction better"
    )


def _late_torque(delay_s: float) -> str:
    way = "late" if delay_s > 0 else "early"
    return f"the model has the recorded torque {abs(delay_s):.3g} s {way}: it is moved by that"


def _gains(gains: Sequence[Mapping[str, Any]], units: Sequence[str]) -> str:
    names = {"kp": "kp", "torque_constant": "torque constant"}
    each = "; ".join(
        f"{names[g['kind']]} of {g['joint']} {number(g['value'])} {unit} ({number(g['low'])} to {number(g['high'])})"
        for g, unit in zip(gains, units, strict=True)
    )
    return (
        f"estimated gains, with 95 % intervals: {each}. The URDF's bodies set this scale. Torque, inertia and friction "
        "of a joint are in proportion to its gain, and their intervals are conditional on it. A known payload, links "
        "under trust, or a larger kappa make it more certain"
    )


FACTS: dict[str, Callable[..., str]] = {
    "estimated gains": _gains,
    "no changing torque": lambda joint: f"no recording has a torque that changes for {joint}",
    "no temperature": _no_temperature,
    "unphysical URDF inertia": _unphysical,
    "gravity": _gravity,
    "known rotors or springs": _known_parts,
    "massless body": _massless,
    "joint at rest": lambda joint: f"{joint} does not move in these recordings: its friction stays that of the URDF",
    "compared with a simulation": _simulation,
    "simulation's clock moved": lambda recording, shift_s: (
        f"clock moved by {shift_s:.3g} s to fit the motion of {recording}"
    ),
    "states not smoothed": _not_smoothed,
    "unfinished": _unfinished,
    "not tried": lambda limit_s: f"not tried: the comparison ended {_ended(limit_s)}",
    "estimator failed": lambda error: error,
    "no intervals": _no_intervals,
    "combinations of the URDF": lambda kept, of: f"{kept} of {of} combinations as in the URDF",
    "passes": _passes,
    "identified by set-points": lambda identified, of: f"the set-points identify {identified} of {of} combinations",
    "motion not simulated": _not_simulated,
    "terms along the recorded motion": _along,
    "later start": lambda begin_s, asked_s: (
        f"begins at {begin_s:.3g} s instead of {asked_s:.3g} s: the filters need what lies before"
    ),
    "torques low-passed": _torque_filter,
    "late torque moved": _late_torque,
    "torque is a command": lambda lag_s: (
        f"the recorded torque is a command: actuators follow it with a lag of {lag_s:.3g} s"
    ),
}
"""By kind of remark, what says it; without a full stop."""
