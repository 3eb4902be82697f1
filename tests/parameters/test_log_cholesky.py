"""Log-Cholesky coordinates: a smooth bijection between ten free numbers and physical bodies."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from parameters.bodies import by_hand, random_bodies
from torch.autograd import gradcheck, gradgradcheck

from torchrbd.errors import PhysicalError
from torchrbd.parameters import from_log_cholesky, is_physical, to_log_cholesky


@pytest.mark.parametrize("size", [1e-3, 1.0, 30.0], ids=["finger", "arm", "crane"])
def test_round_trips(size: float) -> None:
    pi = random_bodies(0, 200, size=size)
    back = from_log_cholesky(to_log_cholesky(pi))
    assert ((back - pi).abs() <= 1e-10 * pi.abs().amax(0)).all()
    theta = torch.randn(200, 10, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    torch.testing.assert_close(to_log_cholesky(from_log_cholesky(theta)), theta, rtol=0, atol=1e-9)


def test_coordinates_are_those_of_rucker_and_wensing() -> None:
    """J = U U' with U as the paper writes it, in plain numpy."""
    rng = np.random.default_rng(3)
    alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3 = theta = rng.normal(size=10)
    U = np.exp(alpha) * np.array(
        [[np.exp(d1), s12, s13, t1], [0, np.exp(d2), s23, t2], [0, 0, np.exp(d3), t3], [0, 0, 0, 1]]
    )
    J = U @ U.T
    inertia = np.trace(J[:3, :3]) * np.eye(3) - J[:3, :3]
    expected = [J[3, 3], *J[:3, 3], *inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]
    pi = from_log_cholesky(torch.from_numpy(theta))
    np.testing.assert_allclose(pi.numpy(), expected, rtol=1e-12)
    np.testing.assert_allclose(pi[0], np.exp(2 * alpha))
    np.testing.assert_allclose(pi[1:4] / pi[0], [t1, t2, t3])


def test_any_coordinates_are_a_physical_body() -> None:
    theta = 1.5 * torch.randn(2000, 10, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    pi = from_log_cholesky(theta)
    assert is_physical(pi).all()
    assert by_hand(pi).all()


def test_gradients_of_both_directions() -> None:
    theta = torch.randn(3, 10, generator=torch.Generator().manual_seed(1), dtype=torch.float64, requires_grad=True)
    assert gradcheck(from_log_cholesky, theta)
    assert gradgradcheck(from_log_cholesky, theta)
    pi = random_bodies(2, 3).requires_grad_()
    assert gradcheck(to_log_cholesky, pi, eps=1e-7)


def test_batched_is_looped() -> None:
    pi = random_bodies(4, 6).reshape(2, 3, 10)
    theta = to_log_cholesky(pi)
    assert theta.shape == pi.shape
    for k in range(2):
        for j in range(3):
            torch.testing.assert_close(theta[k, j], to_log_cholesky(pi[k, j]), rtol=1e-13, atol=1e-13)
            torch.testing.assert_close(from_log_cholesky(theta)[k, j], from_log_cholesky(theta[k, j]))
    assert to_log_cholesky(pi[0, :0]).shape == (0, 10)


def test_dtype_follows_the_input() -> None:
    pi = random_bodies(5, 4)
    assert to_log_cholesky(pi.float()).dtype == torch.float32
    back = from_log_cholesky(to_log_cholesky(pi.float()))
    torch.testing.assert_close(back, pi.float(), rtol=1e-4, atol=1e-5)


def test_unphysical_bodies_are_told_by_number() -> None:
    pi = random_bodies(6, 4)
    pi[1, 0], pi[3, 4:] = -1.0, 0.0
    with pytest.raises(
        PhysicalError, match=r"bodies number \[1, 3\] have no positive definite pseudo-inertia.*nearest_p"
    ):
        to_log_cholesky(pi)
