"""The noisy-input regression as users meet it: units, dead inputs, the paper's experiment, its state, bad input."""

from __future__ import annotations

import pytest
import torch
from regression.regressions import noisy_inputs, normal
from synthetic_regression import SETTINGS, Setting, draw, nmse

from torchrbd.errors import InputError, OptionError
from torchrbd.regression import Moments, NoiseRange, NoisyInputRegression, OrdinaryLeastSquares


def test_moments_data_and_units_give_the_same() -> None:
    X, y = noisy_inputs(51, n=300, d=5)
    from_data = NoisyInputRegression().fit(X, y)
    torch.testing.assert_close(
        NoisyInputRegression().fit(Moments.from_data(X, y, 3)).coefficients, from_data.coefficients
    )
    unit = torch.tensor([1e-3, 10.0, 1.0, 100.0, 0.1]).double()
    scaled = NoisyInputRegression().fit(X * unit, 7.0 * y)
    torch.testing.assert_close(scaled.coefficients, 7.0 * from_data.coefficients / unit, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(scaled.input_noise, from_data.input_noise * unit**2, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(scaled.output_noise, 49.0 * from_data.output_noise, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(from_data.predict(X), X @ from_data.coefficients)
    torch.testing.assert_close(from_data(X, noisy=True), X @ from_data.noisy_coefficients, rtol=1e-12, atol=1e-12)


def test_irrelevant_and_empty_inputs_die_without_dividing_by_zero() -> None:
    X, y = noisy_inputs(71, n=2000, d=3)
    y = y - y.mean()
    X = torch.cat((X, normal(72, 2000, 4), torch.zeros(2000, 1).double(), X[:, :1]), 1)
    fitted = NoisyInputRegression(tolerance=1e-8).fit(X, y)
    assert fitted.coefficients[3:8].tolist() == [0.0] * 5
    assert bool((fitted.coefficients[1:3] != 0.0).all())
    assert bool(fitted.coefficients.isfinite().all())
    everything_is_noise = NoisyInputRegression(input_noise=10.0).fit(X, y)
    assert everything_is_noise.coefficients.tolist() == [0.0] * 9
    assert bool(NoisyInputRegression().fit(X, torch.zeros_like(y)).coefficients.eq(0.0).all())


def test_fewer_rows_than_inputs() -> None:
    X, y = normal(81, 20, 40), normal(82, 20)
    for noise in (None, 0.2):
        b = NoisyInputRegression(input_noise=noise).fit(X, y).coefficients
        assert bool(b.isfinite().all())


def climb(options: dict, seed: int, setting: Setting, iterations: int) -> tuple[list[float], NoisyInputRegression]:
    """Return the error of the start and of each iterate."""
    drawn = draw(setting, columns=100, rows=1000, seed=seed)
    options = {key: drawn.input_noise if value == "known" else value for key, value in options.items()}
    model = NoisyInputRegression(**options).start(drawn.X, drawn.y)
    path = [model.coefficients]
    for _ in range(iterations):
        model.update()
        path.append(model.coefficients)
    errors = (drawn.output - torch.stack(path) @ drawn.clean.T).square().mean(1) / drawn.output.var()
    return errors.tolist(), model


@pytest.mark.parametrize("options", [{"input_noise": "known"}, {}], ids=["given", "learned"])
@pytest.mark.parametrize(
    ("setting", "iterations"),
    [(Setting(0, 90, 5.0), 100), *(pytest.param(s, 10_000, marks=pytest.mark.slow) for s in SETTINGS)],
)
def test_iterating_long_does_no_harm(options: dict, setting: Setting, iterations: int) -> None:
    errors, model = climb(options, 3, setting, iterations)
    alive = int((model.coefficients != 0.0).sum())
    print(f"start {errors[0]:.4f} best {min(errors):.4f} last {errors[-1]:.4f}, {alive} alive")
    assert alive >= 5
    assert errors[-1] <= 1.05 * min(errors)
    assert errors[-1] < 0.5


@pytest.mark.slow
def test_a_thousand_inputs() -> None:
    drawn = draw(Setting(490, 500, 5.0), columns=1000, rows=4000, seed=9)
    moments = Moments.from_data(drawn.X, drawn.y)
    errors = [nmse(method.fit(moments), drawn) for method in (NoisyInputRegression(), OrdinaryLeastSquares())]
    assert errors[0] < errors[1]


@pytest.mark.parametrize("options", [{}, {"input_noise": 0.16}, {"hidden_noise": None}], ids=["", "given", "hidden"])
def test_state_is_loaded_without_data(options: dict) -> None:
    """Alone, as a part of another module, and over other data with another number of inputs."""
    X, y = noisy_inputs(141, n=200, d=4)
    fitted = NoisyInputRegression(**options, iterations=30).fit(X, y)
    fresh = NoisyInputRegression(**options)
    fresh.load_state_dict(fitted.state_dict())
    nested = torch.nn.ModuleList([NoisyInputRegression(**options)])
    nested.load_state_dict(torch.nn.ModuleList([fitted]).state_dict())
    used = NoisyInputRegression(**options).fit(*noisy_inputs(142, n=50, d=2))
    used.load_state_dict(fitted.state_dict())
    for loaded in (fresh, nested[0], used):
        assert isinstance(loaded, NoisyInputRegression)
        for name in ("coefficients", "noisy_coefficients", "input_noise", "output_noise"):
            assert torch.equal(getattr(loaded, name), getattr(fitted, name)), name
        assert torch.equal(loaded.elbo(), fitted.elbo())
        assert torch.equal(loaded.predict(X), fitted.predict(X))
    fresh.update()
    fitted.update()
    assert torch.equal(fresh.coefficients, fitted.coefficients)


def test_state_of_another_form_is_refused() -> None:
    state = NoisyInputRegression(hidden_noise=None).fit(*noisy_inputs(151)).state_dict()
    with pytest.raises(RuntimeError, match="log_hidden_noise"):
        NoisyInputRegression().load_state_dict(state)


def test_wrong_input_is_refused() -> None:
    X, y = noisy_inputs(121)
    with pytest.raises(OptionError, match=r"input_noise has shape \(2,\), expected a number or \(3,\)"):
        NoisyInputRegression(input_noise=torch.ones(2)).fit(X, y)
    with pytest.raises(OptionError, match="output_noise is a variance"):
        NoisyInputRegression(output_noise=-1.0).fit(X, y)
    with pytest.raises(OptionError, match="low must not exceed high"):
        NoisyInputRegression(input_noise=NoiseRange(2.0, 1.0)).fit(X, y)
    with pytest.raises(OptionError, match="noise_share must be above 0"):
        NoisyInputRegression(noise_share=0.5)
    with pytest.raises(OptionError, match="'coordinate' or 'autograd'"):
        NoisyInputRegression().fit(X, y, method="em")  # type: ignore[arg-type]
    moments = Moments.from_data(X, y)
    with pytest.raises(InputError, match="moments must be finite"):
        NoisyInputRegression().fit(Moments(moments.blocks * torch.nan, moments.count))
    with pytest.raises(InputError, match="call fit"):
        _ = NoisyInputRegression().coefficients
    with pytest.raises(InputError, match="y is missing"):
        NoisyInputRegression().start(X)
