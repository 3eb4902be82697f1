"""What is to be doubted of an identification, and what position noise does to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from torchrbd.inference.results import NoiseRegime
from torchrbd.report.text.numbers import as_many_as_fit, joined, number, percent

_WORDS = 20
# Position noise that adds less than this part of the parameters' squared error hardly matters.
_SMALL = 0.1
# Ratios and excesses from which on their size no longer matters.
_MANY_TIMES, _MANY = 100, 10


def _little_explained(fitted: Mapping[str, float], held_out: Mapping[str, float]) -> str:
    def size(joint: str) -> str:
        known = joint in held_out and held_out[joint] is not None and math.isfinite(held_out[joint])
        on_held_out = f", {number(held_out[joint])} on held-out data" if known else ""
        return f"{joint} (NMSE {number(fitted[joint])} on fitted data{on_held_out})"

    return (
        f"the fitted model explains little of the torque of {_list([size(joint) for joint in fitted])}. "
        "Check unit, sign, gear ratio and name of the columns. If they are right, physics is missing, such as friction"
    )


def _urdf_far_off(joints: Sequence[str]) -> str:
    return (
        f"the URDF's torque is more than ten times off at {_list(joints)}. "
        "Check the units (rad, s, N m) of recording and URDF before you trust any finding"
    )


def _urdf_better(fitted: Mapping[str, float], urdf: Mapping[str, float]) -> str:
    sizes = [f"{joint} (NMSE {number(urdf[joint])}, fitted {number(nmse)})" for joint, nmse in fitted.items()]
    return f"on held-out data the URDF as given predicts better at {_list(sizes)}"


def _implausible_masses(ratios: Mapping[str, float]) -> str:
    reasons = "Possible reasons: a load, missing physics, or a motion that hardly identifies them"
    sizes = _list([f"{body} {number(ratio)} times" for body, ratio in ratios.items()])
    variant = ", or the URDF of another variant of the robot" if len(ratios) > 1 else ""
    return f"fitted masses are far from the URDF's: {sizes}. {reasons}{variant}"


def _too_fast(recording: str, velocities: Mapping[str, Sequence[float]], units: Mapping[str, str]) -> str:
    sizes = [
        f"{joint} {number(v)} {units[joint]}/s (limit {number(limit)})" for joint, (v, limit) in velocities.items()
    ]
    return f"the motion of {recording} is faster than the URDF allows: {_list(sizes)}. Check the units of q and t"


def _misstated_noise(
    stated_and_seen: Mapping[str, Sequence[float]], smoothed: Mapping[str, float], units: Mapping[str, str]
) -> str:
    sizes = []
    for joint, (stated, seen) in stated_and_seen.items():
        unit = units[joint]
        found = f", smoothed {number(smoothed[joint])} {unit}" if joint in smoothed else ""
        sizes.append(
            f"{joint} {number(stated)} {unit} (recordings {number(seen)} {unit}, {_times(stated, seen)}{found})"
        )
    done = "Smoothing estimates its own" if smoothed else "It is used as stated"
    return f"the position noise is not as stated: {joined(sizes)}. {done}"


def _times(stated: float, seen: float) -> str:
    ratio = stated / seen if seen > 0 else math.inf
    size = max(ratio, 1.0 / ratio)
    words = number(size) if size < _MANY_TIMES else f"more than {_MANY_TIMES}"
    return f"{words} times {'less' if ratio > 1 else 'more'}"


def _other_motion(simulated: str, recording: str, differences: Mapping[str, float]) -> str:
    sizes = _list([f"{percent(part)} at {joint}" for joint, part in differences.items()])
    return (
        f"{simulated} moves otherwise than {recording}: the velocities differ by {sizes} of the RMS speed. "
        "Beyond rigid body and baseline friction, the simulator's torque belongs to another motion"
    )


def _base_taken_as_fixed(base: str, limbs: int, world: str, root: str) -> str:
    return (
        f"the base '{base}' is taken as fixed to the world, and {limbs} limbs move on it. "
        "Recordings in which it moves, as of a robot that walks, cannot be used. Hold the base while you record. "
        f"If it is fixed, a massless root link '{world}' with a fixed joint to '{root}' in the URDF says so"
    )


DOUBTS: dict[str, Callable[..., str]] = {
    "little explained": _little_explained,
    "URDF far off": _urdf_far_off,
    "URDF better": _urdf_better,
    "implausible masses": _implausible_masses,
    "fit stopped early": lambda: (
        "the fit stopped early: the torques are far from those of any rigid body. Check units and signs"
    ),
    "too fast": _too_fast,
    "misstated position noise": _misstated_noise,
    "other simulated motion": _other_motion,
    "base taken as fixed": _base_taken_as_fixed,
}
"""By kind of remark, what says it; without a full stop."""


def regime_statement(regime: NoiseRegime) -> str:
    """Say what position noise does to a fit, and what was done about it."""
    if regime.estimator == "moments":
        return (
            "States are filtered. Of second moments alone, it is unknown what position noise does to the fit, and "
            "whether the clocks agree. With recordings, 'auto' estimates both."
        )
    return " ".join(filter(None, (_noise(regime), _states(regime))))


def _noise(regime: NoiseRegime) -> str:
    if regime.matters:
        size = f"more than {_MANY}" if regime.excess > _MANY else f"about {regime.excess:.2g}"
        return f"Position noise matters: a fit to filtered states has {size} times the squared error in its parameters."
    share = regime.excess - 1.0
    added = f"{100 * share:.0f} %" if share >= 0.01 else "less than 1 %"
    matters = "hardly matters" if share < _SMALL else "is small"
    return f"Position noise {matters}: it adds {added} to the squared error of the parameters."


def _states(regime: NoiseRegime) -> str:
    asked = f"The estimator '{regime.estimator}' was asked for"
    if regime.states == "smoothed":
        words = (
            "States and parameters are smoothed together. States of held-out data are smoothed without their torque; "
            "their remaining noise adds to every model's error."
        )
        return words if regime.matters else f"{words} {asked}; 'auto' would filter the states."
    if regime.matters and regime.estimator not in ("auto", "smoother"):
        return (
            f"States are filtered. {asked}; 'auto' would smooth states and parameters together if the clock allows it."
        )
    return "States are filtered."


def _list(items: Sequence[str]) -> str:
    return as_many_as_fit(items, _WORDS)
