"""Choosing by left-out blocks: the corrected error is the noiseless one, and the choice follows the rule."""

from __future__ import annotations

import time

import numpy as np
import pytest
import torch
from regression.regressions import normal, problem, with_factors
from synthetic_regression import SETTINGS, Setting, draw, nmse
from torch import Tensor

from torchrbd.errors import InputError, OptionError
from torchrbd.regression import (
    EIVARD,
    BestRegression,
    Moments,
    OrdinaryLeastSquares,
    Regression,
    Stepwise,
    choose,
)


class Fixed(Regression):
    """Coefficients that no data changes."""

    name = "fixed"

    def __init__(self, b: Tensor) -> None:
        self.b = b

    def _coefficients(self, moments: Moments) -> Tensor:
        return self.b


def test_errors_are_those_of_refits() -> None:
    X, y = problem(10, n=60)
    moments = Moments.from_data(X, y, n_blocks=6)
    errors = choose([Stepwise(), OrdinaryLeastSquares()], moments).errors
    rows = torch.arange(60) // 10 == 4
    b = np.linalg.lstsq(X[~rows].numpy(), y[~rows].numpy())[0]
    left_out = np.mean((y[rows].numpy() - X[rows].numpy() @ b) ** 2) - np.mean(y[rows].numpy() ** 2)
    assert float(errors[4, 1]) == pytest.approx(left_out, rel=1e-6)


def test_rule_of_choice() -> None:
    X, b = normal(20, 1000, 4), normal(21, 4)
    moments = Moments.from_data(X, X @ b + normal(22, 1000))
    good, nearly, bad = Fixed(b), Fixed(b + 1e-4), Fixed(b + 1.0)
    assert choose([bad, good], moments).best.coefficients is b
    assert choose([good, bad], moments).best.coefficients is b
    assert choose([nearly, good, bad], moments).best.coefficients is nearly.b, "the preferred of two alike"
    assert choose([Fixed(b + 0.2), good], moments).best.coefficients is b, "no gain: fall back"
    assert choose([Fixed(b), Fixed(b + 0.05)], moments, caution=1e3).best.coefficients is not b


def test_candidates_are_not_changed() -> None:
    candidates = [Stepwise(), OrdinaryLeastSquares()]
    choose(candidates, Moments.from_data(*problem(30)))
    for candidate in candidates:
        with pytest.raises(InputError, match="no data yet"):
            _ = candidate.coefficients


@pytest.mark.parametrize("known", [False, True])
def test_default_without_input_noise_is_about_least_squares(known: bool) -> None:
    """Nothing to gain: 12 independent noiseless inputs that all matter."""
    ratios = []
    for seed in range(700, 706):
        X, b = normal(seed, 300, 12), normal(seed + 50, 12).sign()
        y = X @ b + normal(seed + 100, 300)
        found = BestRegression(torch.zeros(12) if known else None).fit(X, y).coefficients
        least = OrdinaryLeastSquares().fit(X, y).coefficients
        ratios.append(float((found - b).square().sum() / (least - b).square().sum()))
    assert np.mean(ratios) < 1.05


def test_default_says_what_it_chose() -> None:
    X, y, noise, _ = with_factors(40, 500, factors=3, shared=30, single=0, snr=2.0)
    fitted = BestRegression(noise).fit(X, y)
    assert fitted.choice.errors.shape == (10, 4)
    assert torch.equal(fitted.coefficients, fitted.choice.best.coefficients)
    assert torch.equal(fitted.noisy_coefficients, fitted.choice.best.noisy_coefficients)


def test_one_block_is_too_few() -> None:
    with pytest.raises(OptionError, match="2 or more blocks of moments, got 1"):
        BestRegression().fit(Moments.from_data(*problem(0), n_blocks=1))


