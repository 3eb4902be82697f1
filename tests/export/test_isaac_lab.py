"""Drives as a configuration for Isaac Lab: the file is run, and its numbers are those of the model."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import torch
from robot.random_robots import random_urdf

import torchrbd
from torchrbd import RigidBodyDynamics, RobotModel
from torchrbd.effects import Site, Term, effect
from torchrbd.errors import OptionError, PhysicalError
from torchrbd.export.isaac_lab import to_isaac_lab
from torchrbd.recordings import Drives
from torchrbd.recordings.drives import Drive

ARM = random_urdf(5, 3, kinds=("revolute",), branching=0.0, massless=0.0)


def term(name: str, site: Site, **given: float) -> Term:
    w, shape = effect(name).coefficients(given)
    return Term(effect(name), site, torch.tensor(w, dtype=torch.float64), shape)


def arm(*terms: Term, **drives: Drive) -> RigidBodyDynamics:
    robot = RobotModel.from_urdf(ARM)
    return RigidBodyDynamics(robot, terms=terms, drives=Drives(robot.joint_names, drives, 0.0124))


def configured(model: RigidBodyDynamics, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the arguments that the file gives to its actuators."""
    package, actuators = ModuleType("isaaclab"), ModuleType("isaaclab.actuators")
    actuators.DelayedPDActuatorCfg = SimpleNamespace  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "isaaclab", package)
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", actuators)
    space: dict[str, Any] = {}
    exec(to_isaac_lab(model).decode(), space)
    return vars(space["ACTUATORS"]["drives"])


def test_gains_friction_rotors_and_delay_are_those_of_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    model = arm(
        term("viscous_friction", Site(0), viscous=0.3),
        term("coulomb_friction", Site(1), coulomb=0.7),
        term("rotor_inertia", Site(1), rotor_inertia=0.2),
        joint1=Drive(80.0, 2.5),
        joint2=Drive(120.0, 0.0, 1e-3),
    )
    found = configured(model, monkeypatch)
    assert found["joint_names_expr"] == ["joint1", "joint2"]
    assert found["stiffness"] == {"joint1": 80.0, "joint2": 120.0}
    assert found["damping"] == {"joint1": 2.5, "joint2": 0.0}
    assert found["viscous_friction"] == {"joint1": 0.3, "joint2": 0.0}
    assert found["friction"] == found["dynamic_friction"] == {"joint1": 0.0, "joint2": 0.7}
    assert found["armature"] == {"joint1": 0.0, "joint2": 0.2}
    assert found["effort_limit"]["joint2"] == 1e-3
    # Steps of 5 ms.
    assert found["min_delay"] == found["max_delay"] == 2
    (free,) = torchrbd.not_exported(model, "isaaclab")
    assert free == "joint3: no drive is known"


def test_what_it_has_no_word_for_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    drives = {f"joint{k}": Drive(10.0) for k in (1, 2, 3)}
    model = arm(term("joint_spring", Site(1), stiffness=2.0, rest_position=0.1), **drives)
    assert "armature" not in configured(model, monkeypatch)
    (spring,) = torchrbd.not_exported(model, "isaaclab")
    assert re.match("joint spring at joint2 .*: its actuators have no word for it", spring)
    assert spring in to_isaac_lab(model).decode()


def test_a_model_without_drives_or_with_negative_friction_is_refused() -> None:
    with pytest.raises(OptionError, match="knows no position drives"):
        to_isaac_lab(RigidBodyDynamics(RobotModel.from_urdf(ARM)))
    with pytest.raises(PhysicalError, match=r"joint1: damping is -0\.1"):
        to_isaac_lab(arm(term("viscous_friction", Site(0), viscous=-0.1), joint1=Drive(10.0)))


def test_drives_are_saved_with_the_model(tmp_path: Path) -> None:
    model = arm(joint1=Drive(80.0, 2.5), joint2=Drive(120.0, 0.0, 30.0))
    model.save(tmp_path / "model.safetensors")
    assert torchrbd.load_model(tmp_path).drives == model.drives
