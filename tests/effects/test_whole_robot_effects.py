"""Effects of the whole robot against Pinocchio's torques of the changed robot: exact, or to first or second order.

First order means: half the size leaves a quarter of the error; second order, an eighth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import torch
from effects.sites import SCALE
from robot.random_robots import random_states, random_urdf

from torchrbd.effects import Effect, Signals, Site, Term, Window, known_effects
from torchrbd.effects.base_tilt import BaseTilt
from torchrbd.effects.encoder_offset import EncoderOffset
from torchrbd.effects.external_wrench import ExternalWrench
from torchrbd.effects.geometry_error import GeometryError
from torchrbd.effects.nameless import FORCE_AT_POINT, FRICTION_FOR_A_TIME
from torchrbd.effects.payload import Payload
from torchrbd.robot import PARAMETERS, RobotModel

URDF = random_urdf(21, 5, kinds=("revolute", "prismatic"), branching=0.2, fixed=0.5)
ROBOT = RobotModel.from_urdf(URDF)
MODEL = pin.buildModelFromXML(URDF)
JOINTS = [MODEL.getJointId(name) for name in ROBOT.joint_names]
ORDER = [MODEL.joints[joint].idx_v for joint in JOINTS]
STATES = random_states(3, ROBOT.n_dof, 20)
HALF = Window("rec", 0.45, 1.45)


def at(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> Signals:
    """Return signals of states (n, N), 0.1 s apart."""
    x = [torch.from_numpy(np.ascontiguousarray(v)) for v in (q, qd, qdd)]
    width = torch.full((ROBOT.n_dof,), 1e-3, dtype=torch.float64)
    return Signals(ROBOT, *x, width, t=0.1 * torch.arange(q.shape[1], dtype=torch.float64), recording="rec")


def rnea(model: pin.Model, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, forces=None) -> np.ndarray:
    """Return Pinocchio's torques (n, N) in our order of joints; forces: a function of q that gives one per joint."""
    data, torques = model.createData(), []
    for row in zip(q.T, qd.T, qdd.T, strict=True):
        args = [np.zeros(model.nv) for _ in row]
        for x, values in zip(args, row, strict=True):
            x[ORDER] = values
        extra = () if forces is None else (forces(model, data, args[0]),)
        torques.append(pin.rnea(model, data, *args, *extra)[ORDER])
    return np.stack(torques, 1)


def torque(effect: Effect, site: Site, parameters: Mapping[str, float]) -> np.ndarray:
    w, shape = effect.coefficients(parameters)
    return Term(effect, site, torch.tensor(w, dtype=torch.float64), shape)(at(*STATES)).detach().numpy()


def errors(
    effect: Effect, site: Site, direction: Mapping[str, float], changed: Callable[[Mapping[str, float]], np.ndarray]
) -> np.ndarray:
    """Return how far an effect is from the changed robot's torque at full and half the size, in parts of it, (2,)."""
    plain, found = rnea(MODEL, *STATES), []
    for size in (1.0, 0.5):
        parameters = {name: size * value for name, value in direction.items()}
        exact = changed(parameters) - plain
        found.append(np.linalg.norm(torque(effect, site, parameters) - exact) / np.linalg.norm(exact))
    return np.array(found)


def assert_orders(
    effect: Effect, site: Site, direction: Mapping[str, float], changed: Callable[[Mapping[str, float]], np.ndarray]
) -> None:
    """Assert that small displacements are told to first order, and ten times larger ones to second order."""
    small = errors(effect, site, direction, changed)
    assert small.max() < 0.03
    assert 1.75 < small[0] / small[1] < 2.25
    large = errors(effect, site, {name: 10.0 * value for name, value in direction.items()}, changed)
    assert large.max() < 0.03
    assert 3.5 < large[0] / large[1] < 4.5