def test_generator_is_that_of_the_experiment() -> None:
    problem = draw(Setting(30, 60, 2.0), columns=100, rows=20_000, seed=900)
    assert problem.clean.shape == (500, 100)
    signal = problem.X.var(0) - problem.input_noise
    assert torch.allclose(signal / problem.input_noise, torch.full((100,), 2.0).double(), rtol=0.15)
    shared = problem.clean[:, 10:40]
    explained = problem.clean[:, :10] @ torch.linalg.lstsq(problem.clean[:, :10], shared).solution
    assert torch.allclose(explained, shared, atol=1e-8)
    assert int(torch.linalg.matrix_rank(problem.clean)) == 70


@pytest.mark.slow
@pytest.mark.parametrize("setting", SETTINGS, ids=str)
def test_default_on_the_experiment(setting: Setting) -> None:
    """Seeds of neither development nor the published table."""
    errors = []
    for seed in range(5000, 5005):
        problem = draw(setting, columns=100, rows=1000, seed=seed)
        methods = (OrdinaryLeastSquares(), BestRegression(problem.input_noise), BestRegression())
        errors.append([nmse(method.fit(problem.X, problem.y), problem) for method in methods])
    least, known, unknown = np.mean(errors, axis=0)
    assert known < 1.05 * least
    assert unknown < 1.05 * least


@pytest.mark.slow
def test_a_thousand_inputs() -> None:
    problem = draw(SETTINGS[2], columns=1000, rows=3000, seed=5000)
    errors = []
    noise = problem.input_noise
    for method in (OrdinaryLeastSquares(), EIVARD(noise), BestRegression(noise), BestRegression()):
        start = time.process_time()
        errors.append(nmse(method.fit(problem.X, problem.y), problem))
        print(f"{method.name}: {time.process_time() - start:.1f} s, nMSE {errors[-1]:.4f}")
    assert max(errors[1:]) < errors[0]


ELSEWHERE = {
    "neighbours correlated": (0.9 ** (torch.arange(30).unsqueeze(1) - torch.arange(30)).abs()).double(),
    "independent": torch.eye(30, dtype=torch.float64),
    "factors and own parts": normal(1, 30, 5) @ normal(1, 30, 5).T + 0.5 * torch.eye(30, dtype=torch.float64),
    "collinear": normal(2, 30, 6) @ normal(2, 30, 6).T,
}


@pytest.mark.slow
@pytest.mark.parametrize("snr", [5.0, 1e12])
@pytest.mark.parametrize("design", ELSEWHERE)
def test_default_elsewhere(design: str, snr: float) -> None:
    """All inputs matter, and most designs are no factor model: nothing that the default's assumptions favour."""
    S, errors = ELSEWHERE[design], []
    value, vector = torch.linalg.eigh(S)
    root = vector * value.clamp_min(0.0).sqrt()
    for seed in range(6000, 6080, 10):
        clean, b = normal(seed, 1000, 30) @ root.T, normal(seed + 1, 30)
        noise, output = S.diagonal() / snr, clean @ b
        X = clean + noise.sqrt() * normal(seed + 2, 1000, 30)
        y = output + 0.45 * output.std() * normal(seed + 3, 1000)
        methods = (OrdinaryLeastSquares(), BestRegression(noise), BestRegression())
        found = [method.fit(X, y).coefficients - b for method in methods]
        errors.append([float(e @ S @ e / (b @ S @ b)) for e in found])
    least, known, unknown = np.mean(errors, axis=0)
    print(f"{design}, SNR {snr:g}: to OLS, noise given {known / least:.2f}, unknown {unknown / least:.2f}")
    assert known < 1.15 * least
    assert unknown < 1.15 * least


def test_inputs_that_are_all_noise_tell_nothing() -> None:
    generator = torch.Generator().manual_seed(8)
    X, y = torch.randn(300, 5, generator=generator).double(), torch.randn(300, generator=generator).double()
    fitted = BestRegression(torch.full((5,), 25.0, dtype=torch.float64)).fit(X, y)
    assert bool(torch.isfinite(fitted.coefficients).all())
