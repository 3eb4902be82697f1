"""Check states from which the noise of encoders is taken out: Wiener's filter of each joint."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicSpline
from simulated import multisine

from torchrbd.recordings import Filtering, Recording, survey, tiles

CUTOFF_HZ, DURATION_S = 24.0, 20.0


def recorded(noise: float, fastest_hz: float = 1.2, velocity_noise: float | None = None) -> Recording:
    """Record a motion whose torque is its acceleration."""
    m, rng = multisine(2, 0, duration_s=DURATION_S, fastest_hz=fastest_hz), np.random.default_rng(0)
    q = m.q + noise * rng.standard_normal(m.q.shape)
    qd = None if velocity_noise is None else m.qd + velocity_noise * rng.standard_normal(m.q.shape)
    return Recording.from_arrays("moved", ("a", "b"), m.t, q, m.qdd, qd=qd)


def outputs(recording: Recording, filtering: Filtering, rows: int = 4096) -> tuple[np.ndarray, ...]:
    """Return t (M,), filtered q, qd, qdd, and the true acceleration (2, M) each."""
    parts = list(tiles(recording, survey(recording), filtering, rows))
    found = [torch.cat([p.decimate(getattr(p, n)) for p in parts], -1).numpy() for n in ("q", "qd", "qdd", "tau")]
    return torch.cat([p.t_out for p in parts]).numpy(), *found


def of_motion(recording: Recording, rows: int = 4096) -> tuple[np.ndarray, ...]:
    return outputs(recording, Filtering(CUTOFF_HZ, of_motion=True), rows)


def plain(recording: Recording) -> tuple[np.ndarray, ...]:
    return outputs(recording, Filtering(CUTOFF_HZ))


def error(found: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return the error of the acceleration relative to it, (2,)."""
    *_, qdd, true = found
    return np.sqrt(np.mean((qdd - true) ** 2, 1) / np.mean(true**2, 1))


