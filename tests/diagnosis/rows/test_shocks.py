"""Shocks are seen where they are, spoil a fit, and are left out and told where they do."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from robot.random_robots import random_urdf
from simulated import inverse_dynamics, joint_names, multisine
from vision_head.motion import Motion

import torchrbd
from torchrbd.diagnosis.locate import shocks
from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.rows.shocks import MISFIT, calmed, left_elsewhere, misfit_ratio, without_shocks
from torchrbd.diagnosis.rows.weighing import weighed
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.shapes.refine import fit_with_shapes, refined_from
from torchrbd.inference.shapes.reread import reread
from torchrbd.likelihood.columns import Candidate
from torchrbd.likelihood.shocks import shock
from torchrbd.physics import Site, effect
from torchrbd.physics.registry import PLAIN
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

URDF, JOINT = random_urdf(5, 3, kinds=("revolute",), branching=0.0, massless=0.0), 1
PLAY, CROSSING_S, DT = 0.04, 0.03, 0.005


def recorded(play: float, seed: int = 3) -> Recording:
    """Record a robot whose motor at one joint crosses the play of its gear at once as the load changes its sign."""
    motion = multisine(3, seed, duration_s=30.0, rate_hz=1 / DT, fastest_hz=0.5)
    tau = inverse_dynamics(URDF, motion)
    sides, width = np.sign(tau[:, JOINT]), round(CROSSING_S / DT)
    smooth = np.hanning(2 * width + 3)[1:-1]
    ahead = np.convolve(np.pad(sides, width, mode="edge"), smooth / smooth.sum(), mode="valid")
    rng = np.random.default_rng(seed)
    q = motion.q + 1e-5 * rng.standard_normal(motion.q.shape)
    q[:, JOINT] += 0.5 * play * ahead
    tau = tau + 0.02 * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape)
    return Recording.from_arrays("play", joint_names(URDF), motion.t, q, tau)


def bursts(gain: float, seed: int = 3) -> Recording:
    """Record a robot that shakes for a moment now and then, with a wrong torque constant at one joint."""
    motion = multisine(3, seed, duration_s=30.0, rate_hz=1 / DT, fastest_hz=0.5)
    phase = motion.t % 2.0 / 0.25
    pulse = np.outer(np.where(phase < 1.0, 0.05 * np.sin(np.pi * phase) ** 4, 0.0), (1.0, -0.7, 0.5))
    speed = np.gradient(pulse, DT, axis=0)
    motion = Motion(motion.t, motion.q + pulse, motion.qd + speed, motion.qdd + np.gradient(speed, DT, axis=0))
    tau = inverse_dynamics(URDF, motion)
    tau[:, JOINT] *= gain
    rng = np.random.default_rng(seed)
    q = motion.q + 1e-5 * rng.standard_normal(motion.q.shape)
    tau = tau + 0.02 * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape)
    return Recording.from_arrays("bursts", joint_names(URDF), motion.t, q, tau)


def begun(recording: Recording, *more: str) -> Fit:
    """Return the fit of a rigid body with friction at every joint, and more effects at one."""
    prepared = prepare(RobotModel.from_urdf(URDF), [recording], Settings.from_mapping({"cutoff_hz": 10.0}, "test"), ())
    samples = read_samples(prepared, prepared.fit().pi)
    terms = [samples.columns.candidate(effect(name), Site(j), {}) for j in range(3) for name in PLAIN]
    terms += [samples.columns.candidate(effect(name), Site(JOINT), {}) for name in more]
    return weighed(fitted(samples, prepared.prior, terms))


def error(fit: Fit) -> np.ndarray:
    """Return how far the torque of what was fitted is from the true one, (n,), in parts of its RMS."""
    samples = fit.rows.samples
    true, of = samples.rigid @ samples.columns.robot.pi.numpy(), samples.rigid @ fit.pi.numpy()
    return np.sqrt(np.mean((of - true) ** 2, axis=1) / np.mean(true**2, axis=1))


def test_a_pulse_is_a_shock_and_a_step_is_none() -> None:
    t = DT * torch.arange(2000, dtype=torch.float64)
    course = 3.0 * torch.sin(2 * np.pi * 0.4 * t)
    pulse = torch.where((t - 4.0).abs() < 0.011, 20.0, 0.0)
    step = torch.where(t > 7.0, 20.0, 0.0)
    found = shock(torch.stack((course, course + pulse, course + step)), DT)
    near = (t - 4.0).abs() < 0.1
    assert found[1, near].min() == pytest.approx(20.0, rel=0.1)
    usual = found[0].max()
    assert usual < 1.0
    for k, elsewhere in ((1, (t - 4.0).abs() > 0.5), (2, t > 0)):
        assert found[k, elsewhere].max() < 1.5 * usual


def test_shocks_spoil_the_fit_and_are_left_out() -> None:
    start = begun(recorded(PLAY))
    calm, samples = without_shocks(start), start.rows.samples
    counted = calm.rows.samples.weight.any(0)
    crossings = (np.diff(np.sign(samples.rigid @ samples.columns.robot.pi.numpy())[JOINT]) != 0).sum()
    assert crossings > 10
    assert 0.5 < counted.mean() < 0.95
    assert (error(calm) < 0.2 * error(start)).any()
    assert error(calm).max() < 0.1


def test_what_does_not_spoil_stays() -> None:
    start = begun(recorded(0.0))
    assert without_shocks(start) is start


def test_a_model_that_is_right_errs_at_shocks_as_elsewhere() -> None:
    start = begun(recorded(0.0))
    samples = start.rows.samples
    calm = samples.without_shocks(torch.from_numpy(2.0 * np.median(samples.shocks, axis=1)))
    assert 0.05 < (calm.weight == 0).mean() < 0.95
    right = fitted(calm, start.rows.prior, start.terms)
    assert misfit_ratio(right).max() < MISFIT
    assert shocks(right, "extended") == ()


def test_shocks_stay_where_what_was_found_explains_them() -> None:
    """A wrong gain at one joint, and bursts: errors are largest there, as torques are, until the gain is known."""
    start = begun(bursts(gain=0.7))
    assert left_elsewhere(start, calmed(start)) < 0.5
    fit = begun(bursts(gain=0.7), "torque_scale")
    assert without_shocks(fit) is fit


@pytest.mark.slow
def test_shocks_without_a_name_are_left_where_they_are() -> None:
    result = torchrbd.diagnose(URDF, recorded(PLAY), exclude=["backlash"], cutoff_hz=10.0)
    joint = joint_names(URDF)[JOINT]
    assert result.verdict in ("unexplained", "missing_physics")
    assert joint in {j for x in (*result.unexplained, *result.locations) for j in x.joints}
    assert max((f.probability for f in result.findings), default=0.0) < 0.9


@pytest.mark.slow
@pytest.mark.parametrize("play", [0.01, PLAY])
def test_play_is_named(play: float) -> None:
    result = torchrbd.diagnose(URDF, recorded(play), cutoff_hz=10.0)
    (found,) = result.findings
    assert (found.effect, found.joints) == ("backlash", (joint_names(URDF)[JOINT],))
    assert found.parameters["backlash"].value == pytest.approx(play, rel=0.2)
    assert result.unexplained == ()


def read_with(play: float, flight: float) -> tuple[Prepared, Candidate]:
    """Read a recording without shocks, with the columns of a play."""
    settings = Settings.from_mapping({"cutoff_hz": 10.0}, "test")
    prepared = prepare(RobotModel.from_urdf(URDF), [recorded(play)], settings, ())
    samples = read_samples(prepared, prepared.fit().pi)
    columns = samples.without_shocks(torch.from_numpy(2.0 * np.median(samples.shocks, axis=1))).columns
    term = columns.candidate(effect("backlash"), Site(JOINT), {"flight": flight, "link_friction": 1.0})
    return reread(prepared, columns.of_candidates((term,), columns.robot.pi), lambda *_: None), term


def test_a_flight_that_is_over_at_once_stays_so_without_shocks() -> None:
    """The motor crosses this play, not the link."""
    prepared, term = read_with(PLAY, 0.001)
    prepared, (term,) = refined_from(prepared, (term,), lambda *_: None)
    (width,), _ = fit_with_shapes(prepared, (term,)).coefficients(term)
    assert float(width) == pytest.approx(PLAY, rel=0.1)
    assert term.shape["flight"] < 0.1 * PLAY


def test_a_flight_that_nothing_tells_is_as_wide_as_the_play_without_shocks() -> None:
    prepared, term = read_with(0.0, 0.01)
    prepared, (term,) = refined_from(prepared, (term,), lambda *_: None)
    (width,), _ = fit_with_shapes(prepared, (term,)).coefficients(term)
    assert term.shape["flight"] == pytest.approx(max(2e-4, float(width)), rel=0.1)
