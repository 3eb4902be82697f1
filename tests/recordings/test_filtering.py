"""Check the filters against sines, polynomials and Monte Carlo."""

import numpy as np
import pytest
import torch

from torchrbd.errors import OptionError
from torchrbd.recordings import Filtering


@pytest.mark.parametrize(("cutoff", "dt"), [(5.0, 0.001), (10.0, 0.005), (8.0, 0.02), (0.5, 0.004)])
def test_kernels_are_symmetric_and_pass_polynomials_exactly(cutoff, dt):
    filtering = Filtering(cutoff)
    feature, kernels = filtering.feature_kernel(dt), filtering.state_kernels(dt)
    assert torch.equal(feature, feature.flip(0))
    assert feature.sum().item() == pytest.approx(1.0, abs=1e-14)
    parity = torch.tensor([[1.0], [-1.0], [1.0]])
    assert torch.equal(kernels, parity * kernels.flip(1))
    half = kernels.shape[1] // 2
    t = -dt * torch.arange(-half, half + 1, dtype=torch.float64)  # convolution reverses time
    for order, expected in enumerate([(1, 0, 0), (0, 1, 0), (0, 0, 2), (0, 0, 0)]):
        got = kernels @ t**order
        scale = kernels.abs() @ t.abs() ** order
        assert torch.all((got - torch.tensor(expected)).abs() <= 1e-12 * scale + 1e-14)


@pytest.mark.parametrize("cutoff_share", [0.02, 0.1, 0.3])
def test_sine_and_its_derivatives_pass(cutoff_share):
    dt = 0.002
    filtering = Filtering(cutoff_share / dt / 2)
    kernels = filtering.state_kernels(dt)
    half = kernels.shape[1] // 2
    t = dt * torch.arange(-half, half + 1, dtype=torch.float64)
    for share, tolerance in ((0.02, 1e-6), (0.6, 2e-3), (1.0, 2e-3)):
        w = 2 * np.pi * share * filtering.cutoff_hz
        reversed_sine = torch.sin(w * -t + 0.7)
        got = kernels @ reversed_sine
        expected = torch.tensor([np.sin(0.7), w * np.cos(0.7), -(w**2) * np.sin(0.7)])
        assert torch.all((got - expected).abs() <= tolerance * torch.tensor([1, w, w**2]))


def test_stop_bands_reject():
    dt = 0.001
    filtering = Filtering(10.0)
    for kernel, edge, tolerance in (
        (filtering.feature_kernel(dt), 15.0, 2e-3),
        (filtering.state_kernels(dt)[0], 30.0, 5e-4),
    ):
        n = torch.arange(kernel.shape[0], dtype=torch.float64)
        f = torch.linspace(edge * 1.02, 500, 400, dtype=torch.float64)
        gain = (torch.exp(-2j * torch.pi * f[:, None] * n * dt) @ kernel.to(torch.complex128)).abs()
        assert gain.max() < tolerance


def test_feature_filter_halves_the_cutoff_frequency():
    dt, cutoff = 0.001, 7.0
    kernel = Filtering(cutoff).feature_kernel(dt)
    half = kernel.shape[0] // 2
    gain = kernel @ torch.cos(2 * torch.pi * cutoff * dt * torch.arange(-half, half + 1, dtype=torch.float64))
    assert gain.item() == pytest.approx(0.5, abs=0.01)


def test_state_noise_is_the_covariance_seen_in_simulation():
    dt, std = 0.004, np.array([1e-3, 2e-4])
    filtering = Filtering(6.0)
    cov = filtering.state_noise(std, dt)
    kernels = filtering.state_kernels(dt)
    noise = torch.from_numpy(np.random.default_rng(0).normal(size=(40000, kernels.shape[1])))
    sampled = torch.cov(kernels @ noise.T)
    for joint in range(2):
        scale = cov[joint].diagonal().sqrt()
        correlation = cov[joint] / torch.outer(scale, scale)
        expected = sampled * std[joint] ** 2 / torch.outer(scale, scale)
        assert torch.allclose(correlation, expected, atol=0.03)
    torch.linalg.cholesky(cov[0] / torch.outer(cov[0].diagonal().sqrt(), cov[0].diagonal().sqrt()))


def test_state_noise_of_a_measured_velocity():
    dt, filtering = 0.004, Filtering(6.0)
    cov = filtering.state_noise(np.array([1e-3, 1e-3]), dt, np.array([np.nan, 0.02]))
    gram = filtering.state_kernels(dt) @ filtering.state_kernels(dt).T
    assert torch.allclose(cov[0], 1e-6 * gram)
    assert torch.allclose(cov[1, 1:, 1:], 4e-4 * gram[:2, :2])
    assert torch.all(cov[1, 0, 1:] == 0)


def test_options_that_cannot_work():
    with pytest.raises(OptionError, match="above zero"):
        Filtering(0.0)
    with pytest.raises(OptionError, match="below the cut-off"):
        Filtering(5.0, 3.0)
    with pytest.raises(OptionError, match=r"too high for a recording at 50 Hz; at most 16\.7 Hz"):
        Filtering(20.0).feature_kernel(0.02)
    assert Filtering(5.0).state_cutoff_hz == 10.0
    assert Filtering(5.0).effective_rate == 10.0
    assert Filtering(5.0).stride(0.001) == 80
