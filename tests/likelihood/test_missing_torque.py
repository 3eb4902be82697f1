"""Of a joint whose torque a recording lacks, that recording says nothing."""

from __future__ import annotations

import numpy as np
import pytest
from likelihood.arms import none_kept_back, recorded, rows_of
from likelihood.fits import OPTIONS, URDF, with_friction

from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.machine import Machine
from torchrbd.robot import RobotModel


def test_recording_without_a_joints_torque_does_not_shrink_what_is_believed_of_it() -> None:
    """Of how large coefficients of a joint may be, a recording that does not measure its torque says nothing."""
    robot = RobotModel.from_urdf(URDF)
    one = recorded(URDF, 2, with_friction(), name="one", **OPTIONS)
    other = recorded(URDF, 2, with_friction(), name="other", missing=[robot.joint_names[1]], **OPTIONS)
    alone, both = Machine(rows_of(robot, [one])), Machine(rows_of(robot, [one, other], none_kept_back))
    np.testing.assert_allclose(both.torque_rms, alone.torque_rms, rtol=1e-3)


def test_recording_without_a_joints_torque_does_not_colour_its_noise() -> None:
    """What the model has for a torque that nobody measured is no error of it."""
    robot = RobotModel.from_urdf(URDF)
    one = recorded(URDF, 2, with_friction(), name="one", **OPTIONS)
    other = recorded(URDF, 5, with_friction(), name="other", missing=[robot.joint_names[1]], **OPTIONS)
    alone, both = learn(Machine(rows_of(robot, [one]))), learn(Machine(rows_of(robot, [one, other], none_kept_back)))
    rows = both.machine.rows
    assert not both.residual(1)[~rows.measured[1]].any()
    gains = [1.0 - fit.hyper.noise[1].predictor.sum() for fit in (alone, both)]
    assert gains[1] == pytest.approx(gains[0], rel=0.3)