def bias(found: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return by how much a regression of the truth on the estimate falls short of one, (2,)."""
    *_, qdd, true = found
    return np.mean((qdd - true) * qdd, 1) / np.mean(qdd**2, 1)


@pytest.mark.parametrize("fastest_hz", [1.2, 3.0])
@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_accelerations_err_less_and_bias_no_regression(noise: float, fastest_hz: float) -> None:
    recording = recorded(noise, fastest_hz)
    filtered, found = plain(recording), of_motion(recording)
    assert (error(found) < 0.2 * error(filtered)).all()
    assert (np.abs(bias(found)) < 0.005).all()


def test_plain_states_bias_a_regression() -> None:
    assert (bias(plain(recorded(1e-3))) > 0.3).all()


def test_clean_positions_give_the_same_states() -> None:
    """Both clocks of outputs lie a part of a step apart: splines bring them together."""
    recording = recorded(0.0)
    t, *expected = plain(recording)
    at, *got = of_motion(recording)
    for one, other in zip(got, expected, strict=True):
        same = CubicSpline(t, other, axis=1)(at)
        assert np.abs(one - same).max() < 1e-4 * np.abs(other).max()


def test_measured_velocities_keep_what_is_no_noise_of_the_encoder() -> None:
    recording = recorded(1e-3, 3.0, velocity_noise=1e-4)
    assert (~np.isnan(survey(recording).qd_noise_std)).all()
    assert (error(of_motion(recording)) < 1.5 * error(plain(recording))).all()


@pytest.mark.parametrize("rows", [37, 333])
def test_tiles_join(rows: int) -> None:
    recording = recorded(1e-3)
    for one, other in zip(of_motion(recording, rows), of_motion(recording, 10**9), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9 * np.abs(other).max())


def test_ends_lie_further_inside() -> None:
    recording = recorded(1e-3)
    t, at = plain(recording)[0], of_motion(recording)[0]
    f = Filtering(CUTOFF_HZ, of_motion=True)
    assert at[0] == pytest.approx(0.005 * f.reach(0.005))
    assert 0.3 < at[0] - t[0] < 0.9
    assert 0.3 < t[-1] - at[-1] < 0.9


def test_kernels_are_the_state_filters_where_all_is_motion() -> None:
    f = Filtering(CUTOFF_HZ, of_motion=True)
    kernels, hz = f.state_kernels(0.005).numpy(), np.linspace(0.0, 100.0, 50)
    whole = f.motion_kernels(0.005, np.ones((2, 50)), np.ones((2, 50)), hz).numpy()
    pad = (whole.shape[2] - kernels.shape[1]) // 2
    np.testing.assert_allclose(whole[1], np.pad(kernels, ((0, 0), (pad, pad))), atol=1e-9 * np.abs(kernels).max())
    own = Filtering(CUTOFF_HZ).motion_kernels(0.005, np.ones((2, 50)), np.ones((2, 50)), hz)
    np.testing.assert_array_equal(own[0], kernels)


@pytest.mark.parametrize("share_hz", [1.0, 5.0, 15.0])
def test_kernels_are_symmetric_and_exact_for_slow_motion(share_hz: float) -> None:
    """Levels, ramps and the curvature of parabolas pass; what is not motion does not."""
    hz = np.linspace(0.0, 100.0, 400)
    share = (hz < share_hz).astype(float)[None]
    density = np.where(share > 0, 1.0, 1e-3 * (hz / share_hz) ** 4)
    ((q, qd, qdd),) = Filtering(CUTOFF_HZ, of_motion=True).motion_kernels(0.005, share, density, hz).numpy()
    half = len(q) // 2
    t = 0.005 * np.arange(half, -half - 1, -1)
    np.testing.assert_allclose([q.sum(), qd @ t, qdd @ (0.5 * t**2)], 1.0, rtol=1e-6)
    np.testing.assert_allclose(q, q[::-1], atol=1e-12)
    np.testing.assert_allclose(qd, -qd[::-1], atol=1e-9)
    gain = lambda f: np.sum(q * np.cos(2 * np.pi * f * t))  # noqa: E731
    assert gain(0.8 * share_hz) > 0.95
    assert abs(gain(share_hz + 7.5)) < 0.02


def convolved_with(kernel: np.ndarray, length: int) -> np.ndarray:
    """Return the matrix of a convolution whose result has that length."""
    n = length - len(kernel) + 1
    return np.stack([np.pad(kernel, (k, n - 1 - k)) for k in range(n)], axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_no_other_kernel_of_that_length_errs_less(seed: int) -> None:
    """Of all that let slow motion pass, whatever is added to it makes the expected error larger."""
    dt, rng, hz = 0.005, np.random.default_rng(seed), np.linspace(0.0, 100.0, 800)
    density = 1.0 / (1.0 + (hz / 3.0) ** 8) + 1e-3 * (hz / 5.0) ** 4
    share = (1.0 / (1.0 + (hz / 3.0) ** 8)) / density
    f = Filtering(CUTOFF_HZ, of_motion=True)
    kernel = f.motion_kernels(dt, share[None], density[None], hz)[0, 0].numpy()
    wiener = np.linalg.lstsq(convolved_with(f.state_kernels(dt)[0].numpy(), len(kernel)), kernel, rcond=None)[0]
    t = dt * (np.arange(len(wiener)) - len(wiener) // 2)

    def expected(w: np.ndarray) -> float:
        gain = np.cos(2 * np.pi * hz[:, None] * t) @ w
        return float(np.trapezoid(density * ((1 - gain) ** 2 * share + gain**2 * (1 - share)), hz))

    least = expected(wiener)
    for _ in range(10):
        x = rng.normal(size=len(t)) * np.hanning(len(t))
        x += x[::-1]
        slow = np.stack((np.ones_like(t), t**2))
        x -= slow.T @ np.linalg.solve(slow @ slow.T, slow @ x)
        assert expected(wiener + 1e-2 * x / np.abs(x).sum()) > least
