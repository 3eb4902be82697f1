"""The recordings that identification is judged by are what they claim to be."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import noisy_robots
import numpy as np
import pinocchio as pin
import pytest
from noisy_robots import (
    development_robots,
    final_robots,
    noisy_recording,
    perturbed,
    torque_nmse,
    true_parameters,
    urdf_text,
)
from simulated import Motion, inverse_dynamics

from torchrbd.robot import RobotModel

ARM = development_robots(1)["random0"]
SHORT = {"duration_s": 3.0}


def recorded(urdf: str, seed: int, **options) -> tuple[np.ndarray, np.ndarray, noisy_robots.Truth]:
    """Return measured q, tau and the truth."""
    recording, truth = noisy_recording(urdf, seed, **options)
    (chunk,) = recording.chunks(10**7)
    np.testing.assert_allclose(chunk.t, truth.t, atol=1e-12)
    return chunk.q, chunk.tau, truth


@pytest.mark.parametrize("name", ["random0", "random1", "random2", "panda", "xarm7", "baxter"])
def test_arms_are_seven_joint_robots_that_all_readers_see_alike(name: str) -> None:
    urdf = {**development_robots(), **final_robots()}[name]
    robot, model = RobotModel.from_urdf(urdf), pin.buildModelFromXML(urdf)
    assert model.nq == model.nv == 7
    assert list(robot.joint_names) == list(model.names)[1:]
    np.testing.assert_allclose(robot.pi.numpy(), true_parameters(urdf), atol=1e-12)
    again = urdf_text(model)
    np.testing.assert_allclose(true_parameters(again), true_parameters(urdf), rtol=1e-12, atol=1e-15)


def test_locked_fingers_weigh_what_they_weighed() -> None:
    """The reduced Panda is the whole one whose fingers stand still."""
    folder = Path(str(metadata.distribution("example-robot-data").locate_file("cmeel.prefix")))
    whole = pin.buildModelFromUrdf(str(folder / "share/example-robot-data/robots" / noisy_robots.FINAL["panda"][0]))
    arm = pin.buildModelFromXML(final_robots()["panda"])
    q, qd, qdd = np.random.default_rng(0).uniform(-1, 1, (3, 7))
    still = np.zeros(2)
    expected = pin.rnea(whole, whole.createData(), *(np.concatenate([x, still]) for x in (q, qd, qdd)))[:7]
    np.testing.assert_allclose(pin.rnea(arm, arm.createData(), q, qd, qdd), expected, atol=1e-10)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size", [0.25, 1.0])
def test_perturbed_bodies_are_physical_and_joints_stay(seed: int, size: float) -> None:
    true, given = (pin.buildModelFromXML(u) for u in (ARM, perturbed(ARM, seed, size)))
    for body in list(given.inertias)[1:]:
        assert np.linalg.eigvalsh(body.toPseudoInertia().toMatrix()).min() > 0
    ratio = np.array([given.inertias[k].mass / true.inertias[k].mass for k in range(1, 8)])
    assert 0.2 * size < np.log(ratio).std() < 3 * size
    np.testing.assert_allclose(true_parameters(perturbed(ARM, seed, 0.0)), true_parameters(ARM), atol=1e-12)
    q = np.random.default_rng(seed).uniform(-2, 2, 7)
    np.testing.assert_allclose(
        pin.computeJointJacobians(given, given.createData(), q),
        pin.computeJointJacobians(true, true.createData(), q),
        atol=1e-12,
    )


@pytest.mark.parametrize("loop", ["open", "closed"])
def test_truth_is_consistent(loop: str) -> None:
    """Torque is that of the states, states are derivatives of each other, and joints keep to their limits."""
    truth = recorded(ARM, 3, loop=loop, encoder_noise=0.0, **SHORT)[2]
    np.testing.assert_allclose(
        truth.tau, inverse_dynamics(ARM, Motion(truth.t, truth.q, truth.qd, truth.qdd)), atol=1e-9
    )
    step = truth.t[1]
    middle = (truth.q[2:] - truth.q[:-2]) / (2 * step)
    np.testing.assert_allclose(middle, truth.qd[1:-1], atol=5e-4)
    middle = (truth.qd[2:] - truth.qd[:-2]) / (2 * step)
    # The first step is bent: there the controller starts.
    np.testing.assert_allclose(middle[1:], truth.qdd[2:-1], atol=2e-2)
    assert (np.abs(truth.q) < 2.5).all()
    assert (np.abs(truth.qd) < 2.5).all()
    assert (truth.q_ref is None) == (loop == "open")


def test_work_is_energy_in_closed_loop() -> None:
    """Integral of tau'qd = change of kinetic and potential energy."""
    truth = recorded(ARM, 3, loop="closed", rate_hz=2000.0, **SHORT)[2]
    model = pin.buildModelFromXML(ARM)
    data = model.createData()
    energy = [
        pin.computeKineticEnergy(model, data, q, qd) + pin.computePotentialEnergy(model, data, q)
        for q, qd in ((truth.q[k], truth.qd[k]) for k in (0, -1))
    ]
    work = np.trapezoid((truth.tau * truth.qd).sum(1), truth.t)
    assert work == pytest.approx(energy[1] - energy[0], abs=1e-3 * np.ptp(truth.tau * truth.qd))


