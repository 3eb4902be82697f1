"""The series: its derivatives, and rest where it begins and ends."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torchrbd.excitation import Basis, FourierMotion

GENERATOR = torch.Generator().manual_seed(5)


def motion(harmonics: int, period_s: float = 7.0) -> FourierMotion:
    basis = Basis(period_s, harmonics)
    return FourierMotion(basis, torch.randn(3, basis.n, generator=GENERATOR, dtype=torch.float64))


@pytest.mark.parametrize("harmonics", [2, 3, 6])
def test_states_are_those_of_the_series_that_is_written(harmonics: int) -> None:
    one = motion(harmonics)
    t = np.linspace(0.0, 20.0, 57)
    c, a, b = (x.numpy() for x in (one.centre, one.sine, one.cosine))
    rate = 2 * np.pi * np.arange(1, harmonics + 1) / 7.0
    s, k = np.sin(np.outer(t, rate)), np.cos(np.outer(t, rate))
    expected = (
        c + s @ a.T + k @ b.T,
        (rate * k) @ a.T - (rate * s) @ b.T,
        -(rate**2 * s) @ a.T - (rate**2 * k) @ b.T,
    )
    for found, wanted in zip(one.states(torch.from_numpy(t)), expected, strict=True):
        np.testing.assert_allclose(found.numpy(), wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize("harmonics", [2, 5])
def test_every_period_begins_and_ends_at_rest_without_acceleration(harmonics: int) -> None:
    one = motion(harmonics)
    q, qd, qdd = one.states(torch.tensor([0.0, 7.0, 21.0], dtype=torch.float64))
    fastest = one.states(torch.linspace(0.0, 7.0, 500, dtype=torch.float64))
    assert qd.abs().max() < 1e-12 * fastest[1].abs().max()
    assert qdd.abs().max() < 1e-12 * fastest[2].abs().max()
    torch.testing.assert_close(q[1:], q[:1].expand(2, 3), rtol=0, atol=1e-12)
    torch.testing.assert_close(one.start, q[0], rtol=0, atol=1e-14)


def test_all_series_that_rest_are_reached() -> None:
    """The free coefficients have as many directions as the conditions leave: 2 H + 1 - 2."""
    basis = Basis(3.0, 6)
    assert basis.series.shape == (13, 11)
    assert int(torch.linalg.matrix_rank(basis.series)) == 11


def test_shrunk_motion_keeps_its_centre() -> None:
    one = motion(4)
    t = torch.linspace(0.0, 7.0, 9, dtype=torch.float64)
    q, small = one.states(t)[0] - one.centre, one.shrunk(0.25).states(t)[0] - one.centre
    torch.testing.assert_close(small, 0.25 * q, rtol=0, atol=1e-13)
