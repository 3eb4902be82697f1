"""Single effects against their textbook values, and effects that a third party adds."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest
import torch
from effects.sites import ROBOT, signals
from torch import Tensor

from torchrbd.effects import (
    Effect,
    JointEffect,
    JointScale,
    JointState,
    Shape,
    Site,
    Term,
    effect,
    known_effects,
    register,
    registry,
)
from torchrbd.errors import InputError, OptionError

SCALE = JointScale(3.0, 0.02)


def torque(name: str, q: float, qd: float, qdd: float, **parameters: float) -> float:
    w, shape = effect(name).coefficients(parameters)
    term = Term(effect(name), Site(0), torch.tensor(w, dtype=torch.float64), shape)
    at = (torch.full((ROBOT.n_dof,), v, dtype=torch.float64) for v in (q, qd, qdd))
    return float(term(signals(*at, rest_width=1e-4)).detach())


def test_values_of_the_equations() -> None:
    assert torque("viscous_friction", 0.3, -0.5, 9, viscous=2.0) == pytest.approx(-1.0)
    assert torque("coulomb_friction", 0.3, -0.5, 9, coulomb=2.0) == pytest.approx(-2.0)
    assert torque("asymmetric_coulomb_friction", 0, 0.5, 9, coulomb_plus=2.0, coulomb_minus=3.0) == pytest.approx(2.0)
    assert torque("asymmetric_coulomb_friction", 0, -0.5, 9, coulomb_plus=2.0, coulomb_minus=3.0) == pytest.approx(-3.0)
    assert torque("rotor_inertia", 0.3, -0.5, 9, rotor_inertia=0.1) == pytest.approx(0.9)
    assert torque("joint_spring", 0.3, -0.5, 9, stiffness=4.0, rest_position=0.5) == pytest.approx(-0.8)
    assert torque("torque_offset", 0.3, -0.5, 9, offset=-0.7) == pytest.approx(-0.7)
    stribeck = {"coulomb": 1.0, "static": 3.0, "stribeck_speed": 0.2}
    assert torque("stribeck_friction", 0, -0.2, 9, **stribeck) == pytest.approx(-(1 + 2 / math.e))
    assert torque("stribeck_friction", 0, 5.0, 9, **stribeck) == pytest.approx(1.0)
    assert torque("stribeck_friction", 0, 1e-3, 9, **stribeck) == pytest.approx(3.0, rel=1e-4)


def test_units() -> None:
    assert effect("viscous_friction").unit("viscous", prismatic=False) == "N m s/rad"
    assert effect("viscous_friction").unit("viscous", prismatic=True) == "N s/m"
    assert effect("joint_spring").unit("rest_position", prismatic=True) == "m"
    assert effect("rotor_inertia").unit("rotor_inertia", prismatic=True) == "N s^2/m"
    assert effect("stribeck_friction").unit("stribeck_speed", prismatic=False) == "rad/s"


@pytest.mark.parametrize("name", ["rotor_inertia", "joint_spring"])
def test_negative_inertia_and_stiffness_are_not_plausible(name: str) -> None:
    found = dict.fromkeys(effect(name).units, 1.0)
    assert effect(name).plausible(found, SCALE)
    assert not effect(name).plausible({**found, next(iter(found)): -0.1}, SCALE)


def test_stribeck_needs_a_bump_that_speeds_can_show() -> None:
    stribeck = effect("stribeck_friction")
    assert not stribeck.plausible({"coulomb": 2.0, "static": 1.0, "stribeck_speed": 0.2}, SCALE)
    speeds = [shape["stribeck_speed"] for shape in stribeck.shapes(SCALE)]
    assert speeds == sorted(speeds)
    assert SCALE.rest_width < speeds[0] < speeds[-1] < SCALE.speed_max
    assert stribeck.shapes(JointScale(0.05, 0.02)) == ()


def test_stiffness_without_spring_has_no_rest_position() -> None:
    """A fit may return a stiffness of exactly zero (a column that data and prior do not move)."""
    found = effect("joint_spring").parameters(torch.zeros(2, dtype=torch.float64), {})
    assert float(found["stiffness"]) == 0.0


def test_unknown_effect_is_told_with_the_known_ones() -> None:
    known = r"known: .*coulomb_friction.*viscous_friction"
    with pytest.raises(OptionError, match=rf"unknown effect 'coulomb'; did you mean 'coulomb_friction'\? {known}"):
        effect("coulomb")
    assert issubclass(OptionError, InputError)


class CubicDrag(JointEffect):
    """tau += k qd^3, as a user may add it."""

    id = "cubic_drag"
    words = "cubic drag"
    equation = "k qd^3"
    units = {"drag": "{tau} s^3/{q}^3"}  # noqa: RUF012
    dissipative = True

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        return {"qd^3": state.qd**3}

    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"drag": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["drag"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["drag"] >= 0


@pytest.fixture
def cubic_drag(monkeypatch: pytest.MonkeyPatch) -> Effect:
    monkeypatch.setattr(registry, "_EFFECTS", known_effects())
    return register(CubicDrag())


def test_a_third_party_registers_an_effect(cubic_drag: Effect) -> None:
    assert effect("cubic_drag") is cubic_drag is known_effects()["cubic_drag"]
    assert torque("cubic_drag", 0, -2.0, 0, drag=0.5) == pytest.approx(-4.0)
    assert cubic_drag.urdf_dynamics({"drag": 1.0}) == {}
    assert cubic_drag.shapes(SCALE) == ({},)


def test_it_is_gone_after_the_test_and_the_dictionary_is_a_copy() -> None:
    assert "cubic_drag" not in known_effects()
    known_effects().clear()
    assert known_effects()


@pytest.mark.parametrize("missing", ["joint_features", "parameters", "coefficients", "plausible"])
def test_an_incomplete_effect_cannot_be_made(missing: str) -> None:
    incomplete = type("Incomplete", (CubicDrag,), {missing: getattr(JointEffect, missing)})
    with pytest.raises(TypeError, match=missing):
        incomplete()


def test_friction_is_a_shape_over_velocity_or_modulates_one() -> None:
    """But for viscous and Coulomb friction, which every joint has."""
    every = [effect(name) for name in known_effects()]
    friction = {e.id for e in every if e.family == "friction"}
    plain = {"viscous_friction", "coulomb_friction", "asymmetric_coulomb_friction"}
    assert {e.id for e in every if e.friction_part} == friction - plain
    assert {"stribeck_friction", "presliding_hysteresis"} <= {e.id for e in every if e.friction_part == "shape"}
    assert {"load_dependent_friction", "position_dependent_friction"} <= {
        e.id for e in every if e.friction_part == "modulator"
    }
