"""Check the entropic prior of bodies against its density, by differences, sampling and a general optimiser."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from likelihood.arms import arm_urdf
from scipy.optimize import approx_fprime, minimize

from torchrbd.likelihood.coefficient_prior import inertial_scale
from torchrbd.likelihood.physical import expanded, most_probable
from torchrbd.parameters import ORTHONORMAL, PARAMETERS_PER_BODY, is_physical
from torchrbd.robot import RobotModel, pseudo_inertia

B = ORTHONORMAL.numpy()
ROBOT = RobotModel.from_urdf(arm_urdf(0, 2))


def relative(z: np.ndarray, kappa: float) -> np.ndarray:
    """Return G (b, 4, 4) = 1 + sum_k z_k B_k / root kappa."""
    return np.eye(4) + np.einsum("bk,kij->bij", z.reshape(-1, PARAMETERS_PER_BODY), B) / math.sqrt(kappa)


def log_density(z: np.ndarray, kappa: float) -> float:
    """Return -kappa sum [tr G - logdet G]."""
    G = relative(z, kappa)
    return -kappa * float(np.sum(np.trace(G, axis1=1, axis2=2) - np.linalg.slogdet(G)[1]))


def inside(seed: int, kappa: float, n_bodies: int = 2) -> np.ndarray:
    """Return a physical z, some way from the URDF."""
    z = np.random.default_rng(seed).normal(size=PARAMETERS_PER_BODY * n_bodies)
    return 0.5 * math.sqrt(kappa) * z / np.abs(np.linalg.eigvalsh(np.einsum("k,kij->ij", z[:10], B))).max()


@pytest.mark.parametrize("kappa", [0.3, 10.0, 300.0])
def test_expansion_is_the_log_density_to_second_order(kappa: float) -> None:
    z, rng = inside(1, kappa), np.random.default_rng(2)
    got = expanded(z, kappa)
    origin = got.constant - 0.5 * z @ got.precision @ z + got.shift @ z - log_density(z, kappa)
    for _ in range(5):
        d = rng.normal(size=len(z))
        d *= 1e-3 * math.sqrt(kappa) / np.linalg.norm(d)
        up, down, here = log_density(z + d, kappa), log_density(z - d, kappa), log_density(z, kappa)
        assert (got.shift - got.precision @ z) @ d == pytest.approx(0.5 * (up - down), rel=1e-4, abs=1e-9 * kappa)
        assert -(d @ got.precision @ d) == pytest.approx(up - 2 * here + down, rel=1e-4, abs=1e-8 * kappa)
        quadratic = got.constant - 0.5 * (z + d) @ got.precision @ (z + d) + got.shift @ (z + d)
        assert quadratic - origin == pytest.approx(up, abs=1e-7 * kappa)


def test_curvature_at_the_urdf_is_one_and_bodies_are_apart() -> None:
    got = expanded(np.zeros(20), 7.0)
    np.testing.assert_allclose(got.precision, np.eye(20), atol=1e-12)
    np.testing.assert_allclose(got.shift, 0.0, atol=1e-12)
    one, two = (expanded(inside(3, 7.0)[part], 7.0) for part in (slice(0, 10), slice(10, 20)))
    both = expanded(inside(3, 7.0), 7.0)
    assert both.constant == pytest.approx(one.constant + two.constant)
    assert not both.precision[:10, 10:].any()


def test_normaliser_is_that_of_importance_sampling() -> None:
    """At the URDF the normalised density over that of N(0, 1) is one over the integral of what it falls by."""
    kappa, width, rng = 10.0, 1.3, np.random.default_rng(0)
    z = width * rng.normal(size=(200_000, PARAMETERS_PER_BODY))
    G = np.eye(4) + np.einsum("mk,kij->mij", z, B) / math.sqrt(kappa)
    values = np.linalg.eigvalsh(G)
    physical = values[:, 0] > 0
    exponent = -kappa * np.sum(values - np.log(np.where(values > 0, values, 1.0)), axis=1)
    proposal = -0.5 * np.sum((z / width) ** 2, 1) - PARAMETERS_PER_BODY * math.log(width)
    weights = np.where(physical, np.exp(exponent + 4 * kappa - proposal), 0.0)
    integral = weights.mean()
    assert weights.std() / math.sqrt(len(z)) < 0.01 * integral
    assert -math.log(integral) == pytest.approx(expanded(np.zeros(PARAMETERS_PER_BODY), kappa).constant, abs=0.03)


def test_prior_of_a_large_kappa_is_the_normal_one() -> None:
    assert expanded(np.zeros(20), 1e4).constant == pytest.approx(0.0, abs=1e-2)


def problem(seed: int, rows: int = 30, size: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Return A and h of rows that would have bodies be far from physical."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(rows, 20))
    return X.T @ X, X.T @ (X @ (size * rng.normal(size=20)) + rng.normal(size=rows))


@pytest.mark.parametrize(("kappa", "rows"), [(1.0, 30), (10.0, 8), (100.0, 30)])
def test_most_probable_bodies_are_physical_and_those_of_a_general_optimiser(kappa: float, rows: int) -> None:
    A, h = problem(4, rows)

    def objective(z: np.ndarray) -> float:
        if np.linalg.eigvalsh(relative(z, kappa)).min() <= 0:
            return np.inf
        return 0.5 * z @ A @ z - h @ z - log_density(z, kappa)

    def slope(z: np.ndarray) -> np.ndarray:
        inverse = np.linalg.inv(relative(z, kappa))
        own = np.trace(B, axis1=1, axis2=2) - np.einsum("bij,kji->bk", inverse, B)
        return A @ z - h + math.sqrt(kappa) * own.ravel()

    z = most_probable(A, h, kappa)
    assert np.linalg.eigvalsh(relative(z, kappa)).min() > 0
    np.testing.assert_allclose(slope(0.5 * z), approx_fprime(0.5 * z, objective, 1e-7), rtol=1e-3, atol=1e-3 * kappa)
    found = minimize(objective, 0.5 * z, jac=slope, method="BFGS", options={"gtol": 1e-6, "maxiter": 2000})
    assert objective(z) <= found.fun + 1e-6
    np.testing.assert_allclose(z, found.x, atol=1e-3)
    mean, index, S = inertial_scale(ROBOT)
    mean[index] += S @ z / math.sqrt(kappa)
    bodies = torch.from_numpy(mean).reshape(-1, PARAMETERS_PER_BODY)
    assert is_physical(bodies).all()
    J, J0 = pseudo_inertia(bodies), pseudo_inertia(ROBOT.pi.reshape(-1, PARAMETERS_PER_BODY))
    expected = np.linalg.eigvalsh(relative(z, kappa))
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(torch.linalg.solve(J0, J)).real), expected, rtol=1e-6)


def test_without_data_the_urdf_is_most_probable() -> None:
    np.testing.assert_allclose(most_probable(np.zeros((20, 20)), np.zeros(20), 3.0), 0.0, atol=1e-9)
