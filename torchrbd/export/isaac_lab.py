"""A model's drives as a configuration of Isaac Lab's actuators: a Python file to import.

    torque = kp (q_ref(t - delay) - q) - kd qd, clipped;  of the joint: armature, Coulomb and viscous friction

Friction is a torque in Isaac Sim 5.0 and later; before, it was a part of the load. Inertial parameters are those of the
URDF that the simulation imports.

Source: isaaclab.actuators, ActuatorBaseCfg and DelayedPDActuatorCfg.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence

from torchrbd.display import Remark
from torchrbd.effects import Term
from torchrbd.errors import OptionError
from torchrbd.export.conditions import conditions_not_exported
from torchrbd.export.gathered import left_out, refuse_negative
from torchrbd.model import RigidBodyDynamics

# Attributes of MJCF's <joint> that Isaac Lab has, and what it calls them.
_NAMES = {"armature": ("armature",), "frictionloss": ("friction", "dynamic_friction"), "damping": ("viscous_friction",)}
_FILE = '''\
"""{about}
{lacking}"""

from isaaclab.actuators import DelayedPDActuatorCfg

{step}
PHYSICS_DT = 0.005
DELAY = {delay!r}  # s

ACTUATORS = {{
    "drives": DelayedPDActuatorCfg(
{arguments}
    )
}}
'''


def to_isaac_lab(model: RigidBodyDynamics) -> bytes:
    """Write the drives of a model as a Python file for Isaac Lab.

    Raises:
        OptionError: the model knows no drives.
        PhysicalError: a joint's friction or rotor inertia is negative.
    """
    drives = model.drives
    if drives is None or not drives.of:
        raise OptionError(
            "the model knows no position drives: identify recordings of set-points with a mapping that has the gains "
            "('drive: {kp, kd}'), or write MJCF, whose actuators take torques"
        )
    names = [name for name in model.robot.joint_names if name in drives.of]
    delay = max(drives.delay_s, 0.0)
    arguments = {
        "joint_names_expr": list(map(re.escape, names)),
        **_of_drives(model, names),
        **_of_joints(model, names),
    }
    lines = [f"        {key}={_literal(value)}," for key, value in arguments.items()]
    lines += [f"        {key}=round(DELAY / PHYSICS_DT)," for key in ("min_delay", "max_delay")]
    lacking = [f"- {one}" for one in not_in_isaac_lab(model)]
    text = _FILE.format(
        about=Remark("file for Isaac Lab", {"robot": model.robot.name}),
        lacking="\n".join(["", str(Remark("what the file lacks")), *lacking, ""] if lacking else []),
        step=f"# {Remark('step of the physics')}",
        delay=delay,
        arguments="\n".join(lines),
    )
    return text.encode()


def _literal(value: Sequence[str] | Mapping[str, float]) -> str:
    """Return names, or numbers in six digits by name, as Python writes them, one in a line."""
    if isinstance(value, Mapping):
        rows = [f"{json.dumps(key)}: {float(f'{number:.6g}')!r}" for key, number in value.items()]
    else:
        rows = list(map(json.dumps, value))
    body = "".join(f"            {row},\n" for row in rows)
    return f"{{\n{body}        }}" if isinstance(value, Mapping) else f"[\n{body}        ]"


def not_in_isaac_lab(model: RigidBodyDynamics) -> tuple[Remark, ...]:
    """Return what ``to_isaac_lab`` does not write: terms other than friction and rotors, and joints without drive."""
    others = [left_out(term, model.robot, "Isaac Lab") for term in model.terms if not _joint_numbers(term)]
    drives = model.drives
    without = [name for name in model.robot.joint_names if drives is not None and name not in drives.of]
    free = [Remark("joints without drive", {"joints": without})] if without else []
    return (*others, *free, *conditions_not_exported(model))


def _joint_numbers(term: Term) -> dict[str, float]:
    """Return what a term is in MJCF's <joint>, if Isaac Lab has all of it; else nothing."""
    written = term.effect.mjcf(term.parameters_by_name())
    given = written.get("joint", {})
    numbers = {name: value for name, value in given.items() if isinstance(value, (int, float))}
    whole = set(written) == {"joint"} and numbers.keys() == given.keys() and numbers.keys() <= _NAMES.keys()
    fits = whole and term.site.always and term.site.joint is not None and not term.effect.exported_in_part
    return {name: float(value) for name, value in numbers.items()} if fits else {}


def _of_drives(model: RigidBodyDynamics, names: Sequence[str]) -> dict[str, Mapping[str, float]]:
    """Return gains and limits of drives, by joint."""
    assert model.drives is not None
    robot, of = model.robot, model.drives.of
    found: dict[str, dict[str, float]] = {"stiffness": {}, "damping": {}, "effort_limit": {}, "velocity_limit": {}}
    for name in names:
        k, key = robot.joint_names.index(name), re.escape(name)
        effort = min(of[name].limit, float(robot.effort[k]) if float(robot.effort[k]) > 0 else math.inf)
        found["stiffness"][key], found["damping"][key] = of[name].kp, of[name].kd
        found["effort_limit"] |= {key: effort} if math.isfinite(effort) else {}
        speed = float(robot.velocity[k])
        found["velocity_limit"] |= {key: speed} if math.isfinite(speed) and speed > 0 else {}
    return {name: values for name, values in found.items() if values}


def _of_joints(model: RigidBodyDynamics, names: Sequence[str]) -> dict[str, Mapping[str, float]]:
    """Return armature and friction, by joint."""
    found = {name: dict.fromkeys(map(re.escape, names), 0.0) for of in _NAMES.values() for name in of}
    for term in model.terms:
        joint = None if term.site.joint is None else model.robot.joint_names[term.site.joint]
        for name, value in _joint_numbers(term).items() if joint in names else ():
            refuse_negative(str(joint), name, value)
            for own in _NAMES[name]:
                found[own][re.escape(str(joint))] += value
    return {name: values for name, values in found.items() if any(values.values())}
