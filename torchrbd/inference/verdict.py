"""What a fit is worth: the verdict, what is to be doubted, and what position noise does to it."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from torchrbd.display import Remark
from torchrbd.inference.physical.fitting import FittedModel, judge, relative_to_constant
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.results import NoiseRegime, Verdict
from torchrbd.inference.settings import Settings
from torchrbd.inference.torque_error import Fit
from torchrbd.parameters import PARAMETERS_PER_BODY
from torchrbd.robot import RobotModel

_POOR, _WORSE, _IMPLAUSIBLE, _BEYOND_LIMIT = 0.8, 1.2, 5.0, 3.0
# An encoder's noise that is stated is doubted if it is off by more than this factor.
_MISSTATED = 2.0


def verdict_of(fits: Mapping[str, Fit], doubts: tuple[object, ...], *, suspect: bool = False) -> Verdict:
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


def doubts_of(prepared: Prepared, model: FittedModel, fits: Mapping[str, Fit]) -> tuple[Remark, ...]:
    """Return what looks like wrong input, and where the fitted model does worse than what it was to better.

    Args:
        prepared: the data.
        model: the last one.
        fits: held-out errors, those of ``model`` last.
    """
    seen = prepared.judging_fitted
    fitted, absurd = judge(seen, model.x).nmse, judge(seen, prepared.prior.reference).absurd
    held_out, urdf = list(fits.values())[-1].nmse, fits["urdf"].nmse
    poor = {joint: nmse for joint, nmse in fitted.items() if max(nmse, held_out.get(joint, 0.0)) > _POOR}
    worse = {joint: nmse for joint, nmse in held_out.items() if nmse > _WORSE * urdf[joint]}
    doubts = _too_fast(prepared)
    if poor:
        here = {joint: held_out[joint] for joint in poor if joint in held_out}
        doubts.append(Remark("little explained", {"fitted": poor, "held_out": here}))
    if absurd:
        doubts.append(Remark("URDF far off", {"joints": list(absurd)}))
    if worse:
        doubts.append(Remark("URDF better", {"fitted": worse, "urdf": {joint: urdf[joint] for joint in worse}}))
    if masses := _implausible_masses(prepared, model):
        doubts.append(Remark("implausible masses", {"ratios": masses}))
    if not model.converged:
        doubts.append(Remark("fit stopped early"))
    return tuple(doubts)


def _implausible_masses(prepared: Prepared, model: FittedModel) -> dict[str, float]:
    """Return fitted masses relative to the URDF's, by body, of those that are far from it."""
    index = {prepared.robot.body_names[body]: PARAMETERS_PER_BODY * body for body in prepared.prior.bodies}
    ratios = {name: float(model.x[k] / prepared.prior.reference[k]) for name, k in index.items()}
    return {name: ratio for name, ratio in ratios.items() if not 1 / _IMPLAUSIBLE < ratio < _IMPLAUSIBLE}


def _too_fast(prepared: Prepared) -> list[Remark]:
    """Return where joints move at more than three times the URDF's velocity limit."""
    robot, doubts = prepared.robot, []
    units = _units(robot)
    for s in prepared.reading.surveys:
        rows = zip(robot.joint_names, s.velocity_max, robot.velocity.tolist(), strict=True)
        fast = {name: [float(v), limit] for name, v, limit in rows if v > _BEYOND_LIMIT * limit > 0}
        if fast:
            here = {name: units[name] for name in fast}
            doubts.append(Remark("too fast", {"recording": s.name, "velocities": fast, "units": here}))
    return doubts


def encoder_doubts(prepared: Prepared, settings: Settings) -> tuple[Remark, ...]:
    """Return where the position noise that the user states is far from what the recordings show."""
    given, shown = settings.known_encoder_noise(prepared.robot).tolist(), prepared.found_encoder_noise.tolist()
    far = {
        joint: [stated, seen]
        for joint, stated, seen in zip(prepared.robot.joint_names, given, shown, strict=True)
        if stated > _MISSTATED * seen or stated * _MISSTATED < seen
    }
    if not far:
        return ()
    units = _units(prepared.robot)
    own = dict(zip(prepared.robot.joint_names, prepared.input_noise.encoder_std.tolist(), strict=True))
    smoothed = {joint: own[joint] for joint in far} if prepared.states is not None else {}
    values = {"stated_and_seen": far, "smoothed": smoothed, "units": {joint: units[joint] for joint in far}}
    return (Remark("misstated position noise", values),)


def _units(robot: RobotModel) -> dict[str, str]:
    return {j: "m" if slides else "rad" for j, slides in zip(robot.joint_names, robot.prismatic.tolist(), strict=True)}


def regime_of(prepared: Prepared, estimator: str) -> NoiseRegime:
    """Return what position noise does here, and what was done about it.

    Args:
        prepared: the data.
        estimator: what the user asked for.
    """
    noise = prepared.input_noise
    states = "filtered" if prepared.states is None else "smoothed"
    return NoiseRegime(estimator, states, noise.matters, float(noise.excess))
