"""Options: what is understood, and what every bad one is answered."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from inference.problems import urdf_of

from torchrbd.effects import known_effects
from torchrbd.errors import OptionError
from torchrbd.options import Payload
from torchrbd.inference.settings import Settings
from torchrbd.robot import RobotModel


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_urdf(urdf_of(3, 3, fixed=1.0))


def test_options_as_a_yaml_file_gives_them() -> None:
    found = Settings.from_mapping(
        {
            "holdout": "a.csv",
            "time": "2:30",
            "joints": "joint1",
            "exclude": ["torque_offset"],
            "payload": ["dir/load.csv=1.5,0,0,.1", "b.csv=2,1,2,3@tool"],
            "cutoff_hz": 5,
            "mapping": "m.yaml",
        },
        "run.yaml",
    )
    assert found.holdout == (Path("a.csv"),)
    assert found.time == (2.0, 30.0)
    assert found.joints == ("joint1",)
    assert found.payload[0] == Payload("load.csv", 1.5, (0.0, 0.0, 0.1))
    assert found.payload[1] == Payload("b.csv", 2.0, (1.0, 2.0, 3.0), "tool")
    assert found.mapping == Path("m.yaml")
    assert "torque_offset" not in {e.id for e in found.chosen_effects()}
    assert Settings.from_mapping({}, "x") == Settings()


@pytest.mark.parametrize(
    ("given", "expected"),
    [("2:30", (2, 30)), (":30", (0, 30)), ("2:", (2, math.inf)), ([2, None], (2, math.inf)), ((1.5, 2), (1.5, 2))],
)
def test_time(given: Any, expected: tuple[float, float]) -> None:
    assert Settings.from_mapping({"time": given}, "x").time == expected


BAD = [
    ({"holdout_fractoin": 0.1}, r"run.yaml: unknown setting 'holdout_fractoin'; did you mean 'holdout_fraction'\?"),
    ({"zzz": 1}, r"run.yaml: unknown setting 'zzz'; known: cutoff_hz, effects"),
    ({"holdout_fraction": 0.0}, r"holdout_fraction is 0; expected a number in \(0, 0.5\]"),
    ({"holdout_fraction": 0.51}, r"holdout_fraction is 0.51; expected"),
    ({"holdout_fraction": math.nan}, r"holdout_fraction is nan; expected"),
    ({"holdout_fraction": "much"}, r"holdout_fraction is 'much'; expected a number"),
    ({"kappa": 0}, r"kappa is 0; expected a number above 0"),
    ({"kappa": -1.0}, r"kappa is -1; expected"),
    ({"kappa": math.nan}, r"kappa is nan; expected"),
    ({"kappa": "strong"}, r"kappa is 'strong'; expected a number"),
    ({"cutoff_hz": "low"}, r"cutoff_hz is 'low'; expected a number"),
    ({"seed": "x"}, r"seed is 'x'; expected a number"),
    ({"time": "5"}, r"run.yaml: time '5': expected FROM:TO in seconds, e.g. '2:30'"),
    ({"time": 5}, r"run.yaml: time '5': expected FROM:TO"),
    ({"time": "a:b"}, r"run.yaml: time 'a:b': expected FROM:TO"),
    ({"time": [1, 2, 3]}, r"expected FROM:TO"),
    ({"time": "3:2"}, r"run.yaml: time '3:2': the end must come after the start"),
    ({"time": "nan:2"}, r"expected FROM:TO"),
    ({"payload": "load.csv"}, r"payload 'load.csv': expected FILE=kg,x,y,z or FILE=kg,x,y,z@LINK"),
    ({"payload": "load.csv=1,2,3"}, r"payload 'load.csv=1,2,3': expected FILE=kg,x,y,z"),
    ({"payload": "load.csv=a,0,0,0"}, r"expected FILE=kg,x,y,z"),
    ({"payload": "load.csv=0,0,0,0"}, r"expected FILE=kg,x,y,z with a mass above zero"),
    ({"payload": "load.csv=-1,0,0,0"}, r"with a mass above zero"),
    ({"payload": "load.csv=1,nan,0,0"}, r"payload 'load.csv=1,nan,0,0': expected"),
    ({"payload": "=1,0,0,0"}, r"payload '=1,0,0,0': expected FILE"),
    ({"payload": {"load.csv": 1}}, r"expected FILE=kg,x,y,z"),
]


@pytest.mark.parametrize(("options", "message"), BAD, ids=lambda x: repr(x) if isinstance(x, dict) else "")
def test_bad_options_are_told(options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        Settings.from_mapping(options, "run.yaml")


@pytest.mark.parametrize("options", [{"kappa": math.inf}, {"seed": 1.5}], ids=repr)
def test_numbers_out_of_range_are_told(options: dict[str, Any]) -> None:
    with pytest.raises(OptionError):
        Settings.from_mapping(options, "run.yaml")


def test_effects_that_may_be_used() -> None:
    ids = lambda settings: [e.id for e in settings.chosen_effects()]  # noqa: E731
    assert ids(Settings()) == list(known_effects())
    assert ids(Settings(effects=("coulomb_friction", "rotor_inertia"))) == ["coulomb_friction", "rotor_inertia"]
    assert ids(Settings(effects=("coulomb_friction", "rotor_inertia"), exclude=("coulomb_friction",))) == [
        "rotor_inertia"
    ]
    for bad in (Settings(effects=("stiction",)), Settings(exclude=("stiction",))):
        with pytest.raises(
            OptionError,
            match=r"unknown effect 'stiction'; did you mean 'stribeck_friction'\? known: actuator_lag, asym",
        ):
            bad.chosen_effects()


def test_no_effect_left_is_told() -> None:
    with pytest.raises(OptionError):
        Settings(effects=("coulomb_friction",), exclude=("coulomb_friction",)).chosen_effects()


def test_names_are_checked_against_the_robot(robot: RobotModel) -> None:
    assert Settings(joints=("joint2",)).used_joints(robot).tolist() == [n == "joint2" for n in robot.joint_names]
    assert Settings().used_joints(robot).all()
    with pytest.raises(OptionError, match=r"robot 'random3' has no moving joint 'elbow'; it has: joint1, "):
        Settings(joints=("elbow",)).used_joints(robot)
    with pytest.raises(OptionError, match=r"robot 'random3' has no moving link 'base'; it has: "):
        Settings(trust=("base",)).held_bodies(robot)


def test_a_trusted_link_that_is_fixed_to_a_body_stands_for_the_body(robot: RobotModel) -> None:
    fixed = [(body, link.name) for body, links in robot.folded.items() for link in links[1:]]
    assert fixed
    for body, name in fixed:
        assert Settings(trust=(name, body)).held_bodies(robot) == (body,)
