"""What all regressions share: tensors or numpy, one way to predict, and the same refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from regression.regressions import problem

from torchrbd.errors import InputError, OptionError
from torchrbd.regression import (
    EIVARD,
    BestRegression,
    FactorRegression,
    Lasso,
    Moments,
    NoisyInputRegression,
    OrdinaryLeastSquares,
    PartialLeastSquares,
    PrincipalComponents,
    Regression,
    Ridge,
    Stepwise,
    TotalLeastSquares,
    TruncatedSVD,
)

NOISE_AWARE: list[Callable[[Any], Regression]] = [EIVARD, FactorRegression, BestRegression, NoisyInputRegression]
ALL: list[Callable[[], Regression]] = [
    *(lambda of=of: of(0.25) for of in NOISE_AWARE),
    *(FactorRegression, BestRegression, NoisyInputRegression),
    *(OrdinaryLeastSquares, TruncatedSVD, TotalLeastSquares, Stepwise),
    *(Ridge, Lasso, PartialLeastSquares, PrincipalComponents),
]


@pytest.mark.parametrize("build", ALL)
def test_numpy_lists_and_single_precision_are_accepted(build: Callable[[], Regression]) -> None:
    X, y = problem(300)
    expected = build().fit(X, y)
    read_only = X.numpy().copy()
    read_only.setflags(write=False)
    found = build().fit(read_only, y.tolist())
    assert torch.equal(found.coefficients, expected.coefficients)
    assert torch.equal(found.predict(read_only), expected.predict(X))
    assert expected.predict(X.float()).dtype == torch.float32
    whole = torch.arange(12).reshape(2, 6)
    torch.testing.assert_close(expected.predict(whole), whole.double() @ expected.coefficients)


@pytest.mark.parametrize("build", ALL)
def test_what_cannot_be_used_is_refused(build: Callable[[], Regression]) -> None:
    X, y = problem(310)
    method = build()
    for before in (lambda: method.predict(X), lambda: method.coefficients, lambda: method.noisy_coefficients):
        with pytest.raises(InputError, match=r"no data yet: call fit\(X, y\) first"):
            before()
    with pytest.raises(InputError, match="y is missing"):
        method.fit(X)
    with pytest.raises(InputError, match="y is given with moments"):
        method.fit(Moments.from_data(X, y), y)
    with pytest.raises(InputError, match="X: expected an array of numbers, got list"):
        method.fit([["a"] * 6] * 80, y)
    with pytest.raises(InputError, match=r"expected X \(N, d\) and y \(N,\)"):
        method.fit(X.numpy(), y.numpy()[:-1])
    method.fit(X, y)
    with pytest.raises(InputError, match=r"expected \(N, 6\), as many inputs as were fitted, got \(80, 5\)"):
        method.predict(X[:, :5])


@pytest.mark.parametrize("method", NOISE_AWARE)
def test_one_noise_variance_is_that_of_every_input(method: Callable[[Any], Regression]) -> None:
    rows = problem(320)
    expected = method(torch.full((6,), 0.25, dtype=torch.float64)).fit(*rows).coefficients
    for same in (0.25, np.full(6, 0.25)):
        assert torch.equal(method(same).fit(*rows).coefficients, expected)
    for wrong in (np.ones(5), -1.0, float("nan")):
        with pytest.raises(OptionError, match="input_noise"):
            method(wrong).fit(*rows)
    with pytest.raises(InputError, match="input_noise: expected an array of numbers, got str"):
        method("much").fit(*rows)
