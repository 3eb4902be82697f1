"""What a fit is worth, in words: the verdict, what is to be doubted, and what position noise does to it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from torchrbd.inference.physical.fitting import FittedModel, judge, relative_to_constant
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.results import Verdict
from torchrbd.inference.settings import Settings
from torchrbd.inference.torque_error import Fit
from torchrbd.parameters import PARAMETERS_PER_BODY

_POOR, _WORSE, _IMPLAUSIBLE, _BEYOND_LIMIT = 0.8, 1.2, 5.0, 3.0
# An encoder's noise that is stated is doubted if it is off by more than this factor.
_MISSTATED = 2.0
# Position noise that adds less than this part of the parameters' squared error is not worth a word.
_SMALL = 0.1


def verdict_of(fits: Mapping[str, Fit], doubts: tuple[str, ...], *, suspect: bool = False) -> Verdict:
    """Return the worst that is known of an identification.

    "suspect" if the input is; otherwise "worse" if the last model's mean nmse is above 1.2 times the URDF's; otherwise
    "doubtful" if there is any doubt.

    Args:
        fits: held-out errors by model, the URDF's first.
        doubts: of input and result.
        suspect: whether nothing can be said of the robot before the input has been looked at.
    """
    if suspect:
        return "suspect"
    if list(fits.values())[-1].mean_nmse > _WORSE * fits["urdf"].mean_nmse:
        return "worse"
    return "doubtful" if doubts else "identified"


def tells_nothing(prepared: Prepared, model: FittedModel) -> bool:
    """Say whether a model predicts held-out torque no better than a constant, in the mean over the joints."""
    error = relative_to_constant(prepared.judging_fitted, prepared.judging, model.x)
    return bool(error.isfinite().any()) and float(torch.nanmean(error)) > 1.0


def doubts_of(prepared: Prepared, model: FittedModel, fits: Mapping[str, Fit]) -> tuple[str, ...]:
    """Return what looks like wrong input, and where the fitted model does worse than what it was to better.

    Args:
        prepared: the data.
        model: the last one.
        fits: held-out errors, those of ``model`` last.
    """
    seen = prepared.judging_fitted
    fitted, absurd = judge(seen, model.x).nmse, judge(seen, prepared.prior.reference).absurd
    held_out, urdf = list(fits.values())[-1].nmse, fits["urdf"].nmse
    poor = [
        f"{joint} (nmse {nmse:.2f} where it was fitted"
        + (f", {held_out[joint]:.2f} held out)" if joint in held_out else ")")
        for joint, nmse in fitted.items()
        if max(nmse, held_out.get(joint, 0.0)) > _POOR
    ]
    worse = [
        f"{joint} (nmse {nmse:.3g} against {urdf[joint]:.3g})"
        for joint, nmse in held_out.items()
        if nmse > _WORSE * urdf[joint]
    ]
    doubts = _too_fast(prepared)
    if poor:
        doubts.append(
            f"the fitted model explains little of the torque of {', '.join(poor)}: check unit, sign, gear ratio and "
            "name of the columns; if they are right, physics is missing, such as friction"
        )
    if absurd:
        doubts.append(
            f"the URDF's torque is more than ten times off for {', '.join(absurd)}: check the units (rad, s, N m) of "
            "the recording and of the URDF before trusting any finding"
        )
    if worse:
        doubts.append(f"on held-out data the URDF as given predicts better for {', '.join(worse)}")
    masses = []
    for body in prepared.prior.bodies:
        given, found = (float(x[PARAMETERS_PER_BODY * body]) for x in (prepared.prior.reference, model.x))
        if not 1 / _IMPLAUSIBLE < found / given < _IMPLAUSIBLE:
            masses.append(f"{prepared.robot.body_names[body]} {found / given:.3g} times")
    if masses:
        doubts.append(
            f"masses come out far from the URDF's, {', '.join(masses)}: a load, missing physics, or a motion that "
            "hardly identifies them"
            + ("; or is this the URDF of another variant of the robot?" if len(masses) > 1 else "")
        )
    if not model.converged:
        doubts.append("the fit stopped early: the torques are far from those of any rigid body; check units and signs")
    return tuple(doubts)


def _too_fast(prepared: Prepared) -> list[str]:
    """Return where joints move at more than three times the URDF's velocity limit."""
    robot, doubts = prepared.robot, []
    for s in prepared.reading.surveys:
        rows = zip(robot.joint_names, s.velocity_max, robot.velocity.tolist(), strict=True)
        fast = [f"{name} {v:.3g} (limit {limit:.3g})" for name, v, limit in rows if v > _BEYOND_LIMIT * limit > 0]
        if fast:
            doubts.append(
                f"the motion of {s.name} is faster than the URDF allows, per second {', '.join(fast)}: check the units "
                "of q and t"
            )
    return doubts


def encoder_doubts(prepared: Prepared, settings: Settings) -> tuple[str, ...]:
    """Return where the position noise that the user states is far from what the recordings show."""
    given, shown = settings.known_encoder_noise(prepared.robot).tolist(), prepared.found_encoder_noise.tolist()
    smoothed = prepared.states is not None
    far = []
    rows = zip(prepared.robot.joint_names, prepared.robot.prismatic.tolist(), given, shown, strict=True)
    for k, (joint, prismatic, stated, seen) in enumerate(rows):
        if stated > _MISSTATED * seen or stated * _MISSTATED < seen:
            unit = "m" if prismatic else "rad"
            found = f", smoothed {float(prepared.input_noise.encoder_std[k]):.2g} {unit}" if smoothed else ""
            far.append(f"{joint} {stated:.2g} {unit} (recordings {seen:.2g} {unit}, {_times(stated, seen)}{found})")
    done = "smoothing finds its own" if smoothed else "it is used as stated"
    return (f"the position noise is not as stated: {'; '.join(far)}; {done}",) if far else ()


def _times(stated: float, seen: float) -> str:
    ratio = stated / seen if seen > 0 else np.inf
    size = max(ratio, 1.0 / ratio)
    return f"{f'{size:.3g}' if size < 100 else 'more than 100'} times {'less' if ratio > 1 else 'more'}"


def regime_of(prepared: Prepared, estimator: str) -> str:
    """Say in a sentence what position noise does here, and what was done about it.

    Args:
        prepared: the data.
        estimator: what the user asked for.
    """
    noise, smoothed = prepared.input_noise, prepared.states is not None
    if estimator == "moments":
        return (
            "states are filtered, and only second moments were looked at: what position noise does to the fit, and "
            "whether clocks agree, 'auto' would ask of the recordings"
        )
    if noise.matters:
        size = "more than 10" if noise.excess > 10 else f"about {noise.excess:.2g}"
        effect = (
            f"position noise matters: fitted to filtered states, parameters would have {size} times the squared error"
        )
    else:
        share = noise.excess - 1.0
        words = f"{100 * share:.0f}" if share >= 0.01 else "less than 1"
        matters = "hardly matters" if share < _SMALL else "is small enough to be filtered"
        effect = f"position noise {matters}: it adds {words} % to the parameters' squared error"
    done = "states are filtered"
    if smoothed:
        done = (
            "states and parameters are smoothed together, held-out states without their torque; remaining "
            "position noise there adds to every model's error"
        )
    if noise.matters and estimator not in ("auto", "smoother"):
        done += f", as '{estimator}' has it; 'auto' would smooth states and parameters together if the clock allows it"
    if smoothed and not noise.matters:
        done += "; that is as 'smoother' has it, 'auto' would filter the states"
    return f"{effect}; {done}"
