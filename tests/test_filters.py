"""Filters: compiled and not, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.signal import lfilter
from torch.autograd import gradcheck

from torchrbd._runtime import filters


@pytest.fixture(params=["compiled", "library"])
def _way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "library":
        monkeypatch.setattr(filters, "library", lambda source: None)
    elif filters.library(filters.COMPILED) is None:
        pytest.skip("no C compiler")


@pytest.mark.usefixtures("_way")
@pytest.mark.parametrize(("taps", "stride"), [(1, 1), (7, 3), (63, 6), (64, 1)])
def test_thinned_is_a_product_of_every_window(taps: int, stride: int) -> None:
    rng = np.random.default_rng(taps)
    x, kernel = rng.standard_normal((3, 2, 400)), rng.standard_normal(taps)
    expected = np.lib.stride_tricks.sliding_window_view(x, taps, -1)[..., ::stride, :] @ kernel
    outputs = expected.shape[-1]
    given = torch.from_numpy(x), torch.from_numpy(kernel), stride
    np.testing.assert_allclose(filters.thinned(*given, outputs).numpy(), expected, atol=1e-13)
    np.testing.assert_allclose(filters.thinned(*given, outputs - 5).numpy(), expected[..., :-5], atol=1e-13)
    turned = filters.thinned(given[0].mT.contiguous().mT, *given[1:], outputs)
    np.testing.assert_allclose(turned.numpy(), expected, atol=1e-13)
    single = filters.thinned(given[0].float(), *given[1:], outputs)
    assert single.dtype == torch.float32
    np.testing.assert_allclose(single.numpy(), expected, atol=1e-4)


@pytest.mark.parametrize("shared", [False, True])
def test_convolved_is_a_convolution_of_each_row_with_each_of_its_kernels(shared: bool) -> None:
    rng = np.random.default_rng(3)
    x, kernels = rng.standard_normal((2, 101)), rng.standard_normal((1 if shared else 2, 3, 7))
    found = filters.convolved(torch.from_numpy(x), torch.from_numpy(kernels)).numpy()
    expected = [[np.convolve(x[i], kernels[0 if shared else i, k], "valid") for i in range(2)] for k in range(3)]
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")
def test_thinned_has_derivatives() -> None:
    x, kernel = torch.randn(2, 12, dtype=torch.float64), torch.randn(5, dtype=torch.float64)
    assert gradcheck(lambda x: filters.thinned(x, kernel, 2, 4), x.clone().requires_grad_())
    tangent = torch.randn_like(x)
    _, found = torch.func.jvp(lambda x: filters.thinned(x, kernel, 2, 4), (x,), (tangent,))
    torch.testing.assert_close(found, filters.thinned(tangent, kernel, 2, 4))
    each = torch.vmap(lambda x: filters.thinned(x, kernel, 2, 4))(x)
    torch.testing.assert_close(each, filters.thinned(x, kernel, 2, 4))


@pytest.mark.usefixtures("_way")
@pytest.mark.parametrize("order", [1, 4, 16])
@pytest.mark.parametrize("samples", [3, 100, 331])
def test_unpredicted_is_what_a_filter_of_finite_length_leaves(order: int, samples: int) -> None:
    rng = np.random.default_rng(order)
    x, a = rng.standard_normal((2, 5, samples)), rng.standard_normal(order)
    index = np.sort(rng.choice(samples, samples // 2 + 1, replace=False))
    expected = lfilter(np.concatenate(([1.0], -a)), 1.0, x)[..., index]
    np.testing.assert_allclose(filters.unpredicted(x, a, index), expected, atol=1e-13)
    np.testing.assert_allclose(filters.unpredicted(x[1, 2], a, index), expected[1, 2], atol=1e-13)
    apart = filters.unpredicted(np.asfortranarray(x), a, index)
    np.testing.assert_allclose(apart, expected, atol=1e-13)
