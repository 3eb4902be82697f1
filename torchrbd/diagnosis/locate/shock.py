"""Shocks that were left out of the fit, since they spoil it: at which joint, how often, how far the torque errs there.

What no fit has seen may be explained all the same: by play in a gear, which makes such shocks, or by a model that errs
there no more than elsewhere.
"""

from __future__ import annotations

import math

import numpy as np

from torchrbd.diagnosis.locate.scene import Scene
from torchrbd.diagnosis.results import Location, Where
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.rows.shocks import MISFIT, misfit
from torchrbd.diagnosis.words import number, percent, torque_unit


def shock_notes(fit: Fit) -> tuple[str, ...]:
    """Say that shocks were left out, if they were."""
    samples, joint = fit.rows.samples, _jumping(fit)
    if joint is None:
        return ()
    share = percent(float((~samples.weight.any(0)).mean()))
    name = samples.columns.robot.joint_names[joint]
    return (
        f"The motion has shocks, most of all that of {name}, which mislead the inertial parameters; {share} of the "
        "time counts nothing in fits therefore. Errors on held-out time are those of all of it.",
    )


def shocks(fit: Fit, model: str) -> tuple[Location, ...]:
    """Return the joint that jumps most where shocks were left out; ``model`` is the name of what leaves them."""
    scene, samples, joint = Scene.of(fit), fit.rows.samples, _jumping(fit)
    if joint is None or any(term.effect.id == "backlash" for term in fit.terms):
        return ()
    inside, elsewhere = (float(rms[joint]) for rms in misfit(fit))
    if inside < MISFIT * elsewhere:
        return ()
    measured = samples.measured[joint]
    shocked = int((measured & (samples.weight[joint] == 0.0)).sum())
    part, name, unit = shocked / measured.sum(), scene.robot.joint_names[joint], torque_unit(scene.robot, joint)
    statement = (
        f"{name}: it jumps, and at its shocks, {percent(part)} of the time, the torque errs by {number(inside)} {unit} "
        f"RMS, elsewhere by {number(elsewhere)} {unit}. Play in a gear does that, or a robot that hits something."
    )
    return (
        Location(
            model=model,
            joints=(name,),
            links=(),
            where=Where(),
            depends_on=(f"qdd_{name}",),
            form="shock",
            course="bursts",
            gain=shocked * math.log(inside / elsewhere),
            torque_rms={name: inside},
            share={name: part * inside**2 / (part * inside**2 + (1.0 - part) * elsewhere**2)},
            curve=None,
            attack=None,
            statement=statement,
        ),
    )


def _jumping(fit: Fit) -> int | None:
    """Return the joint with the largest shocks, in parts of those that are left out; None where none are."""
    samples = fit.rows.samples
    levels = samples.columns.shock_levels.numpy()
    if np.isinf(levels).all():
        return None
    jumps = (samples.shocks / np.maximum(levels, 1e-300)[:, None]).max(1)
    return max(Scene.of(fit).seen, key=lambda j: float(jumps[j]))