def test_tilted_base() -> None:
    def changed(tilt: Mapping[str, float]) -> np.ndarray:
        model = pin.buildModelFromXML(URDF)
        model.gravity.linear = pin.exp3(np.array([tilt["tilt_x"], tilt["tilt_y"], 0.0])).T @ model.gravity.linear
        return rnea(model, *STATES)

    assert_orders(BaseTilt(), Site(), {"tilt_x": 0.01, "tilt_y": -0.015}, changed)


def test_bodies_act_through_a_tilt_as_its_torque_says() -> None:
    w, signals = torch.tensor([0.13, -0.15], dtype=torch.float64), at(*STATES)
    pi = torch.randn(ROBOT.n_params, dtype=torch.float64)
    C = BaseTilt().through_bodies(signals, w)
    both = BaseTilt().features(replace(signals, pi=pi), Site(), BaseTilt().agreeing(w, {})).values()
    torch.testing.assert_close(torch.einsum("jpn,p->jn", C, pi), sum(c * phi for c, phi in zip(w, both, strict=True)))


def test_base_on_a_wall_tilts_about_the_axes_that_gravity_sees() -> None:
    wall = RobotModel.from_urdf(URDF, gravity=(9.81, 0.0, 0.0))
    (site,) = BaseTilt().sites(wall)
    signals = at(*STATES)
    features = BaseTilt().features(Signals(wall, signals.q, signals.qd, signals.qdd, signals.rest_width), site, {})
    model = pin.buildModelFromXML(URDF)
    for phi, turn in zip(features.values(), ([0.0, 1e-6, 0.0], [0.0, 0.0, 1e-6]), strict=True):
        model.gravity.linear = np.array([9.81, 0.0, 0.0])
        plain = rnea(model, *STATES)
        model.gravity.linear = pin.exp3(np.array(turn)).T @ model.gravity.linear
        np.testing.assert_allclose(phi.numpy(), (rnea(model, *STATES) - plain) / 1e-6, atol=1e-3)


@pytest.mark.parametrize("joint", range(ROBOT.n_dof))
def test_encoder_offset(joint: int) -> None:
    def changed(parameters: Mapping[str, float]) -> np.ndarray:
        q = STATES[0].copy()
        q[joint] -= parameters["offset"]
        return rnea(MODEL, q, *STATES[1:])

    assert errors(EncoderOffset(), Site(joint), {"offset": 0.2}, changed).max() < 1e-10
    small = errors(EncoderOffset(), Site(joint), {"offset": 0.01}, changed)
    assert 1.75 < small[0] / small[1] < 2.25


@pytest.mark.parametrize("joint", [j for j in range(ROBOT.n_dof) if MODEL.parents[JOINTS[j]] > 0])
def test_geometry_error(joint: int) -> None:
    def changed(parameters: Mapping[str, float]) -> np.ndarray:
        model = pin.buildModelFromXML(URDF)
        shift, turn = np.split(np.array([parameters[name] for name in GeometryError.units]), 2)
        frame = model.frames[model.getFrameId(ROBOT.joint_names[joint])]
        parent = model.frames[frame.parentFrame].placement.rotation
        old = model.jointPlacements[JOINTS[joint]]
        model.jointPlacements[JOINTS[joint]] = pin.SE3(
            pin.exp3(parent @ turn) @ old.rotation, old.translation + parent @ shift
        )
        return rnea(model, *STATES)

    sizes = {"x": 0.005, "y": -0.01, "z": 0.008, "rx": 0.01, "ry": -0.015, "rz": 0.012}
    assert_orders(GeometryError(), Site(joint), sizes, changed)


def test_what_no_torque_feels_displaces_nothing() -> None:
    told = dict.fromkeys(GeometryError.units, 0.0) | {"z": float("nan"), "rx": 0.1}
    _, shape = GeometryError().coefficients(told)
    assert {name: value for name, value in shape.items() if value} == {"about_rx": 0.1}


