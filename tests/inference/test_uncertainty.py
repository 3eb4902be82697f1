"""Standard deviations of what the data tells: right for white and for correlated noise, and never negative."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scipy.signal
import torch
from inference.problems import urdf_of
from simulated import Motion, record, with_wrong_inertials
from torch import Tensor

from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.parameters import base_parameters
from torchrbd.robot import RobotModel

SEEDS = (0, 1, 2, 3, 6, 7, 8)


def correlated(seed: int, seconds: float) -> Callable[[Motion], np.ndarray]:
    """Return torque noise of 1 N m that forgets itself in so many seconds, at 200 Hz."""
    pole = 1 - 1 / (200 * seconds)

    def noise(motion: Motion) -> np.ndarray:
        white = np.random.default_rng(seed + 99).standard_normal(motion.q.shape)
        return scipy.signal.lfilter([np.sqrt(1 - pole**2)], [1, -pole], white, axis=0)

    return noise


def base_errors(seed: int, **options) -> tuple[Tensor, Tensor]:
    """Return K (pi - pi_true) and its claimed variance."""
    urdf = urdf_of(seed, 4)
    robot = RobotModel.from_urdf(with_wrong_inertials(urdf, seed))
    recording = record(urdf, seed, **{"duration_s": 60.0, **options})
    assert recording.joints == robot.joint_names
    prepared = prepare(robot, [recording], Settings(), ())
    model = prepared.fit()
    K, inertial = base_parameters(robot).combination, prepared.prior.inertial
    n = len(inertial)
    variance = (K[:, inertial] @ model.covariance[:n, :n] @ K[:, inertial].T).diagonal()
    return K @ (model.pi - RobotModel.from_urdf(urdf).pi), variance


def standardised(**options) -> Tensor:
    """Return the errors of all base parameters of all robots in standard deviations."""
    pairs = [base_errors(seed, **{k: v(seed) if callable(v) else v for k, v in options.items()}) for seed in SEEDS]
    return torch.cat([error / variance.sqrt() for error, variance in pairs])


@pytest.mark.parametrize(
    "options",
    [{"torque_noise": 0.05}, {"torque_noise": 0.005}, {"torque_noise": 0.01, "encoder_noise": 1e-4}],
    ids=["white", "little", "encoder"],
)
def test_errors_are_as_large_as_claimed(options: dict[str, float]) -> None:
    z = standardised(**options)
    assert 0.7 < float(z.square().mean().sqrt()) < 1.3
    assert float((z.abs() < 1.96).double().mean()) > 0.85


def test_errors_are_as_large_as_claimed_under_correlated_noise() -> None:
    z = standardised(torque_noise=0.01, extra=lambda seed: correlated(seed, 1.0))
    assert 0.7 < float(z.square().mean().sqrt()) < 1.3
    assert float((z.abs() < 1.96).double().mean()) > 0.9


def test_variances_are_positive_without_noise() -> None:
    _, variance = base_errors(6, torque_noise=0.0, encoder_noise=0.0, duration_s=30.0)
    assert (variance > 0).all()
