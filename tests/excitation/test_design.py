"""Designed motions: their condition numbers by another regressor, their limits on a fine grid by another dynamics."""

from __future__ import annotations

import math
import re
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from excitation.arms import arm_urdf, pinocchio_origins, pinocchio_regressor, pinocchio_torque

import torchrbd
from torchrbd.excitation import Basis, Excitation, FourierMotion
from torchrbd.excitation.conditioning import Conditioning
from torchrbd.excitation.limits import limits_of
from torchrbd.parameters import base_parameters

URDF = arm_urdf()
BOX = {"z": (0.1, math.inf)}


@pytest.fixture(scope="module")
def result() -> Excitation:
    return torchrbd.excite(URDF, box=BOX, periods=2, starts=1, margin=0.15)


def test_every_limit_is_kept_between_the_samples(result: Excitation) -> None:
    """On a grid twenty times finer than what was looked at, by Pinocchio's dynamics and kinematics."""
    t = torch.linspace(0.0, result.duration_s, 40_000, dtype=torch.float64)
    q, qd, qdd = (x.numpy() for x in result.motion.states(t))
    robot = result.robot
    middle, half = (0.5 * (robot.upper + s * robot.lower).numpy() for s in (1, -1))
    used = np.abs(q - middle) / half, np.abs(qd) / robot.velocity.numpy()
    used = (*used, np.abs(pinocchio_torque(URDF, q[::10], qd[::10], qdd[::10])) / robot.effort.numpy())
    for one in used:
        assert one.max() < 0.85
    assert pinocchio_origins(URDF, q[::10], ("link3", "tool"))[..., 2].min() > 0.1
    # Something is used up: nothing else stops the motion.
    assert max(one.max() for one in used) > 0.84
    for k, use in enumerate(result.uses):
        assert use.range_used == pytest.approx(used[0][:, k].max(), abs=1e-3)
        assert use.speed_used == pytest.approx(used[1][:, k].max(), abs=1e-3)
        assert use.torque_used == pytest.approx(used[2][:, k].max(), abs=1e-2)
        assert (use.low, use.high) == pytest.approx((q[:, k].min(), q[:, k].max()), abs=1e-3)
    assert result.clearance == pytest.approx(
        pinocchio_origins(URDF, q[::10], ("tool", "link3"))[..., 2].min() - 0.1, abs=1e-3
    )


def test_samples_begin_and_end_at_rest(result: Excitation) -> None:
    t, q, qd, qdd = result.states(50.0)
    assert (len(t), float(t[-1])) == (1001, 20.0)
    assert qd[[0, 500, 1000]].abs().max() < 1e-12
    assert qdd[[0, 500, 1000]].abs().max() < 1e-11
    torch.testing.assert_close(q[0], q[1000], rtol=0, atol=1e-11)
    torch.testing.assert_close(torch.gradient(q, spacing=0.02, dim=0)[0][1:-1], qd[1:-1], rtol=0, atol=5e-3)


def test_the_last_sample_is_at_rest_whatever_the_rate(result: Excitation) -> None:
    t, q, qd, _ = result.states(7.77)
    assert len(t) == 157
    assert qd[-1].abs().max() < 1e-12
    torch.testing.assert_close(q[-1], q[0], rtol=0, atol=1e-11)


def test_condition_numbers_are_those_of_pinocchio_s_regressor(result: Excitation) -> None:
    t = torch.linspace(0.0, 10.0, 4001, dtype=torch.float64)[:-1]
    q, qd, qdd = (x.numpy() for x in result.motion.states(t))
    names = [
        f"{p}_link{k}" for k in (1, 2, 3) for p in ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    ]
    base = base_parameters(result.robot)
    at = [names.index(result.robot.parameter_names[k]) for k in base.independent]
    W = pinocchio_regressor(URDF, q, qd, qdd)[:, :, at].reshape(-1, len(at))
    s = np.linalg.svd(W, compute_uv=False)
    assert np.linalg.matrix_rank(pinocchio_regressor(URDF, q, qd, qdd).reshape(-1, 30), tol=1e-8 * s[0]) == len(at)
    scaled = np.linalg.svd(W / np.sqrt(np.mean(W**2, 0)), compute_uv=False)
    assert result.condition.base_parameters == len(at)
    assert result.condition.unscaled == pytest.approx(s[0] / s[-1], rel=1e-3)
    assert result.condition.scaled == pytest.approx(scaled[0] / scaled[-1], rel=1e-3)
    assert result.condition.with_friction > result.condition.scaled


def test_it_conditions_better_than_random_motions_within_the_same_limits(result: Excitation) -> None:
    limits = limits_of(result.robot, box=BOX, margin=0.15)
    conditioning = Conditioning(result.robot, limits)
    t = torch.linspace(0.0, 10.0, 201, dtype=torch.float64)[:-1]
    generator, costs = torch.Generator().manual_seed(0), []
    for _ in range(200):
        one = FourierMotion(Basis(10.0, 5), torch.randn(3, 9, generator=generator, dtype=torch.float64))
        one = one.shrunk(float((limits.fastest / one.states(t)[1].abs().amax(0)).min()))
        costs.append(float(conditioning.objective(*one.states(t))))
    assert float(conditioning.objective(*result.motion.states(t))) < min(costs)


