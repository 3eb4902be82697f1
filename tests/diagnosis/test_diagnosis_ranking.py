"""A diagnosis says what was considered, whatever the recordings lack, and never fails for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
from robot.random_robots import random_urdf
from simulated import Motion, inverse_dynamics, joint_names, multisine

import torchrbd
from torchrbd.diagnosis.ranked import Ranking
from torchrbd.diagnosis.ranking import run_search
from torchrbd.errors import RecordingError
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

pytestmark = pytest.mark.usefixtures("fit_alone")

EFFECTS = ("viscous_friction", "coulomb_friction", "joint_spring", "rotor_inertia", "payload")
ARM = random_urdf(5, 2, kinds=("revolute",), branching=0.0, massless=0.0)
MIXED = random_urdf(3, 3)
Torque = Callable[[Motion], np.ndarray]


def rubbing(motion: Motion) -> np.ndarray:
    return 0.3 * np.sign(motion.qd) + 0.2 * motion.qd


def recorded(
    urdf: str, seed: int, name: str = "a", extra: Torque = rubbing, *, seconds: float = 10.0, rate_hz: float = 125.0,
    noise: float = 0.02, kept: slice | Sequence[int] = slice(None), unmeasured: int | None = None,
) -> Recording:  # fmt: skip
    """Record an arm with friction; of some samples only, or without the torque of a joint."""
    names = joint_names(urdf)
    motion = multisine(len(names), seed, duration_s=seconds, rate_hz=rate_hz)
    tau, rng = inverse_dynamics(urdf, motion) + extra(motion), np.random.default_rng(seed)
    tau = tau + noise * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape)
    q = motion.q + 1e-5 * rng.standard_normal(tau.shape)
    if unmeasured is not None:
        tau[:, unmeasured] = np.nan
    return Recording.from_arrays(name, names, motion.t[kept], q[kept], tau[kept])


def springy(motion: Motion) -> np.ndarray:
    tau = rubbing(motion)
    tau[:, 1] += 1.5 * motion.q[:, 1]
    return tau


def prepared(urdf: str, recordings: Sequence[Recording], **options: Any) -> tuple[Prepared, Settings]:
    settings = Settings.from_mapping({"effects": EFFECTS, **options}, "test")
    return prepare(RobotModel.from_urdf(urdf), recordings, settings, ()), settings


def ranked(urdf: str, recordings: Sequence[Recording], **options: Any) -> Ranking:
    found, settings = prepared(urdf, recordings, **options)
    return run_search(found.reading, settings, found.kept_back, lambda *_: None).ranking


def test_a_diagnosis_has_a_ranking_of_what_is_not_held_out() -> None:
    fit, hold = recorded(ARM, 1, "fit", springy), recorded(ARM, 2, "hold", springy)
    names = ("viscous_friction", "coulomb_friction", "joint_spring")
    found = torchrbd.diagnose(ARM.encode(), fit, holdout=[hold], effects=names).ranking
    assert found is not None
    best = found.first[0]
    assert (best.effect, best.joints) == ("joint_spring", ("joint2",))
    assert best.parameters["stiffness"] == pytest.approx(1.5, rel=0.1)
    assert [one.effect for one in found.adopted] == ["joint_spring"]
    assert list(found.delay_s) == ["fit"]
    assert found.considered == 2
    assert {one.joints for one in found.ordinary} == {("joint1",), ("joint2",)}


def test_recordings_that_are_too_short_are_refused_with_what_they_need() -> None:
    """The filters of a wide band are longer where the clock is slow."""
    short = [recorded(ARM, k, str(k), seconds=3.2, rate_hz=20.0) for k in range(8)]
    with pytest.raises(RecordingError, match=r"filters at 2\.4 Hz need"):
        torchrbd.diagnose(ARM.encode(), short, effects=["viscous_friction", "coulomb_friction"])


def test_a_likelihood_without_solution_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any) -> None:
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    monkeypatch.setattr(import_module("torchrbd.diagnosis.ranking"), "search_effects", fails)
    with pytest.raises(RecordingError, match=r"have no regression .Matrix is not positive definite.; look for"):
        torchrbd.diagnose(ARM.encode(), recorded(ARM, 1))


@pytest.mark.parametrize(
    ("urdf", "recordings", "options"),
    [
        (ARM, [recorded(ARM, 1, kept=[*range(500), *range(620, 1100), *range(1130, 1250)])], {}),
        (ARM, [recorded(ARM, 1, "a", unmeasured=0), recorded(ARM, 2, "b", rate_hz=100.0)], {}),
        (ARM, [recorded(ARM, 1)], {"joints": ["joint2"]}),
        (ARM, [recorded(ARM, 1)], {"simulated": [recorded(ARM, 1, "s", noise=0.0)]}),
        (MIXED, [recorded(MIXED, 1)], {"payload": ["a=0.5,0,0,0.1"], "trust": ["link1"]}),
        (MIXED, [recorded(MIXED, 1)], {"effects": ["viscous_friction"]}),
        (random_urdf(8, 1, kinds=("prismatic",)), None, {}),
    ],
    ids=["gaps", "torque in one of two", "one joint counts", "simulated", "prismatic", "no effects", "one joint"],
)
def test_recordings_may_lack_this_and_that(
    urdf: str, recordings: list[Recording] | None, options: dict[str, Any]
) -> None:
    recordings = recordings or [recorded(urdf, 1)]
    found = ranked(urdf, recordings, **options)
    assert np.isfinite([one.log_evidence for one in (*found.first, *found.last, *found.ordinary)]).all()
    assert found.considered == len(found.first)
    assert list(found.delay_s) == [r.name for r in recordings]
    seen = options.get("joints") or joint_names(urdf)
    assert {j for one in found.ordinary for j in one.joints} == set(seen)


def test_a_joint_without_torque_has_no_friction_to_speak_of() -> None:
    found = ranked(ARM, [recorded(ARM, 1, unmeasured=0)])
    assert {one.joints for one in found.ordinary} == {("joint2",)}
    assert not any("joint1" in one.joints for one in found.first)


def test_held_out_time_is_kept_from_other_filters_too() -> None:
    """Their outputs lie between blocks, and before the first of a recording."""
    found, _ = prepared(ARM, [recorded(ARM, 1, "fit")], holdout=[recorded(ARM, 2, "hold")])
    t = torch.arange(0.0, 10.0, 0.003, dtype=torch.float64)
    assert found.kept_back("hold", t).all()
    assert not found.kept_back("fit", t).any()
    assert not found.kept_back("unknown", t).any()
    found, _ = prepared(ARM, [recorded(ARM, 1, "fit")])
    kept, held = (
        found.kept_back("fit", t),
        [b for b, h in zip(found.statistics.blocks, found.held_out, strict=True) if h],
    )
    inside = sum(((t >= b.start_s) & (t <= b.end_s) for b in held), torch.zeros(len(t), dtype=torch.bool))
    assert kept[inside].all()
    neighbours = [(a, b) for a, b in pairwise(held) if b.start_s - a.end_s < 0.5]
    assert neighbours
    assert all(kept[(t >= a.start_s) & (t <= b.end_s)].all() for a, b in neighbours)
    assert float(kept.double().mean()) < 0.5
