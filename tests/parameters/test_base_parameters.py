"""What any motion of a robot tells: textbook cases, and numpy's rank."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from robot.random_robots import random_states, random_urdf

from torchrbd.parameters import base_parameters
from torchrbd.robot import RobotModel

LINK = (
    '<link name="{0}"><inertial><origin xyz="0.3 0 0"/><mass value="2"/>'
    '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial></link>'
)
JOINT = (
    '<joint name="{0}" type="{4}"><parent link="{1}"/><child link="{2}"/><origin xyz="{3}"/><axis xyz="{5}"/>'
    '<limit lower="-3" upper="3" velocity="3" effort="9"/></joint>'
)


def planar(*lengths: str, axis: str = "0 1 0", kind: str = "revolute") -> RobotModel:
    """Chain links; each joint sits at x = length in the link before it."""
    parts = ['<link name="base"/>']
    for k, length in enumerate(lengths, 1):
        parts += [LINK.format(f"l{k}")]
        parts += [JOINT.format(f"j{k}", f"l{k - 1}" if k > 1 else "base", f"l{k}", f"{length} 0 0", kind, axis)]
    return RobotModel.from_urdf(f'<robot name="planar">{"".join(parts)}</robot>')


def random_regressor(robot: RobotModel, seed: int = 7) -> np.ndarray:
    x = (torch.from_numpy(v) for v in random_states(seed, 4 * robot.n_params, robot.n_dof))
    return robot.regressor(*x).reshape(-1, robot.n_params).numpy()


ROBOTS = [
    random_urdf(0, 1),
    random_urdf(1, 4, kinds=("revolute",)),
    random_urdf(2, 6),
    random_urdf(3, 7, branching=0.7, massless=0.0),
    random_urdf(4, 5, mimic=0.5),
    random_urdf(5, 3, kinds=("prismatic",)),
]


@pytest.mark.parametrize("urdf", ROBOTS, ids=["one", "revolute", "mixed", "tree", "mimic", "prismatic"])
def test_count_is_the_rank_and_torque_depends_on_them_only(urdf: str) -> None:
    robot = RobotModel.from_urdf(urdf)
    base = base_parameters(robot)
    Y = random_regressor(robot)
    norms = np.linalg.norm(Y, axis=0)
    scaled = Y / np.where(norms > 1e-9 * norms.max(), norms, np.inf)
    assert len(base.independent) == np.linalg.matrix_rank(scaled, tol=1e-8 * np.linalg.norm(scaled, 2))
    K, own = base.combination.numpy(), list(base.independent)
    assert np.abs(Y - Y[:, own] @ K).max() < 1e-8 * np.abs(Y).max()
    np.testing.assert_allclose(K[:, own], np.eye(len(own)), rtol=0, atol=1e-13)
    assert own == sorted(own)
    pi = np.random.default_rng(0).normal(size=robot.n_params)
    np.testing.assert_allclose(Y @ pi, Y[:, own] @ (K @ pi), atol=1e-8 * np.abs(Y @ pi).max())


@pytest.mark.parametrize("urdf", ROBOTS[:4])
def test_invisible_ones_and_those_alone(urdf: str) -> None:
    robot = RobotModel.from_urdf(urdf)
    base = base_parameters(robot)
    Y = random_regressor(robot)
    assert set(base.invisible) == set(np.flatnonzero(np.abs(Y).max(0) < 1e-9 * np.abs(Y).max()))
    rank = len(base.independent)
    for k in range(robot.n_params):
        if k in base.invisible:
            continue
        others = np.delete(Y, k, axis=1) / np.linalg.norm(Y[:, k])
        without = np.linalg.matrix_rank(others, tol=1e-8 * np.linalg.norm(others, 2))
        assert (without < rank) == (k in base.alone), robot.parameter_names[k]


def named(robot: RobotModel) -> tuple[set[str], set[str]]:
    base = base_parameters(robot)
    return {base.names[k] for k in base.alone}, {base.names[k] for k in base.invisible}


def test_pendulum_in_the_vertical_plane() -> None:
    """Turning about y: mcx and mcz weigh, Iyy is swung; nothing else shows."""
    alone, invisible = named(planar("0"))
    assert alone == {"mcx_l1", "mcz_l1", "Iyy_l1"}
    assert invisible == {f"{p}_l1" for p in ("m", "mcy", "Ixx", "Ixy", "Ixz", "Iyz", "Izz")}


def test_pendulum_about_the_vertical_feels_no_gravity() -> None:
    alone, invisible = named(planar("0", axis="0 0 1"))
    assert alone == {"Izz_l1"}
    assert len(invisible) == 9


def test_slider_tells_its_mass_only() -> None:
    alone, invisible = named(planar("0", kind="prismatic"))
    assert alone == {"m_l1"}
    assert len(invisible) == 9


def test_planar_two_link_arm() -> None:
    """Textbook: mcx1 + l m2, mcz1, Iyy1 + l^2 m2 of the first link, and mcx, mcz, Iyy of the second."""
    base = base_parameters(planar("0", "0.5"))
    assert {base.names[k] for k in base.independent} >= {"mcz_l1", "mcx_l2", "mcz_l2", "Iyy_l2"}
    assert {base.names[k] for k in base.alone} == {"mcz_l1", "mcx_l2", "mcz_l2", "Iyy_l2"}
    assert len(base.independent) == 6
    pi = torch.arange(1.0, 21.0, dtype=torch.float64)
    beta = dict(zip((base.names[k] for k in base.independent), base.combination @ pi, strict=True))
    value = dict(zip(base.names, pi.tolist(), strict=True))
    assert float(beta["mcx_l1"]) == pytest.approx(value["mcx_l1"] + 0.5 * value["m_l2"])
    assert float(beta["Iyy_l1"]) == pytest.approx(value["Iyy_l1"] + 0.25 * value["m_l2"])
    said = tuple(map(str, base.combinations()))
    assert "only mcx_l1 + 0.5 m_l2 is identified" in said
    assert "only Iyy_l1 + 0.25 m_l2 is identified" in said
    assert tuple(map(str, base.combinations_with(base.names.index("m_l2")))) == said[:2]
    assert base.combinations_with(base.names.index("mcz_l1")) == ()
    assert said[-1].startswith("no motion of this robot identifies m_l1, mcy_l1, Ixx_l1")
    assert len(said) == 3


def test_sign_of_a_partner_is_told() -> None:
    for place, expression in (("-0.5", "mcx_l1 - 0.5 m_l2"), ("1", "mcx_l1 + m_l2")):
        found = base_parameters(planar("0", place)).combinations()
        assert f"only {expression} is identified" in [*map(str, found)]


def test_seed_changes_nothing() -> None:
    robot = RobotModel.from_urdf(ROBOTS[2])
    one, other = base_parameters(robot), base_parameters(robot, seed=5)
    assert one.independent == other.independent
    torch.testing.assert_close(one.combination, other.combination, rtol=1e-7, atol=1e-7)


def test_gravity_counts() -> None:
    robot = planar("0")
    still = robot.with_gravity((0.0, 0.0, 0.0))
    assert len(base_parameters(robot).independent) == 3
    assert {base_parameters(still).names[k] for k in base_parameters(still).independent} == {"Iyy_l1"}