def test_payload_is_an_added_body_for_a_while() -> None:
    site = Payload().sites(ROBOT, (HALF,))[-1]
    assert site.body is not None
    mass, centre, inertia = 1.7, np.array([0.05, -0.02, 0.12]), np.diag([0.01, 0.02, 0.015])
    own = pin.Inertia(mass, centre, inertia)
    about_origin = inertia + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    I = {f"I{'xyz'[i]}{'xyz'[k]}": about_origin[i, k] for i in range(3) for k in range(i, 3)}  # noqa: E741
    added = torque(Payload(), site, {"mass": mass, **dict(zip("xyz", centre, strict=True)), **I})
    model = pin.buildModelFromXML(URDF)
    model.inertias[JOINTS[ROBOT.joint_bodies.index(site.body)]] += own
    expected = rnea(model, *STATES) - rnea(MODEL, *STATES)
    inside = (np.arange(20) >= 5) & (np.arange(20) <= 14)
    np.testing.assert_allclose(added, expected * inside, atol=1e-10)


def pushed(joint: int, force: np.ndarray, point: np.ndarray, moment: np.ndarray | float = 0.0) -> np.ndarray:
    """Return Pinocchio's torques (n, N) for a force at a point of a joint's frame, and a moment, in the base's axes."""

    def forces(model: pin.Model, data: pin.Data, q: np.ndarray) -> pin.StdVec_Force:
        pin.forwardKinematics(model, data, q)
        found, R = pin.StdVec_Force(), data.oMi[joint].rotation.T
        f = R @ force
        own = pin.Force(f, np.cross(point, f) + R @ (moment + np.zeros(3)))
        for k in range(model.njoints):
            found.append(own if k == joint else pin.Force.Zero())
        return found

    inside = (np.arange(20) >= 5) & (np.arange(20) <= 14)
    return (rnea(MODEL, *STATES, forces=forces) - rnea(MODEL, *STATES)) * inside


def test_wrench_is_pinocchios_external_force() -> None:
    site = ExternalWrench().sites(ROBOT, (HALF,))[-1]
    assert site.body is not None
    joint, wrench = JOINTS[ROBOT.joint_bodies.index(site.body)], np.array([5.0, -3.0, 8.0, 0.4, -1.2, 0.7])
    added = torque(ExternalWrench(), site, dict(zip(ExternalWrench.units, wrench, strict=True)))
    np.testing.assert_allclose(added, pushed(joint, wrench[:3], np.zeros(3), wrench[3:]), atol=1e-10)


def test_force_at_a_point_is_pinocchios() -> None:
    site = FORCE_AT_POINT.sites(ROBOT, (HALF,))[-1]
    assert site.body is not None
    joint = JOINTS[ROBOT.joint_bodies.index(site.body)]
    force, point = np.array([5.0, -3.0, 8.0]), np.array([0.1, -0.3, 0.2])
    values = np.concatenate((force, np.outer(point, force).ravel()))
    added = torque(FORCE_AT_POINT, site, dict(zip(FORCE_AT_POINT.units, values, strict=True)))
    np.testing.assert_allclose(added, pushed(joint, force, point), atol=1e-10)


def test_friction_for_a_time_is_coulomb_friction_within_its_window() -> None:
    sites = FRICTION_FOR_A_TIME.sites(ROBOT, (HALF,))
    assert [site.joint for site in sites] == list(range(ROBOT.n_dof))
    inside = (np.arange(20) >= 5) & (np.arange(20) <= 14)
    added = torque(FRICTION_FOR_A_TIME, sites[1], {"coulomb": 2.0})
    always = torque(known_effects()["coulomb_friction"], Site(1), {"coulomb": 2.0})
    np.testing.assert_allclose(added, always * inside, atol=1e-12)