def test_integration_has_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    coarse = recorded(ARM, 5, loop="closed", **SHORT)[2]
    monkeypatch.setattr(noisy_robots, "_STEPS", 8)
    fine = recorded(ARM, 5, loop="closed", **SHORT)[2]
    np.testing.assert_allclose(coarse.q, fine.q, atol=1e-6)
    np.testing.assert_allclose(coarse.qd, fine.qd, atol=1e-5)


def test_encoder_noise_moves_the_robot_in_closed_loop_only() -> None:
    for loop, moved in (("open", 0.0), ("closed", 1e-3)):
        noisy_q, _, noisy = recorded(ARM, 1, loop=loop, encoder_noise=1e-3, **SHORT)
        clean = recorded(ARM, 1, loop=loop, encoder_noise=0.0, **SHORT)[2]
        assert np.std(noisy_q - noisy.q) == pytest.approx(1e-3, rel=0.05)
        assert np.std(noisy.q - clean.q) == pytest.approx(moved, rel=0.9)
    assert clean.q_ref is not None
    assert np.std(clean.q - clean.q_ref) < 2e-2


def test_robot_answers_to_the_samples_that_are_recorded() -> None:
    """A sample that reads too high makes the controller pull back; an open loop knows nothing of it."""
    found = {}
    for loop in ("open", "closed"):
        q, _, truth = recorded(ARM, 2, loop=loop, **SHORT)
        change = np.diff(truth.qdd, axis=0)
        found[loop] = np.corrcoef((q - truth.q)[:-1].ravel(), change.ravel())[0, 1]
    assert found["closed"] < -0.5
    assert abs(found["open"]) < 0.1


@pytest.mark.parametrize(("colour", "lag_s", "expected"), [(0.0, 0.002, 0.0), (0.05, 0.05, np.exp(-1.0))])
def test_torque_noise_has_the_size_and_memory_asked_for(colour: float, lag_s: float, expected: float) -> None:
    _, measured, truth = recorded(ARM, 0, duration_s=120.0, torque_noise=0.1, torque_colour_s=colour)
    noise = (measured - truth.tau) / (0.1 * np.sqrt(np.mean(truth.tau**2, 0)))
    lag = round(lag_s * 500)
    assert np.mean(noise**2) == pytest.approx(1.0, rel=0.05)
    assert np.mean(noise[lag:] * noise[:-lag]) == pytest.approx(expected, abs=0.05)
    assert np.mean(noise[:25] ** 2) == pytest.approx(1.0, abs=0.8)


def test_same_seed_same_recording_and_noise_levels_share_the_motion() -> None:
    first, again, other, quiet = (
        recorded(ARM, seed, encoder_noise=noise, **SHORT)
        for seed, noise in ((1, 1e-3), (1, 1e-3), (2, 1e-3), (1, 1e-4))
    )
    np.testing.assert_array_equal(first[0], again[0])
    np.testing.assert_array_equal(first[1], again[1])
    np.testing.assert_array_equal(first[2].q, quiet[2].q)
    assert np.abs(first[2].q - other[2].q).max() > 0.1


def test_judge_agrees_with_inverse_dynamics_of_the_other_robot() -> None:
    given = perturbed(ARM, 4)
    model = pin.buildModelFromXML(ARM)
    motion = noisy_robots._motion(model, np.random.default_rng([6, 99]), 40.0, 50.0, 1.5)
    tau, told = (inverse_dynamics(u, motion) for u in (ARM, given))
    expected = np.mean([np.mean((told[:, j] - tau[:, j]) ** 2) / np.var(tau[:, j]) for j in range(7)])
    assert torque_nmse(ARM, true_parameters(given), 6) == pytest.approx(expected, rel=1e-9)
    assert torque_nmse(ARM, true_parameters(ARM), 6) < 1e-20


def test_unknown_loop_is_refused() -> None:
    with pytest.raises(ValueError, match="expected 'open' or 'closed'"):
        noisy_recording(ARM, 0, loop="half")
