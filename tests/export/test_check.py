"""An exported file beside its model on a recording: the difference is what the file lacks."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from robot.random_robots import random_urdf
from simulated import multisine

import torchrbd
from torchrbd import RigidBodyDynamics, RobotModel
from torchrbd.effects import Site, Term, effect
from torchrbd.errors import InputError, OptionError
from torchrbd.export.check import FileCheck, check_file
from torchrbd.export.replay import replayed
from torchrbd.recordings import Recording

mujoco = pytest.importorskip("mujoco")
ROBOT = RobotModel.from_urdf(random_urdf(8, 3, kinds=("revolute", "prismatic"), branching=0.0, massless=0.0))
MOTION = multisine(3, 1, duration_s=10.0)


def term(name: str, site: Site, **given: float) -> Term:
    w, shape = effect(name).coefficients(given)
    return Term(effect(name), site, torch.tensor(w, dtype=torch.float64), shape)


def recorded(name: str = "a.csv") -> Recording:
    return Recording.from_arrays(name, ROBOT.joint_names, MOTION.t, MOTION.q, MOTION.q)


def checked(to: str, *terms: Term) -> FileCheck:
    return check_file(RigidBodyDynamics(ROBOT, terms=terms), to, [recorded()])


VISCOUS = term("viscous_friction", Site(1), viscous=0.7)
ROTOR = term("rotor_inertia", Site(0), rotor_inertia=0.4)


def test_mjcf_has_the_models_torque() -> None:
    gain, offset = term("torque_scale", Site(2), gain=1.2), term("torque_offset", Site(2), offset=0.4)
    found = checked("mjcf", VISCOUS, ROTOR, gain, offset)
    assert [one.joint for one in found.joints] == list(ROBOT.joint_names)
    assert [one.unit for one in found.joints] == ["N" if slides else "N m" for slides in ROBOT.prismatic.tolist()]
    assert all(one.part < 1e-9 for one in found.joints)
    assert all(one.torque > 0.1 for one in found.joints)
    assert found.samples > 50
    assert found.notes == ()


def test_urdf_lacks_the_rotor() -> None:
    first, second, third = checked("urdf", VISCOUS, ROTOR).joints
    rms = np.sqrt(np.mean((0.4 * MOTION.qdd[:, 0]) ** 2))
    assert first.difference == pytest.approx(rms, rel=0.1)
    assert first.part == first.difference / first.torque
    assert max(second.part, third.part) < 1e-9


def test_what_acts_in_one_recording_is_a_difference_there() -> None:
    spring = term("joint_spring", Site(2, recordings=("cold.csv",)), stiffness=2.0, rest_position=0.0)
    model = RigidBodyDynamics(ROBOT, terms=[spring])
    cold, warm = (check_file(model, "mjcf", [recorded(name)]).joints[2] for name in ("cold.csv", "warm.csv"))
    assert warm.part < 1e-9
    assert cold.difference == pytest.approx(2.0 * np.sqrt(np.mean(MOTION.q[:, 2] ** 2)), rel=0.1)
    both = check_file(model, "mjcf", [recorded("cold.csv"), recorded("warm.csv")]).joints[2]
    assert both.difference == pytest.approx(cold.difference / np.sqrt(2.0))


def test_lags_are_left_out_on_both_sides_of_mjcf_and_not_of_urdf() -> None:
    lag = term("actuator_lag", Site(0), time_constant=0.05)
    found = checked("mjcf", lag)
    assert found.joints[0].part < 1e-9
    (note,) = map(str, found.notes)
    assert note.endswith(
        "(time_constant 0.05 s, bandwidth 1e+04 Hz): is in the file's actuators, whose course in time is not compared"
    )
    assert checked("urdf", lag).joints[0].part > 0.01


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("to", ["mjcf", "urdf"])
def test_both_files_of_random_robots(to: str, seed: int) -> None:
    """Mimic joints, massless links, friction of the URDF."""
    model = RigidBodyDynamics.from_urdf(random_urdf(seed, 5, massless=0.3, mimic=0.3))
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.normal(size=(3, 10, model.robot.n_dof))
    tau = model(*map(torch.from_numpy, (q, qd, qdd))).detach().numpy()
    file = torchrbd.to_mjcf(model) if to == "mjcf" else torchrbd.to_urdf(model)
    np.testing.assert_allclose(replayed(file, model.robot, q, qd, qdd), tau, rtol=0, atol=1e-9 * np.abs(tau).max())


def test_without_mujoco_the_remedy_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(OptionError, match="MuJoCo is not installed: pip install mujoco"):
        checked("mjcf")


def test_bad_input() -> None:
    with pytest.raises(OptionError, match="no recording to check on"):
        check_file(RigidBodyDynamics(ROBOT), "mjcf", [])
    with pytest.raises(OptionError, match="there is no format 'sdf'"):
        check_file(RigidBodyDynamics(ROBOT), "sdf", [recorded()])
    still = np.zeros((1, 3))
    with pytest.raises(InputError, match=r"MuJoCo [0-9.]+ does not take the file \(.*unrecognized"):
        replayed(b"<mujoco><nonsense/></mujoco>", ROBOT, still, still, still)
    odd = URDF.format(base="1", tool="3")
    with pytest.raises(InputError, match=r"A \+ B >= C.*; correct the link in the URDF, or write MJCF"):
        replayed(odd.encode(), RobotModel.from_urdf(odd), *np.zeros((3, 1, 1)))


URDF = """<robot name="bar"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="{base}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="bar"><inertial><mass value="9"/><inertia ixx="9" iyy="9" izz="9" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tool"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="{tool}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="bar"/><axis xyz="0 1 0"/></joint>
<joint name="bolt" type="fixed"><parent link="bar"/><child link="tool"/><origin xyz="0 0 1"/></joint></robot>
"""


def test_odd_inertias_of_what_stands_still_do_not_matter_nor_does_what_is_fixed_in_mjcf() -> None:
    for base, tool, formats in (("3", "1", ("urdf", "mjcf")), ("1", "3", ("mjcf",))):
        model = RigidBodyDynamics.from_urdf(URDF.format(base=base, tool=tool))
        tau = model(*torch.ones(3, 1, 1, dtype=torch.float64)).detach().numpy()
        for to in formats:
            file = torchrbd.to_mjcf(model) if to == "mjcf" else torchrbd.to_urdf(model)
            np.testing.assert_allclose(replayed(file, model.robot, *np.ones((3, 1, 1))), tau, rtol=1e-9)


def test_mujoco_leaves_no_log_in_the_users_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It writes one of limits that are equal, which a URDF that does not know them has."""
    limit = '<limit lower="0" upper="0" effort="1" velocity="1"/></joint>'
    urdf = URDF.format(base="1", tool="1").replace("continuous", "revolute").replace("</joint>", limit, 1)
    model = RigidBodyDynamics.from_urdf(urdf)
    monkeypatch.chdir(tmp_path)
    for file in (torchrbd.to_mjcf(model), torchrbd.to_urdf(model)):
        replayed(file, model.robot, *np.ones((3, 1, 1)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("seed", [0, 2])
def test_followers_go_by_the_true_position_of_a_joint_whose_zero_is_off(seed: int) -> None:
    """The model is of first order in the offset: what differs is of second, 1e-6 of the torque here."""
    robot = RobotModel.from_urdf(random_urdf(seed + 70, 5, mimic=0.5, massless=0.0))
    assert robot.n_bodies > robot.n_dof
    off = term("encoder_offset", Site(0), offset=2e-3)
    t = np.arange(2000) / 200.0
    q = np.stack([0.3 * np.sin(2.0 * np.pi * (0.2 + 0.1 * k) * t + k) for k in range(robot.n_dof)], 1)
    recording = Recording.from_arrays("day", robot.joint_names, t, q, np.zeros_like(q))
    found = check_file(RigidBodyDynamics(robot, terms=[off]), "mjcf", [recording])
    assert max(one.part for one in found.joints) < 2e-5
