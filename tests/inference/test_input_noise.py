"""What position noise does to a fit is predicted as it comes true; uncertain states widen a fit without moving it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from inference.problems import columns_of, prior_of, random_moments, recorded
from noisy_robots import development_robots, noisy_recording, perturbed, true_parameters

import torchrbd
from torchrbd.errors import OptionError
from torchrbd.inference.physical.uncertain_states import UncertainStates
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.likelihood.equations import scaled_equations
from torchrbd.parameters import base_parameters, is_physical
from torchrbd.robot import RobotModel

pytestmark = pytest.mark.usefixtures("fit_alone")

URDF = development_robots(2)["random1"]


def prepared_with(noise: float, torque_noise: float = 0.03, **settings: object) -> Prepared:
    recording, _ = noisy_recording(
        URDF, 61, duration_s=15.0, encoder_noise=noise, torque_noise=torque_noise, fastest_hz=0.8
    )
    options = Settings.from_mapping({"cutoff_hz": 10.0, "estimator": "physical", **settings}, "test")
    return prepare(RobotModel.from_urdf(perturbed(URDF, 62)), [recording], options, ())


def test_noise_of_predicted_torque_is_what_true_parameters_leave() -> None:
    prepared = prepared_with(5e-4, torque_noise=0.0, encoder_noise=5e-4)
    x = prepared.prior.mean.clone()
    x[: prepared.robot.n_params] = torch.from_numpy(true_parameters(URDF))
    count = prepared.statistics.torque[..., 0].sum(0)
    left = (prepared.statistics.squared_error(x).sum(0) / count).sqrt()
    # some 300 independent samples on either side
    torch.testing.assert_close(prepared.input_noise.torque_std, left, rtol=0.15, atol=0.0)


def test_noise_of_the_columns_is_what_noisy_states_add_to_their_moments() -> None:
    quiet, loud = prepared_with(1e-7), prepared_with(3e-3)
    told = loud.input_noise.columns_gram[0]
    added = loud.training.total()[0][:-1, :-1] - quiet.training.total()[0][:-1, :-1]
    # the last body's inertia about joint 1 is driven by accelerations alone, noise adds to it without bending it
    k = int((added.diagonal() / quiet.training.total()[0].diagonal()[:-1].clamp_min(1e-12)).argmax())
    assert float(told[k, k]) == pytest.approx(float(added[k, k]), rel=0.2)


def test_regime_follows_the_noise() -> None:
    excess = [prepared_with(noise).input_noise.excess for noise in (1e-6, 1e-4, 1e-3)]
    assert excess[0] == pytest.approx(1.0, abs=0.01)
    assert excess[0] < excess[1] < excess[2]
    assert [prepared_with(noise).input_noise.matters for noise in (1e-6, 3e-3)] == [False, True]


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "fastest_hz"), [(3e-4, 0.8), (1e-3, 1.5)])
def test_excess_is_what_noise_adds_to_the_squared_error(noise: float, fastest_hz: float) -> None:
    """A fit's squared error is measured in the metric of the one on exact states, and compared with that one's."""
    told, errors = [], []
    for seed, urdf in enumerate(development_robots(6).values()):
        robot = RobotModel.from_urdf(perturbed(urdf, seed + 170))
        options = {"duration_s": 30.0, "fastest_hz": fastest_hz, "loop": "open"}
        K = base_parameters(robot).combination
        fits = []
        for std in (noise, 0.0):
            recording, _ = noisy_recording(urdf, seed + 180, encoder_noise=std, **options)
            prepared = prepare(robot, [recording], Settings(cutoff_hz=10.0, estimator="physical"), ())
            fits.append((prepared, prepared.fit()))
        exact = fits[1][1]
        V = K @ exact.inertial_covariance(exact.laplace) @ K.T
        away = torch.stack([K @ (m.pi - torch.from_numpy(true_parameters(urdf))) for _, m in fits])
        errors.append((away * torch.linalg.solve(V, away.T).T).sum(-1))
        told.append(fits[0][0].input_noise.excess)
    noisy, known = torch.stack(errors).log().mean(0).exp().tolist()
    claimed = float(np.exp(np.mean(np.log(told))))
    assert 0.4 < claimed / (noisy / known) < 1.5


def test_known_noise_takes_the_place_of_the_estimate() -> None:
    prepared = prepared_with(1e-4, encoder_noise={"joint2": 5e-3})
    std = prepared.input_noise.encoder_std
    assert float(std[1]) == pytest.approx(5e-3)
    assert float(std[0]) == pytest.approx(1e-4, rel=0.1)
    with pytest.raises(OptionError, match="elbow"):
        prepared_with(1e-4, encoder_noise={"elbow": 1e-3})


@pytest.mark.slow
def test_slow_clock_is_not_smoothed_and_says_so() -> None:
    recording, _ = noisy_recording(URDF, 63, duration_s=30.0, rate_hz=40.0, encoder_noise=3e-3, fastest_hz=0.8)
    robot = RobotModel.from_urdf(perturbed(URDF, 64))
    result = torchrbd.identify(robot, [recording], cutoff_hz=10.0, estimator="smoother")
    assert result.states == "filtered"
    assert any("leaves no room above the cut-off" in note for note in result.notes)


def test_uncertain_states_widen_and_do_not_move() -> None:
    robot, _ = recorded(3)
    columns = columns_of(robot)
    prior, moments = prior_of(columns), random_moments(columns, 4, 60)
    equations = scaled_equations(prior, moments.total(), columns, torch.ones(robot.n_dof, dtype=torch.float64))
    inverse = torch.linalg.pinv(prior.scale)
    gram = inverse.T @ equations.H @ inverse
    lost = 0.6 * gram
    zeros = torch.zeros(robot.n_dof, dtype=torch.float64)
    states = UncertainStates(gram, lost, zeros, zeros)
    discounted = states.discount(prior, equations)
    torch.testing.assert_close(discounted.H, 0.4 * equations.H, rtol=1e-6, atol=1e-6 * float(equations.H.abs().max()))
    np.testing.assert_allclose(discounted.posterior().z, equations.posterior().z, rtol=1e-6, atol=1e-8)
    nothing = UncertainStates(gram, 0.0 * gram, zeros, zeros).discount(prior, equations)
    torch.testing.assert_close(nothing.H, equations.H)
    torch.testing.assert_close(nothing.h, equations.h)


def test_noise_of_every_joint_is_in_the_result() -> None:
    recording, _ = noisy_recording(URDF, 65, duration_s=12.0, encoder_noise=5e-4, fastest_hz=0.8)
    result = torchrbd.identify(RobotModel.from_urdf(perturbed(URDF, 66)), [recording], cutoff_hz=10.0)
    assert set(result.noise) == set(recording.joints)
    for noise in result.noise.values():
        assert noise.position == pytest.approx(5e-4, rel=0.1)
        assert noise.torque > 0
        assert noise.from_position > 0
    assert result.covariance.shape == (70, 70)
    robots = result.posterior.robots(50)
    assert robots.shape == (50, 70)
    assert bool(is_physical(robots.reshape(50, 7, 10)).all())
    variance = result.posterior.torque_variance(*torch.ones(3, 5, 7, dtype=torch.float64))
    assert variance.parameters.shape == (5, 7)
    assert bool((variance.parameters > 0).all())
    assert len(result.base) == len({b.expression for b in result.base})
    assert all(b.std > 0 and 0 <= b.prior_share <= 1 for b in result.base)
