"""A link length that is off by more than descriptions are is told as that of another variant."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from effects import test_whole_robot_effects as robots
from simulated import record

import torchrbd
from torchrbd.diagnosis.results import Finding, Quantity, Where
from torchrbd.diagnosis.variant import another_variant

ROBOT = robots.TestSites.UPRIGHT
assert ROBOT.urdf is not None
RIGHT = ROBOT.urdf.decode()


def off(z: float, std: float, effect: str = "geometry_error") -> Finding:
    numbers = {"x": (0.0, 0.001), "y": (math.nan, math.nan), "z": (z, std)}
    told = {name: Quantity(*both, "m") for name, both in numbers.items()}
    turns = {name: Quantity(0.0, 0.01, "rad") for name in ("rx", "ry", "rz")}
    return Finding(effect, ("j1",), (), 0.99, 50.0, told | turns, Where(), (), {}, {})


@pytest.mark.parametrize(("z", "length"), [(0.12, "0.42"), (-0.1, "0.2")])
def test_a_certain_other_length_is_told(z: float, length: str) -> None:
    one = replace(off(z, 0.005), variant=another_variant(off(z, 0.005), ROBOT))
    assert f"It would be {length} m from the origin of l0; the URDF says 0.3 m." in one.statement


@pytest.mark.parametrize("one", [off(0.05, 0.005), off(0.12, 0.05), off(0.12, 0.005, "payload")])
def test_a_mistake_of_centimetres_or_an_uncertain_one_is_not(one: Finding) -> None:
    assert another_variant(one, ROBOT) is None


@pytest.mark.slow
def test_the_diagnosis_says_it() -> None:
    joint = RIGHT.index('name="j1"')
    moved = RIGHT[:joint] + RIGHT[joint:].replace('<origin xyz="0 0 .3"/>', '<origin xyz=".1 0 .3"/>', 1)
    recording = record(RIGHT, 4, duration_s=20.0, rate_hz=125.0)
    result = torchrbd.diagnose(moved, recording, effects=["geometry_error", "base_tilt", "encoder_offset"])
    told = " ".join((*(f.statement for f in result.findings), *result.identification.doubts))
    assert "URDF of another variant" in told or "URDF of this robot's variant" in told
