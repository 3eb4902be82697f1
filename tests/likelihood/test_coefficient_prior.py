"""Check what is believed of coefficients before the data."""

import numpy as np
import pytest
import torch
from likelihood.arms import arm_urdf

from torchrbd.dataset.columns import Candidate
from torchrbd.effects import Site
from torchrbd.effects.registry import effect
from torchrbd.likelihood.coefficient_prior import TORQUE_SCALES, UNIT_SCALES, coefficient_std, inertial_scale
from torchrbd.parameters import PARAMETERS_PER_BODY, is_physical
from torchrbd.robot import RobotModel, from_pseudo_inertia, pseudo_inertia

ROBOT = RobotModel.from_urdf(arm_urdf(0, 3))


def covariance(robot: RobotModel) -> np.ndarray:
    _, _, S = inertial_scale(robot)
    return S @ S.T


def moved(pi: torch.Tensor, T: torch.Tensor) -> torch.Tensor:
    """Return what pi (..., 10) is where points x are T x in homogeneous coordinates: J -> T J T'."""
    return from_pseudo_inertia(T @ pseudo_inertia(pi) @ T.mT)


def other(robot: RobotModel, pi: torch.Tensor) -> RobotModel:
    changed = RobotModel.from_urdf(arm_urdf(0, 3))
    changed.pi.copy_(pi.flatten())
    return changed


def test_mean_is_the_urdf_and_bodies_do_not_depend_on_each_other() -> None:
    mean, index, _ = inertial_scale(ROBOT)
    np.testing.assert_allclose(mean, ROBOT.pi.numpy(), rtol=1e-12)
    assert index.tolist() == list(range(ROBOT.n_params))
    C = covariance(ROBOT).reshape(3, PARAMETERS_PER_BODY, 3, PARAMETERS_PER_BODY)
    for a in range(3):
        for b in range(3):
            assert a == b or not C[a, :, b].any()