def test_the_criterion_bounds_the_condition_numbers_and_its_slopes_are_right() -> None:
    robot = torchrbd.RobotModel.from_urdf(URDF)
    conditioning = Conditioning(robot, limits_of(robot))
    generator = torch.Generator().manual_seed(1)
    q, qd, qdd = (torch.randn(30, 3, generator=generator, dtype=torch.float64) for _ in range(3))
    found = conditioning.numbers(q, qd, qdd)
    W = conditioning.columns(q, qd, qdd).flatten(0, 1).numpy()
    larger = 0.2 * 0.5 * np.log(np.mean(W**2, 0)).mean()
    mean = 0.5 * math.log(found.with_friction * found.unscaled)
    assert mean < float(conditioning.objective(q, qd, qdd)) + larger < mean + math.log(21) / 6.0
    inputs = [x.requires_grad_() for x in (q, qd, qdd)]
    assert torch.autograd.gradcheck(conditioning.objective, inputs, eps=1e-6, atol=1e-6, rtol=1e-4)


def test_a_seed_makes_the_same_motion_again_and_another_seed_another() -> None:
    one, again, other = (torchrbd.excite(URDF, harmonics=2, starts=1, seed=seed).motion.free for seed in (3, 3, 4))
    assert torch.equal(one, again)
    assert not torch.allclose(one, other, atol=1e-3)


def test_speed_slows_a_motion_down() -> None:
    slow = torchrbd.excite(URDF, harmonics=3, starts=1, speed=0.25, margin=0.0)
    t = torch.linspace(0.0, 10.0, 5000, dtype=torch.float64)
    assert (slow.motion.states(t)[1].abs().amax(0) <= 0.25 * slow.robot.velocity).all()


def test_joints_that_stand_still_leave_what_the_others_tell() -> None:
    result = torchrbd.excite(URDF, joints=["joint2", "joint3"], ranges={"joint1": (0.5, 0.6)}, starts=1)
    t, q, qd, qdd = result.states()
    assert torch.equal(q[:, 0], torch.full_like(t, 0.5))
    assert not qd[:, 0].any()
    Y = pinocchio_regressor(URDF, q.numpy(), qd.numpy(), qdd.numpy())[:, 1:].reshape(-1, 30)
    assert np.linalg.matrix_rank(Y, tol=1e-8 * np.linalg.norm(Y, 2)) == result.condition.base_parameters


def test_a_box_that_no_posture_keeps_is_told_at_once() -> None:
    words = r"cannot even rest within its limits: of 512 postures the best breaks the box at z = 1.5 m, by \d+% of it"
    with pytest.raises(torchrbd.OptionError, match=words):
        torchrbd.excite(URDF, box={"z": (1.5, math.inf)}, starts=1)


def test_an_arm_too_weak_for_its_own_weight_is_told() -> None:
    with pytest.raises(torchrbd.OptionError, match="the best breaks the torque of joint2"):
        torchrbd.excite(URDF, efforts={"joint2": 1.0}, ranges={"joint2": (1.2, 1.4), "joint3": (0.0, 0.5)}, starts=1)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"frequency_hz": 0.0}, "frequency is 0 Hz; expected a positive number"),
        ({"frequency_hz": math.inf}, "frequency is inf Hz"),
        ({"harmonics": 1}, "harmonics is 1; expected at least 2"),
        ({"periods": 0}, "periods is 0; expected at least 1"),
        ({"starts": 0}, "starts is 0; expected at least 1"),
        ({"gravity": [0.0, 1.0]}, "gravity is [0.0, 1.0]; expected three numbers"),
    ],
)
def test_options_that_cannot_be_used_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(torchrbd.OptionError, match=re.escape(words)):
        torchrbd.excite(URDF, **options)


def test_gravity_is_told_once() -> None:
    with pytest.raises(torchrbd.OptionError, match="gravity is known from the robot"):
        torchrbd.excite(torchrbd.RobotModel.from_urdf(URDF), gravity=(0.0, 0.0, -9.81))


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "scaled", "unscaled"), [(1.0, 8.0, 20.0), (0.5, 10.0, 45.0)])
def test_seven_joints_are_conditioned_below_sixty(speed: float, scaled: float, unscaled: float) -> None:
    package = metadata.distribution("example-robot-data")
    folder = Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots")))
    fingers = {"panda_finger_joint1": (0.0, 0.0)}
    result = torchrbd.excite(folder / "panda_description/urdf/panda.urdf", ranges=fingers, speed=speed)
    assert result.condition.scaled < scaled
    assert result.condition.unscaled < unscaled
