"""Which parameters a rigid body can have, and the nearest ones that it can."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from parameters.bodies import by_hand, central_moments, from_points, random_bodies

from torchrbd.parameters import (
    BASIS,
    ORTHONORMAL,
    PARAMETERS_PER_BODY,
    UNITS,
    is_extended,
    is_physical,
    nearest_physical,
    thickened,
    to_log_cholesky,
)
from torchrbd.parameters.inertial import central_covariance
from torchrbd.robot import pseudo_inertia


def perturbed(seed: int, count: int, size: float = 1.0) -> torch.Tensor:
    """Return bodies about half of which no mass distribution has; all with mass."""
    rng = np.random.default_rng(seed)
    pi = random_bodies(seed, count, size=size)
    scale = pi.abs().amax(0)
    return pi + scale * torch.from_numpy(rng.normal(size=pi.shape)) * torch.tensor([0.0] * 4 + [0.2] * 6)


@pytest.mark.parametrize("size", [1e-3, 1.0, 30.0])
def test_physical_means_positive_moments_and_triangle_inequality(size: float) -> None:
    pi = torch.cat((perturbed(0, 400, size), random_bodies(1, 50, size=size)))
    expected = by_hand(pi)
    assert 0.1 < expected.mean() < 0.9
    assert (is_physical(pi).numpy() == expected).all()


def test_positive_moments_alone_are_not_enough() -> None:
    body = torch.tensor([1.0, 0, 0, 0, 1.0, 0, 1.0, 0, 0, 2.1], dtype=torch.float64)
    assert (torch.linalg.eigvalsh(torch.diag(body[[4, 6, 9]])) > 0).all()
    assert not is_physical(body)
    body[9] = 1.9
    assert is_physical(body)


@pytest.mark.parametrize("mass", [0.0, -1.0])
def test_no_mass_is_not_physical(mass: float) -> None:
    body = torch.tensor([mass, 0, 0, 0, 1, 0, 1, 0, 0, 1], dtype=torch.float64)
    assert not is_physical(body)
    assert not is_physical(torch.zeros(10, dtype=torch.float64))


def test_rods_and_plates_are_not_positive_definite() -> None:
    """A rod or plate without thickness is the limit of physical bodies; no coordinates, no prior can be built on it."""
    rod = from_points(np.ones(2), np.array([[0.0, 0, 0.1], [0, 0, 0.5]]))
    plate = from_points(np.ones(3), np.array([[0.0, 0, 0.1], [0, 0.3, 0.5], [0, 0, 1.0]]))
    assert not is_physical(torch.from_numpy(np.stack((rod, plate)))).any()


def test_basis_spans_the_pseudo_inertia() -> None:
    pi = random_bodies(2, 3)
    torch.testing.assert_close(torch.einsum("bk,kij->bij", pi, BASIS), pseudo_inertia(pi))
    assert len(UNITS) == PARAMETERS_PER_BODY == 10


def test_physical_bodies_are_left_alone() -> None:
    pi = random_bodies(3, 50)
    assert torch.equal(nearest_physical(pi), pi)


@pytest.mark.parametrize("size", [1e-3, 1.0, 30.0])
def test_repaired_bodies_are_physical_and_keep_mass_and_centre(size: float) -> None:
    pi = perturbed(4, 300, size)
    bad = ~by_hand(pi)
    repaired = nearest_physical(pi)
    assert bad.any()
    assert by_hand(repaired).all()
    assert is_physical(repaired).all()
    assert torch.equal(repaired[~bad], pi[~bad])
    torch.testing.assert_close(repaired[:, :4], pi[:, :4], rtol=1e-12, atol=0)
    to_log_cholesky(repaired)  # positive definite enough for a Cholesky factor
    again = nearest_physical(repaired)
    torch.testing.assert_close(again, repaired, rtol=0, atol=0)


def test_repair_raises_only_what_is_too_small() -> None:
    """A plate without thickness gets one; its extent in the plane stays."""
    plate = torch.from_numpy(from_points(np.ones(4), np.array([[0, 1.0, 1], [0, -1, 1], [0, 1, -1], [0, -1, -1]])))
    repaired = nearest_physical(plate)
    before, after = central_moments(plate.numpy()), central_moments(repaired.numpy())
    extent = lambda moments: np.sort(moments.sum() / 2 - moments)  # noqa: E731
    np.testing.assert_allclose(extent(before), [0, 4, 4], atol=1e-12)
    np.testing.assert_allclose(extent(after), [4 * 0.05**2 * 2, 4, 4], rtol=1e-9)


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0), (0.3, -0.2, 1.0)])
def test_point_masses_are_repaired(centre: tuple[float, ...]) -> None:
    body = torch.from_numpy(from_points(np.array([2.0]), np.array([centre])))
    repaired = nearest_physical(body)
    assert by_hand(repaired[None]).all()
    torch.testing.assert_close(repaired[:4], body[:4])


def test_repair_is_batched() -> None:
    pi = perturbed(5, 6).reshape(2, 3, 10)
    repaired = nearest_physical(pi)
    for index in np.ndindex(2, 3):
        torch.testing.assert_close(repaired[index], nearest_physical(pi[index]), rtol=1e-12, atol=1e-14)
    assert nearest_physical(pi[0, :0]).shape == (0, 10)


def test_a_point_becomes_a_body_of_plausible_width() -> None:
    """0.6 kg at 0.2 m with a placeholder inertia: widened to 0.3 r in all directions, mass and centre kept."""
    point = torch.from_numpy(from_points(np.array([0.6]), np.array([[0.0, 0, 0.2]])))
    point[[4, 6, 9]] += 1e-7
    assert is_physical(point)
    assert not is_extended(point)
    repaired = nearest_physical(point)
    assert is_extended(repaired)
    torch.testing.assert_close(repaired[:4], point[:4])
    moments = central_moments(repaired.numpy())
    np.testing.assert_allclose(moments, 2 * 0.6 * (0.3 * 0.2) ** 2, rtol=1e-4)


def test_needles_are_thickened_and_nothing_else() -> None:
    """A rod of 1 m about its end, r = 0.58 m: at least 0.1 r wide in all directions, mass, centre and length kept."""
    rod = torch.from_numpy(from_points(np.full(101, 0.01), np.linspace(0, 1, 101)[:, None] * np.array([[0.0, 0, 1]])))
    rod[[4, 6, 9]] += 1e-6
    assert is_physical(rod)
    thick = thickened(rod)
    torch.testing.assert_close(thick[:4], rod[:4], rtol=1e-12, atol=1e-14)
    moments = central_moments(thick.numpy())
    across = np.sort(moments.sum() / 2 - moments)
    second = float(rod[4] + rod[6] - rod[9]) / 2
    np.testing.assert_allclose(across[:2], 0.1**2 * second, rtol=1e-3)
    before = central_moments(rod.numpy())
    assert across[2] == pytest.approx(before.max(), rel=1e-3)
    torch.testing.assert_close(thickened(thick), thick, rtol=0.03, atol=1e-5)
    sturdy = random_bodies(6, 50)
    sturdy = sturdy[torch.linalg.eigvalsh(central_covariance(sturdy))[:, 0] > 0.02 * sturdy[:, 4:].abs().amax(1)]
    assert len(sturdy) > 5
    assert torch.equal(thickened(sturdy), sturdy)


def test_orthonormal_basis_of_the_symmetric_matrices() -> None:
    gram = torch.einsum("kij,lij->kl", ORTHONORMAL, ORTHONORMAL)
    torch.testing.assert_close(gram, torch.eye(10, dtype=torch.float64), rtol=0, atol=1e-15)
    assert torch.equal(ORTHONORMAL, ORTHONORMAL.mT)
