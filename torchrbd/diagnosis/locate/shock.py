"""Shocks that were left out of the fit, since they spoil it: at which joint, how often, how far the torque errs there.

What no fit has seen may be explained all the same: by play in a gear, which makes such shocks, or by a model that errs
there no more than elsewhere.
"""

from __future__ import annotations

import numpy as np

from torchrbd.diagnosis.locate.scene import Scene
from torchrbd.diagnosis.results import Location, Where
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.words import number, percent, torque_unit

# What errs at shocks by so many times what it does elsewhere is not explained there.
_MORE = 2.0


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
    here = samples.measured[joint] & (samples.weight[joint] == 0.0)
    left, name = fit.leftover()[joint], scene.robot.joint_names[joint]
    inside, elsewhere = (float(np.mean(left[at] ** 2)) for at in (here, samples.measured[joint] & ~here))
    if inside < _MORE**2 * elsewhere:
        return ()
    share = here.mean() * inside / (here.mean() * inside + (1.0 - here.mean()) * elsewhere)
    unit = torque_unit(scene.robot, joint)
    statement = (
        f"{name}: it jumps, and at its shocks, {percent(float(here.mean()))} of the time, the torque errs by "
        f"{number(np.sqrt(inside))} {unit} RMS, elsewhere by {number(np.sqrt(elsewhere))} {unit}. Play in a gear does "
        "that, or a robot that hits something."
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
            gain=0.5 * float(here.sum()) * float(np.log(max(inside / elsewhere, 1.0))),
            torque_rms={name: float(np.sqrt(inside))},
            share={name: float(share)},
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
