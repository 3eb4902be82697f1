"""Recordings that are wrong or odd: told, or survived, but never a traceback or a silent wrong answer."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
import torch
from inference.problems import urdf_of
from shortened import slow_but
from simulated import record

from torchrbd.errors import InputError
from torchrbd.inference.identification import Identification
from torchrbd.inference.identify import identify
from torchrbd.parameters import is_physical
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

pytestmark = pytest.mark.usefixtures("fit_alone")

URDF = urdf_of(0, 4)
ROBOT = RobotModel.from_urdf(URDF)


def recording(*, torque: np.ndarray | float = 1.0, position: float = 1.0, noise: float = 0.02) -> Recording:
    """Record with torques and positions multiplied: wrong signs and units."""
    right = record(URDF, 0, duration_s=20.0, torque_noise=noise)
    (chunk,) = right.chunks(10**7)
    return Recording.from_arrays("wrong", right.joints, chunk.t, position * chunk.q, torque * chunk.tau)


def physical(found: Identification) -> bool:
    pi = torch.tensor([p.value for p in found.parameters if p.status != "term"], dtype=torch.float64)
    return bool(is_physical(pi.reshape(-1, 10), tolerance=0.0).all())


WRONG = {
    "mN m": {"torque": 1000.0},
    "kN m": {"torque": 1e-3},
    "one sign": {"torque": np.array([1.0, -1.0, 1.0, 1.0])},
    "degrees": {"position": 180 / np.pi},
    "all signs": {"torque": -1.0, "noise": 0.1},
}


@pytest.mark.parametrize("wrong", slow_but(("degrees", "all signs"), WRONG))
def test_wrong_units_and_signs_give_a_physical_robot(wrong: str) -> None:
    assert physical(identify(URDF, recording(**WRONG[wrong])))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_opposite_torques_with_little_noise(noise: float) -> None:
    """A robot of negative mass explains them perfectly, so that the weights explode and the physical fit fails."""
    assert physical(identify(URDF, recording(torque=-1.0, noise=noise)))


def test_noise_free_simulation() -> None:
    found = identify(URDF, record(URDF, 0, duration_s=20.0, torque_noise=0.0, encoder_noise=0.0), effects=[])
    assert found.fits["rigid_body"].mean_nmse < 1e-6
    np.testing.assert_allclose([p.value for p in found.parameters], ROBOT.pi.numpy(), atol=0.02)


def test_joints_without_torque_are_left_out() -> None:
    right = recording()
    (chunk,) = right.chunks(10**7)
    chunk.tau[:, 2] = np.nan
    found = identify(URDF, Recording.from_arrays("part", right.joints, chunk.t, chunk.q, chunk.tau))
    assert set(found.fits["urdf"].nmse) == set(right.joints) - {right.joints[2]}
    assert any(right.joints[2] in note for note in found.notes)


@pytest.mark.parametrize("value", [0.0, 5.0])
def test_a_torque_that_never_changes_is_no_measurement(value: float) -> None:
    """Drivers write zeros where a torque is not measured."""
    right = recording()
    (chunk,) = right.chunks(10**7)
    chunk.tau[:, 2] = value
    found = identify(URDF, Recording.from_arrays("part", right.joints, chunk.t, chunk.q, chunk.tau))
    assert set(found.fits["urdf"].nmse) == set(right.joints) - {right.joints[2]}
    assert any(right.joints[2] in note for note in found.notes)


@pytest.mark.parametrize("names", [[3, 1, 2, 0], None], ids=["order", "others"])
def test_recording_of_other_joints(names: list[int] | None) -> None:
    """`Recording.from_arrays` takes joints in any order; they must be brought in the robot's, or refused."""
    right = recording()
    (chunk,) = right.chunks(10**7)
    order = names or [0, 1, 2, 3]
    joints = [right.joints[k] for k in names] if names else ["a", "b", "c", "d"]
    other = Recording.from_arrays("other", joints, chunk.t, chunk.q[:, order], chunk.tau[:, order])
    with contextlib.suppress(InputError):
        assert identify(URDF, other).fits["urdf"].mean_nmse < 1e-3
        assert names


def test_all_links_trusted() -> None:
    found = identify(URDF, recording(), trust=list(ROBOT.body_names))
    assert found.fits["rigid_body"] == found.fits["urdf"]


def test_a_small_part_to_hold_out_is_at_least_one_block() -> None:
    with contextlib.suppress(InputError):
        assert identify(URDF, recording(), holdout_fraction=0.05).fits["urdf"].nmse


def test_no_joint_in_use_is_told() -> None:
    with pytest.raises(InputError, match="no torque"):
        identify(URDF, recording(), joints=[])
