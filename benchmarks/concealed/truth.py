"""The truth file of a case, which only the scorer reads.

    {"schema": 1, "id", "set", "tier", "seed", "index",
     "refused": [why earlier draws were thrown away],
     "expected": "named" | "nothing" | "absorbed" | "unexplained",
     "robot": {"name", "joints", "links", "cad_error"},
     "recordings": [{"file", "role": "fit" | "holdout", "duration_s", "rate_hz", "motion"}],
     "effects": [E], "companions": [E], "background": [E],
     "noise": {"torque_rms_share", "torque_colour_s", "drift_rms_share", "encoder_bits", "torque_step": {joint: N m}},
     "inertials": {link: [m, mcx, mcy, mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz]}}

Effects are what is concealed and asked for; companions are true too but come with an effect, as the rotor of a motor
behind a spring; background is the friction of every joint. A finding of either is not false. Each one, E:

    {"effect": id, "joints", "links", "other": joint on whose motion it depends or null, "parameters": {name: SI value},
     "where": {"recordings": [file] | null, "time_s": [[start, end]] | null,
               "region": [{"signal", "low", "high"}] | null},
     "size", "raw_size", "target_size", "size_by_joint": {joint: size},
     "in_holdout": bool, "depends_on": [signal], "indistinguishable": [{"effect", "joints", "links"}]}

``size`` is the RMS of its torque below 10 Hz over the fit recordings, inside its window if it has one, after projection
on rigid-body and friction columns (on rigid-body columns for friction of their own form), over the RMS of the joint's
recorded torque: at its joint or, for effects of links and of the whole robot, at the joint where it is largest.
``raw_size`` is the same without projection. Torques are those that the effect adds to what is recorded. Times count
from a recording's start. Parameters have torchrbd's names; Coulomb levels of effects that contain Coulomb friction
count the background's. ``indistinguishable`` are names that are as right; {"effect": "rigid_body"} says that other
inertials do the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .contract import Effect, Place, named
from .friction import AsymmetricCoulomb
from .motion import Motion
from .recorder import Noise
from .simulate import Run
from .sizes import Size

_NOTHING_LEFT = 0.01


@dataclass(frozen=True)
class Measured:
    """An effect as it was in a simulation.

    Attributes:
        effect: with its strength.
        role: "effects", "companions" or "background".
        target: size that was asked for, if any.
        size: what it came to.
        reached, raw: at the joint that counts.
        motion: along the first fit recording.
    """

    effect: Effect
    role: str
    target: float | None
    size: Size
    reached: float
    raw: float
    motion: Motion

    @property
    def background(self) -> bool:
        """Whether it is not concealed."""
        return self.role != "effects"


def describe(
    facts: Mapping[str, Any], runs: Sequence[Run], kinds: Mapping[str, str], measured: Sequence[Measured]
) -> dict[str, Any]:
    """Return the truth but for the case's own numbers.

    Args:
        facts: expected, robot, cad_error, noise.
        runs: all recordings.
        kinds: of motion by file.
        measured: all effects.
    """
    robot, noise = facts["robot"], facts["noise"]
    names = {"name": robot.name, "joints": list(robot.joints), "links": list(robot.links)}
    dry = [m.effect for m in measured if m.role == "background" and isinstance(m.effect, AsymmetricCoulomb)]
    coulomb = {effect.joint: effect.strength for effect in dry}
    entries: dict[str, list[dict[str, Any]]] = {"effects": [], "companions": [], "background": []}
    for m in measured:
        entries[m.role].append(_entry(m, coulomb.get(m.effect.joint, 0.0)))
    recordings = [
        {
            "file": run.file,
            "role": run.file.partition("_")[0].removesuffix(".parquet"),
            "duration_s": float(len(run.t) * run.t[1]),
            "rate_hz": noise.rate_hz,
            "motion": kinds[run.file],
        }
        for run in runs
    ]
    return {
        "expected": facts["expected"],
        "robot": names | {"cad_error": facts["cad_error"]},
        "recordings": recordings,
        **entries,
        "noise": _noise(noise, robot.joints),
        "inertials": robot.inertials(),
    }


def _noise(noise: Noise, joints: Sequence[str]) -> dict[str, Any]:
    return {
        "torque_rms_share": noise.torque,
        "torque_colour_s": noise.colour_s,
        "drift_rms_share": noise.drift,
        "encoder_bits": noise.encoder_bits,
        "torque_step": dict(zip(joints, noise.torque_step.tolist(), strict=True)),
    }


def _entry(m: Measured, coulomb: float) -> dict[str, Any]:
    """Describe one effect; ``coulomb`` is the friction that its joint has anyway."""
    effect, robot = m.effect, m.motion.robot
    place, window = effect.place(robot), effect.window
    parameters = {
        k: float(v) + (coulomb if k in effect.over_coulomb else 0.0) for k, v in effect.parameters(m.motion).items()
    }
    part = window is not None and np.isfinite(window.start)
    return {
        "effect": effect.id,
        "joints": place["joints"],
        "links": place["links"],
        "other": place["other"],
        "parameters": parameters,
        "where": {
            "recordings": None if window is None else [window.file],
            "time_s": [[window.start, window.end]] if window is not None and part else None,
            "region": _region(place, m.motion),
        },
        "size": m.reached,
        "raw_size": m.raw,
        "target_size": m.target,
        "size_by_joint": dict(zip(robot.joints, m.size.left.tolist(), strict=True)),
        "in_holdout": window is None,
        "depends_on": effect.depends_on(robot),
        "indistinguishable": _equals(m),
    }


def _region(place: Place, x: Motion) -> list[dict[str, Any]] | None:
    """Return the region, open ends closed by what the motion covers."""
    if place["region"] is None:
        return None
    closed = []
    for side in place["region"]:
        q = x.q[:, x.robot.joints.index(side["signal"].removeprefix("q_"))]
        low, high = side["low"], side["high"]
        closed.append(
            {
                "signal": side["signal"],
                "low": float(q.min() if low is None else max(low, q.min())),
                "high": float(q.max() if high is None else min(high, q.max())),
            }
        )
    return closed


def _equals(m: Measured) -> list[Any]:
    """Return equal names; other inertials are one where next to nothing is left beside the rigid body."""
    robot, same = m.motion.robot, list(m.effect.same_as(m.motion.robot))
    if m.role == "effects" and m.target is None:
        same += [{"effect": "rigid_body", "joints": [], "links": []}] if m.reached < _NOTHING_LEFT else []
        if m.effect.id == "joint_spring":
            same.append(named("torque_offset", robot, [m.effect.joint]))
    return same
