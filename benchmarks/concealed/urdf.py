"""Write arms as URDF, and make their inertials as wrong as CAD has them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin


def urdf_of(model: pin.Model) -> str:
    """Return a model of revolute joints as URDF; joint X moves link X_link, whose frame is the joint's."""
    data, lines = model.createData(), ['<link name="base"/>']
    pin.forwardKinematics(model, data, pin.neutral(model))
    for k in range(1, model.njoints):
        name, parent, v = model.names[k], model.parents[k], model.joints[k].idx_v
        above = f"{model.names[parent]}_link" if parent else "base"
        axis, place = np.asarray(data.joints[k].S)[3:].ravel(), model.jointPlacements[k]
        low, high, speed = model.lowerPositionLimit[v], model.upperPositionLimit[v], model.velocityLimit[v]
        lines += [
            f'<link name="{name}_link">{_inertial(model.inertias[k])}</link>',
            f'<joint name="{name}" type="revolute">',
            f'  <parent link="{above}"/><child link="{name}_link"/>',
            f'  <origin xyz="{_row(place.translation)}" rpy="{_row(pin.rpy.matrixToRpy(place.rotation))}"/>',
            f'  <axis xyz="{_row(axis)}"/>',
            f'  <limit lower="{low}" upper="{high}" velocity="{speed}" effort="{model.effortLimit[v]}"/>',
            "</joint>",
        ]
    inside = "\n  ".join(lines)
    return f'<?xml version="1.0"?>\n<robot name="arm">\n  {inside}\n</robot>\n'


def _inertial(body: pin.Inertia) -> str:
    moments = body.inertia
    pairs = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2), "zz": (2, 2)}
    values = " ".join(f'i{name}="{float(moments[at])!r}"' for name, at in pairs.items())
    mass = f'<origin xyz="{_row(body.lever)}"/><mass value="{float(body.mass)!r}"/>'
    return f"<inertial>{mass}<inertia {values}/></inertial>"


def _row(values: Iterable[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def with_wrong_inertials(model: pin.Model, rng: np.random.Generator, size: float) -> pin.Model:
    """Return the model with every body's mass and extents off by factors of about 1 +- size, its centre by as much.

    Second moments S about the centre become e^a F S F' with F = I + size/2 G: a possible body stays one.
    """
    wrong = model.copy()
    for k in range(1, model.njoints):
        body = model.inertias[k]
        spread = 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia
        mass = float(body.mass * np.exp(size * np.clip(rng.standard_normal(), -2, 2)))
        stretch = np.eye(3) + 0.5 * size * np.clip(rng.standard_normal((3, 3)), -2, 2)
        spread = mass / body.mass * stretch @ spread @ stretch.T
        reach = np.linalg.norm(body.lever) + np.sqrt(np.trace(spread) / mass)
        lever = body.lever + 0.4 * size * reach * np.clip(rng.standard_normal(3), -2, 2)
        wrong.inertias[k] = pin.Inertia(mass, lever, np.trace(spread) * np.eye(3) - spread)
    return wrong