class TestSites:
    """An effect sits only where its coefficients can be told."""

    UPRIGHT = RobotModel.from_urdf(
        '<robot name="upright"><link name="base"/>'
        + "".join(
            f'<link name="l{k}"><inertial><origin xyz=".1 .02 .2"/><mass value="2"/><inertia ixx=".02" iyy=".02" '
            f'izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j{k}" type="revolute"><parent link="'
            f'{"base" if k == 0 else f"l{k - 1}"}"/><child link="l{k}"/><origin xyz="0 0 .3"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
            for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "0 0 1"))
        )
        + "</robot>"
    )

    def test_zero_of_an_upright_first_joint_does_not_show(self) -> None:
        assert [site.joint for site in EncoderOffset().sites(self.UPRIGHT)] == [1, 2, 3, 4, 5]

    def test_geometry_of_the_first_joint_is_the_bases(self) -> None:
        """That of the second shows, though gravity sees no shift along the first axis."""
        assert [site.joint for site in GeometryError().sites(self.UPRIGHT)] == [1, 2, 3, 4, 5]

    def test_wrench_and_payload_need_joints_and_windows(self) -> None:
        for effect in (ExternalWrench(), Payload()):
            assert effect.sites(self.UPRIGHT) == ()
            bodies = [site.body for site in effect.sites(self.UPRIGHT, (HALF, Window("other")))]
            assert bodies == 2 * list(range(6))

    def test_what_no_joint_feels_of_a_load_is_no_number(self) -> None:
        """Behind one upright axis a mass shows by its inertia about that axis alone."""
        (site,) = [s for s in Payload().sites(self.UPRIGHT, (HALF,)) if s.body == 0]
        x = torch.randn(3, self.UPRIGHT.n_dof, 20, dtype=torch.float64)
        width, t = torch.ones(self.UPRIGHT.n_dof, dtype=torch.float64), 0.1 * torch.arange(20, dtype=torch.float64)
        features = Payload().features(Signals(self.UPRIGHT, *x, width, t=t, recording="rec"), site, {})
        assert [name for name, phi in zip(PARAMETERS, features.values(), strict=True) if phi.any()] == ["Izz"]

    def test_no_gravity_no_tilt(self) -> None:
        assert BaseTilt().sites(self.UPRIGHT.with_gravity((0.0, 0.0, 0.0))) == ()


def test_what_is_not_plausible() -> None:
    assert BaseTilt().plausible({"tilt_x": 0.02, "tilt_y": -0.03}, SCALE)
    assert not BaseTilt().plausible({"tilt_x": 0.02, "tilt_y": -0.5}, SCALE)
    assert not EncoderOffset().plausible({"offset": -0.4}, SCALE)
    geometry = dict.fromkeys(GeometryError.units, 0.01)
    assert GeometryError().plausible(geometry, SCALE)
    assert GeometryError().plausible({**geometry, "z": math.nan}, SCALE), "what no torque feels contradicts nothing"
    assert not GeometryError().plausible({**geometry, "y": 0.25}, SCALE)
    assert not GeometryError().plausible({**geometry, "rz": -0.3}, SCALE)
    load = {**dict.fromkeys(Payload.units, 0.01), "mass": 1.0}
    assert Payload().plausible(load, SCALE)
    assert not Payload().plausible({**load, "mass": -1.0}, SCALE)
    assert Payload().plausible({**load, "mass": 0.0}, SCALE), "a mass within chance of zero is taken for zero"
    unfelt = {**dict.fromkeys(Payload.units, math.nan), "Izz": 0.2}
    assert Payload().plausible(unfelt, SCALE)
    assert not Payload().plausible({**unfelt, "Izz": -0.2}, SCALE)
    assert not Payload().plausible({**load, "z": 1.5}, SCALE)


def test_what_no_joint_feels_of_a_load_leaves_the_rest_differentiable() -> None:
    """On a planar arm one coordinate of a load's centre moves nothing, and is not a number: the others have slopes."""
    w = torch.tensor([2.0, 0.4, torch.nan, 0.2, *[0.1] * 6], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(Payload().parameters(w, {})["x"], w)
    expected = torch.zeros_like(slope)
    expected[0], expected[1] = -0.4 / 2.0**2, 1 / 2.0
    torch.testing.assert_close(slope, expected)
