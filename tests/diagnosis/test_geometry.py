"""A joint that sits elsewhere than its URDF says is found there, though no torque feels all of its numbers."""

from __future__ import annotations

import math

import pytest
from effects import test_whole_robot_effects as robots
from simulated import record

import torchrbd

assert robots.TestSites.UPRIGHT.urdf is not None
RIGHT = robots.TestSites.UPRIGHT.urdf.decode()
SHIFT_M = 0.03


@pytest.mark.slow
def test_the_second_joint_of_an_upright_robot_is_found_off() -> None:
    """A shift along the first axis, which is vertical, moves everything up: it stays open."""
    joint = RIGHT.index('name="j1"')
    moved = RIGHT[:joint] + RIGHT[joint:].replace('<origin xyz="0 0 .3"/>', f'<origin xyz="{SHIFT_M} 0 .3"/>', 1)
    recording = record(moved, 4, duration_s=20.0, rate_hz=125.0)
    result = torchrbd.diagnose(RIGHT, recording, effects=["geometry_error", "base_tilt", "encoder_offset"])
    (found,) = (f for f in result.findings if f.effect == "geometry_error")
    assert found.joints == ("j1",)
    assert found.probability > 0.9
    assert found.parameters["x"].value == pytest.approx(SHIFT_M, abs=2e-3)
    assert math.isnan(found.parameters["z"].value)
