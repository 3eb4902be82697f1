"""The truth of a raw case: the schema of ``benchmarks.concealed.truth``, and how much the data can say.

Each effect has, beside the keys there: ``share``, its RMS over that of the joint's recorded torque while it acts (the
size that was asked for is of this kind: ``target_size``), and ``main_joint``, whose share that is; ``remains``, the
part of its torque's power left beside all inertial parameters and friction; ``nats``, the log likelihood that this is
worth beside torque noise alone: the encoder's noise takes from it, bounds on the inertials add to it. Entries of
``indistinguishable`` have ``explains``: the part of what remains that the other name explains.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..robots import Robot
from . import bodies, laws
from .classes import Seen
from .draws import WHOLE
from .laws import DRY, Effect, Motion
from .plant import Friction
from .sensing import RATE_HZ


def describe(
    facts: Mapping[str, Any],
    styles: Mapping[str, tuple[str, float]],
    effect: Effect | None,
    shares: np.ndarray | None,
    seen: Seen | None,
    x: Motion,
) -> dict[str, Any]:
    """Return the truth but for the case's own numbers.

    Args:
        facts: robot, inertials, sensors, friction, size.
        styles: kind and length of each motion by file.
        effect: concealed, if any.
        shares: (n,) of its torque.
        seen: what the data can say of it.
        x: motion of the fit recording.
    """
    robot: Robot = facts["robot"]
    effects = []
    if effect is not None and shares is not None and seen is not None:
        effects = [_entry(robot, effect, facts, shares, seen, x)]
    return {
        "expected": "named" if effects else "nothing",
        "robot": {
            "name": robot.name, "joints": list(robot.joints), "links": list(robot.links),
            "cad_error": facts["inertials"],
        },
        "recordings": [
            {"file": file, "role": "fit" if file.startswith("fit") else "holdout", "duration_s": seconds,
             "rate_hz": RATE_HZ, "motion": style}
            for file, (style, seconds) in styles.items()
        ],
        "effects": effects,
        "companions": [],
        "background": _background(robot, facts["friction"], x),
        "noise": facts["sensors"].describe(robot.joints),
        "inertials": robot.inertials(),
    }  # fmt: skip


def main_joint(effect: Effect, shares: np.ndarray) -> int:
    """Return the joint whose share counts."""
    return int(np.argmax(shares)) if effect.joint < 0 or effect.id in WHOLE else effect.joint


def _entry(
    robot: Robot, effect: Effect, facts: Mapping[str, Any], shares: np.ndarray, seen: Seen, x: Motion
) -> dict[str, Any]:
    j, friction = main_joint(effect, shares), facts["friction"]
    links = [robot.links[effect.joint]] if effect.id in ("payload", "external_wrench") else []
    joints = [robot.joints[effect.joint]] if effect.joint >= 0 and not links else []
    if effect.id in ("time_delay", "actuator_lag") and effect.joint < 0:
        joints = list(robot.joints)
    try:
        parameters = bodies.parameters(effect)
    except KeyError:
        coulomb = 0.5 * float(friction.plus[effect.joint] + friction.minus[effect.joint])
        parameters = laws.parameters(effect, coulomb)
    other = robot.joints[int(effect.shape["other"])] if "other" in effect.shape else None
    share = float(shares[j])
    return {
        "effect": effect.id, "joints": joints, "links": links, "other": other,
        "parameters": {k: float(v) for k, v in parameters.items()},
        "where": {
            "recordings": None if effect.window is None else ["fit_1.parquet"],
            "time_s": None if effect.window is None else [list(effect.window)],
            "region": _region(robot, effect, x),
        },
        "share": share, "remains": seen.remains, "nats": seen.nats, "main_joint": robot.joints[j],
        "size": float(seen.left[j]), "raw_size": share, "target_size": facts["size"],
        "size_by_joint": dict(zip(robot.joints, seen.left.tolist(), strict=True)),
        "in_holdout": effect.window is None,
        "depends_on": _signals(robot, effect),
        "indistinguishable": seen.same,
    }  # fmt: skip


def _region(robot: Robot, effect: Effect, x: Motion) -> list[dict[str, Any]] | None:
    s = effect.shape
    if effect.id == "position_dependent_friction":
        low, high = s["centre"] - s["width"], s["centre"] + s["width"]
    elif effect.id == "one_sided_spring":
        low, high = (s["contact"], np.inf) if s["side"] > 0 else (-np.inf, s["contact"])
    else:
        return None
    q = x.q[:, effect.joint]
    low, high = max(low, float(q.min())), min(high, float(q.max()))
    return [{"signal": f"q_{robot.joints[effect.joint]}", "low": low, "high": high}]


def _signals(robot: Robot, effect: Effect) -> list[str]:
    """Return the signals that an effect's torque depends on."""
    if effect.joint < 0 or effect.id in WHOLE:
        return [f"q_{joint}" for joint in robot.joints]
    name = robot.joints[effect.joint]
    if effect.id == "joint_coupling":
        return [f"q_{robot.joints[int(effect.shape['other'])]}"]
    if effect.id in ("torque_offset", "torque_scale"):
        return [f"tau_{name}"] * (effect.id == "torque_scale")
    if effect.id == "rotor_inertia":
        return [f"qdd_{name}"]
    if effect.id in DRY or effect.id == "presliding_hysteresis":
        more = {
            "load_dependent_friction": [f"tau_{name}"], "time_varying_friction": ["t"],
            "position_dependent_friction": [f"q_{name}"], "presliding_hysteresis": [f"q_{name}"],
        }  # fmt: skip
        return [*more.get(effect.id, []), f"qd_{name}"]
    return [f"q_{name}"]


def _background(robot: Robot, friction: Friction, x: Motion) -> list[dict[str, Any]]:
    """Return friction of all joints."""
    entries = []
    for j, name in enumerate(robot.joints):
        viscous, plus, minus = (float(v[j]) for v in (friction.viscous, friction.plus, friction.minus))
        for effect, parameters in (
            ("viscous_friction", {"viscous": viscous}),
            ("asymmetric_coulomb_friction", {"coulomb_plus": plus, "coulomb_minus": minus}),
        ):
            same = [{"effect": k, "joints": [name], "links": []} for k in ("coulomb_friction", "torque_offset")]
            raw = float(
                np.sqrt(np.mean((viscous * x.v[:, j]) ** 2)) if "viscous" in parameters else 0.5 * (plus + minus)
            )
            entries.append({
                "effect": effect, "joints": [name], "links": [], "other": None, "parameters": parameters,
                "where": {"recordings": None, "time_s": None, "region": None},
                "size": raw / float(np.sqrt(np.mean(x.supplied[:, j] ** 2))), "raw_size": None, "target_size": None,
                "size_by_joint": {}, "in_holdout": True, "depends_on": [f"qd_{name}"],
                "indistinguishable": same if effect.startswith("asym") else [],
                "width": float(friction.width[j]),
            })  # fmt: skip
    return entries
