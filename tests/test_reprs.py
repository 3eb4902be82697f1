"""Every public object says in a line or two what it is, at a prompt and in a notebook."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from inference.problems import urdf_of
from report import fabricated
from simulated import record

import torchrbd
from torchrbd.display import Remark, brief, few
from torchrbd.inference import Fit, Outcome
from torchrbd.inference.comparison import EstimatorRow
from torchrbd.inference.replay import Replay
from torchrbd.inference.results import NoiseRegime

JOINTS = tuple(f"a_long_name_of_joint_{k}" for k in range(12))
FRICTION = ["viscous_friction", "coulomb_friction"]


@cache
def robot() -> torchrbd.RobotModel:
    return torchrbd.RobotModel.from_urdf(urdf_of(3, 9))


def model() -> torchrbd.RigidBodyDynamics:
    return torchrbd.RigidBodyDynamics.from_urdf(urdf_of(3, 9), effects=FRICTION)


def diagnosis() -> torchrbd.Diagnosis:
    return fabricated.with_friction(fabricated.diagnosis(JOINTS))


def estimators() -> torchrbd.EstimatorComparison:
    fit = Fit(dict.fromkeys(JOINTS, 0.25), dict.fromkeys(JOINTS, 1.0))
    failed, fact = Remark("estimator failed", {"error": "no set-points"}), Remark("gravity", {"gravity": [0.0] * 90})
    rows = EstimatorRow("wls", fit, fit, True, 0.1, None), EstimatorRow("iv", None, None, None, 0.0, failed)
    regime = NoiseRegime("physical", "filtered", matters=False, excess=1.0)
    return torchrbd.EstimatorComparison(
        "arm", JOINTS, ("a.csv",), "b.csv", 5.0, 40, 90.0, regime, False, rows, (fact,), ()
    )


def simulated() -> torchrbd.SimulatedMotion:
    t, q = np.arange(100) / 100, np.zeros((100, 12))
    return torchrbd.SimulatedMotion(JOINTS, t, q, q, q, q + 0.1, JOINTS[:1], ())


MADE: dict[type, tuple[Callable[[], Any], str]] = {
    torchrbd.BaseRegression: (lambda: torchrbd.BaseRegression(robot()), "samples=0"),
    torchrbd.BayesianDynamics: (lambda: torchrbd.BayesianDynamics(model()), "random3"),
    torchrbd.Comparison: (lambda: torchrbd.Comparison("arm", JOINTS, "a", "b", ()), "before='a'"),
    torchrbd.Diagnosis: (diagnosis, "verdict='missing_physics'"),
    torchrbd.DynamicsRegressor: (lambda: torchrbd.DynamicsRegressor(robot()), "random3"),
    torchrbd.EstimatorComparison: (estimators, "mean_nmse=['wls: 0.25'], failed=['iv']"),
    torchrbd.Excitation: (lambda: torchrbd.excite(ARM, harmonics=2, starts=1), "robot='arm', duration_s=30"),
    torchrbd.Finding: (lambda: diagnosis().findings[0], "probability="),
    torchrbd.Identification: (lambda: diagnosis().identification, "verdict='identified'"),
    torchrbd.NaturalGradient: (lambda: torchrbd.NaturalGradient(model()), "lr=1"),
    torchrbd.Ranking: (lambda: fabricated.ranking(JOINTS), "considered="),
    torchrbd.Recording: (lambda: record(urdf_of(3, 3), 1, duration_s=3.0), "name='simulated'"),
    torchrbd.Replay: (lambda: Replay(dict.fromkeys(JOINTS, 0.25), {}, {}, 5.0, SERIES), "cutoff_hz=5"),
    torchrbd.ResidualDynamics: (lambda: torchrbd.ResidualDynamics(model()), "kind='free'"),
    torchrbd.RigidBodyDynamics: (model, "viscous_friction at"),
    torchrbd.RobotModel: (robot, "name='random3'"),
    torchrbd.Settings: (lambda: torchrbd.Settings(seed=3, joints=JOINTS), "seed=3"),
    torchrbd.SimulatedMotion: (simulated, "samples=100"),
    Outcome: (lambda: Outcome("a.csv", diagnosis().identification, None, 2.0), "name='a.csv'"),
    type(SERIES := fabricated.identification(JOINTS).series): (lambda: SERIES, "samples=1200"),
}


def test_every_public_class_is_here() -> None:
    public = {thing for thing in map(torchrbd.__getattr__, torchrbd.__all__) if inspect.isclass(thing)}
    assert {one for one in public if not issubclass(one, Exception)} <= MADE.keys()


@pytest.mark.parametrize("kind", MADE, ids=lambda kind: kind.__name__)
def test_what_it_shows_is_short_and_tells_something(kind: type) -> None:
    make, words = MADE[kind]
    shown = repr(make())
    assert shown.startswith(f"{kind.__name__}(")
    assert len(shown.splitlines()) <= 3
    assert len(shown) < 500
    assert words in shown


def test_parts_are_cut_where_they_are_long() -> None:
    assert few("abcdefg") == ["a", "b", "c", "d", "e", "2 more"]
    assert few("ab") == ["a", "b"]
    assert brief(torch, a=1 / 3, b="x" * 99, c=[0.1, "y"]) == f"module(a=0.3333, b='{'x' * 56}..., c=[0.1, 'y'])"


ARM = b"""<robot name="arm"><link name="base"/><joint name="elbow" type="revolute"><parent link="base"/>
<child link="arm"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="2"/></joint><link name="arm">
<inertial><origin xyz="0 0 .2"/><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
</link></robot>"""
