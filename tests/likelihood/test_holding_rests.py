"""Check what is learnt of joints that rest: what friction holds there, when it turns, and how large it may be."""

from __future__ import annotations

import numpy as np
import pytest
from likelihood.arms import recorded, rows_of, wrong_robot
from likelihood.fits import COULOMB, OPTIONS, URDF, VISCOUS, WIDTH, at_joint, carried, with_friction
from simulated import Motion, inverse_dynamics, multisine

from torchrbd.diagnosis.hypotheses import average_over_shapes
from torchrbd.effects import Site
from torchrbd.effects.registry import effect
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

RATE_HZ, EVERY = 1000.0, 10


def paused(duration_s: float, samples: int, every: int = 1) -> tuple[Motion, np.ndarray, np.ndarray]:
    """Return a motion whose first joint stops for so many samples at every so many of its reversals.

    Returns:
        The motion, the sample (N,) of the one without stops that it is at, and where the joint stops, (N,) bool.
    """
    moved = multisine(2, 5, duration_s=duration_s, rate_hz=RATE_HZ)
    turns, n = np.flatnonzero(np.diff(np.sign(moved.qd[:, 0])))[::every], len(moved.t)
    at = np.repeat(np.arange(n), 1 + samples * np.isin(np.arange(n), turns))[:n]
    rests = np.diff(at, append=at[-1] + 1) == 0
    q, qd, qdd = moved.q.copy(), moved.qd.copy(), moved.qdd.copy()
    q[:, 0], qd[:, 0], qdd[:, 0] = moved.q[at, 0], ~rests * moved.qd[at, 0], ~rests * moved.qdd[at, 0]
    return Motion(moved.t, q, qd, qdd), at, rests


def learnt(motion: Motion, friction: np.ndarray, noise: float, encoder: float) -> Likelihood:
    """Return what is learnt of torques with friction (N, 2) and noise, a part of them, and positions with noise."""
    rng = np.random.default_rng(6)
    tau = inverse_dynamics(URDF, motion) + friction
    tau += noise * np.sqrt(np.mean(tau**2, axis=0)) * rng.standard_normal(tau.shape)
    q, names = motion.q + encoder * rng.standard_normal(motion.q.shape), RobotModel.from_urdf(URDF).joint_names
    recording = Recording.from_arrays("pauses", names, motion.t[::EVERY], q[::EVERY], tau[::EVERY])
    return learn(Machine(rows_of(wrong_robot(URDF, 1), [recording])))


@pytest.fixture(scope="module")
def sticking() -> Likelihood:
    """Learn of an arm whose first joint stops at each reversal, its drive pushing it from one side to the other."""
    motion, at, rests = paused(22.0, 70)
    number, way = np.arange(len(at)), np.sign(multisine(2, 5, duration_s=22.0, rate_hz=RATE_HZ).qd[at, 0])
    side = np.interp(number, number[~rests], way[~rests])
    dry = COULOMB * np.stack((side, np.tanh(motion.qd[:, 1] / WIDTH)), axis=1)
    return learnt(motion, VISCOUS * motion.qd + dry, 0.02, 3e-4)


def test_friction_of_a_joint_that_sticks_passes_in_a_straight_line(sticking: Likelihood) -> None:
    machine = sticking.machine
    rests = machine.rests.rests.of[0].max(0) > 0.5
    assert np.std(sticking.residual(0)[rests]) < 0.3 * COULOMB[0]
    assert sticking.gaussian.against(machine.sticking.at(0)) > 5
    assert sticking.gaussian.against(machine.sticking.at(1)) < 3
    np.testing.assert_allclose(sticking.friction[0, 1:], COULOMB[0], rtol=0.1)


def test_joint_that_sticks_is_not_late(sticking: Likelihood) -> None:
    rows = carried(sticking)
    for name in ("actuator_lag", "stribeck_friction"):
        e, site = effect(name), Site(joint=0)
        shapes = e.shapes(rows.columns.scale(site))
        found = average_over_shapes(sticking, rows, [rows.columns.candidate(e, site, shape) for shape in shapes])
        assert found is not None
        assert found.log_evidence < 5


def test_long_rest_holds_in_more_ways_than_a_short_one(sticking: Likelihood) -> None:
    machine = sticking.machine
    lengths = (machine.rests.rests.of[0] > 0).sum(1)
    ways = np.array([(machine.rests.ways[0][:, rest > 0] != 0).any(1).sum() for rest in machine.rests.rests.of[0]])
    assert ways[lengths.argmax()] > ways[lengths.argmin()] >= 1
    sizes = np.abs(machine.rests.ways[0]).max(1)
    assert (np.diff(sizes) < 0.2).all()
    assert sizes[0] == pytest.approx(1.0, abs=0.2)


def test_law_that_takes_a_part_of_friction_leaves_what_rests_may_hold_as_large() -> None:
    """Smaller priors of so many columns would be evidence for the law."""
    more = with_friction(at_joint(0, lambda m: np.sign(m.qd[:, 0]) * np.abs(m.qd[:, 0]) ** 0.3))
    noisy = recorded(URDF, 2, more, **OPTIONS | {"encoder_noise": 5e-4})
    fit = learn(Machine(rows_of(wrong_robot(URDF, 1), [noisy])))
    machine, qd = fit.machine, fit.machine.rows.qd[:1]
    law = Extra(0, np.sign(qd) * np.abs(qd) ** 0.3, np.ones(1))
    beside = fit.extended((law,)).renoised().relinearised()
    assert beside.friction[0, 1] < 0.95 * fit.friction[0, 1]
    assert len(machine.rests.at(0)) > 5
    holding = [
        one.columns(0)[np.isin(one.own(0), machine.rests.at(0))] for one in (beside, fit.renoised().relinearised())
    ]
    np.testing.assert_allclose(*holding, rtol=1e-6)


def test_rests_may_hold_more_than_friction_takes_in_motion() -> None:
    """A joint that moves without friction, and is held when it pauses: what holds it is learnt of the pauses."""
    motion, at, rests = paused(20.0, 800, every=3)
    hold = 0.3
    held = hold * np.sign(np.random.default_rng(7).standard_normal(len(at)))[at] * rests
    fit = learnt(motion, VISCOUS * motion.qd + held[:, None] * [1.0, 0.0], 0.005, 0.0)
    assert fit.friction[0, 1:].max() < 0.1 * hold
    assert 0.5 * hold < fit.hyper.held[0] < 3.0 * hold
    assert fit.hyper.hold[1] < 0.1 * hold
    less = fit.with_(hold=0.1 * fit.hyper.hold)
    assert less.log_evidence < fit.log_evidence - 30