def test_covariance_is_the_inverse_metric_of_pseudo_inertias() -> None:
    """d' M d = tr(J^-1 D J^-1 D) for any change D of a body."""
    C, rng = covariance(ROBOT), np.random.default_rng(0)
    for b, pi in enumerate(ROBOT.pi.reshape(-1, PARAMETERS_PER_BODY)):
        own = slice(PARAMETERS_PER_BODY * b, PARAMETERS_PER_BODY * (b + 1))
        M, inverse = np.linalg.inv(C[own, own]), torch.linalg.inv(pseudo_inertia(pi))
        for d in rng.normal(size=(5, PARAMETERS_PER_BODY)) * pi.abs().numpy():
            D = inverse @ pseudo_inertia(torch.from_numpy(d))
            assert d @ M @ d == pytest.approx(float(torch.trace(D @ D)), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_covariance_moves_with_frame_and_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    size = 10.0 ** rng.uniform(-2, 2)
    T[:3, :3] = size * np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T[:3, 3] = 0.3 * size * rng.normal(size=3)
    T = torch.from_numpy(T * np.sqrt(1000.0 ** rng.uniform(-1, 1)))
    bodies = ROBOT.pi.reshape(-1, PARAMETERS_PER_BODY)
    A = moved(torch.eye(PARAMETERS_PER_BODY, dtype=torch.float64), T).T.numpy()
    np.testing.assert_allclose(A @ bodies[0].numpy(), moved(bodies[0], T).numpy(), rtol=1e-9)
    got, C = covariance(other(ROBOT, moved(bodies, T))), covariance(ROBOT)
    for b in range(3):
        own = slice(PARAMETERS_PER_BODY * b, PARAMETERS_PER_BODY * (b + 1))
        expected = A @ C[own, own] @ A.T
        size = np.sqrt(np.diag(expected))
        np.testing.assert_allclose(got[own, own] / size / size[:, None], expected / size / size[:, None], atol=1e-6)


def test_mass_errs_by_one_over_root_kappa() -> None:
    mean, _, S = inertial_scale(ROBOT)
    np.testing.assert_allclose(np.sqrt(np.diag(S @ S.T))[::PARAMETERS_PER_BODY], mean[::PARAMETERS_PER_BODY])


def test_draws_that_err_by_a_tenth_are_physical() -> None:
    mean, _, S = inertial_scale(ROBOT)
    z = np.random.default_rng(0).normal(size=(500, len(mean)))
    part = [
        is_physical(torch.from_numpy(mean + z @ S.T / np.sqrt(kappa)).reshape(500, -1, PARAMETERS_PER_BODY))
        .double()
        .mean()
        for kappa in (300.0, 100.0, 1.0)
    ]
    assert part[0] == 1.0
    assert part[1] > 0.99
    assert part[2] < 0.5


def test_trusted_bodies_are_not_fitted() -> None:
    name = ROBOT.body_names[1]
    _, index, S = inertial_scale(ROBOT, frozenset({name}))
    assert index.tolist() == [*range(10), *range(20, 30)]
    assert S.shape == (20, 20)
    _, index, S = inertial_scale(ROBOT, frozenset(ROBOT.body_names))
    assert (index.shape, S.shape) == ((0,), (0, 0))
    assert index.dtype == int


def candidate(name: str, site: Site) -> Candidate:
    e = effect(name)
    return Candidate(e, site, {}, tuple(e.units))


def size(F: np.ndarray) -> np.ndarray:
    """Return the root mean square of features (..., M)."""
    return np.sqrt(np.mean(F**2, axis=-1))


def test_size_by_torque_makes_all_of_the_joints_torque() -> None:
    rng = np.random.default_rng(1)
    F, rms = rng.normal(size=(1, 400)), np.array([2.0, 30.0, 0.0])
    std, scales = coefficient_std(candidate("quadratic_drag", Site(1)), size(F), rms)
    assert scales == TORQUE_SCALES
    assert np.sqrt(np.mean((std[0] * F[0]) ** 2)) == pytest.approx(30.0)
    (other,), _ = coefficient_std(candidate("quadratic_drag", Site(1)), size(1e3 * F), rms)
    assert other == pytest.approx(std[0] / 1e3)
    assert coefficient_std(candidate("quadratic_drag", Site(1)), size(0 * F), rms)[0][0] == 0.0
    assert coefficient_std(candidate("quadratic_drag", Site(2)), size(F), rms)[0][0] == 0.0


def test_size_by_unit_does_not_depend_on_the_torque() -> None:
    F = np.random.default_rng(2).normal(size=(1, 3, 400))
    for rms in (np.ones(3), np.array([0.1, 7.0, 0.0])):
        std, scales = coefficient_std(candidate("time_delay", Site()), size(F), rms)
        assert scales == UNIT_SCALES
        np.testing.assert_allclose(std, [0.02])
    assert coefficient_std(candidate("time_delay", Site()), size(0 * F), np.ones(3))[0][0] == 0.0


def test_joints_sit_some_centimetres_off_whatever_torque_that_makes() -> None:
    F = np.random.default_rng(4).normal(size=(6, 3, 400))
    F[1] = 0.0
    for part in (0.01, 100.0):
        std, scales = coefficient_std(candidate("geometry_error", Site(1)), size(part * F), np.array([1.0, 5.0, 0.0]))
        assert scales == UNIT_SCALES
        np.testing.assert_array_equal(std, [0.02, 0.0, 0.02, 0.05, 0.05, 0.05])


def test_sizes_of_several_keep_their_proportions_within_the_torque_of_every_joint() -> None:
    rng = np.random.default_rng(3)
    F, rms = rng.normal(size=(10, 3, 400)), np.array([1.0, 5.0, 0.0])
    F[4] = 0.0
    std, scales = coefficient_std(candidate("payload", Site(body=1)), size(F), rms)
    assert scales == TORQUE_SCALES
    believed = np.array(effect("payload").prior.std)
    free = np.arange(10) != 4
    assert np.ptp(std[free] / believed[free]) == pytest.approx(0.0, abs=1e-12)
    assert std[4] == 0.0
    torque = np.sqrt(np.mean((std[:, None, None] * F) ** 2, -1))[:, :2] / rms[:2]
    assert torque.max() == pytest.approx(1.0)
