"""Both ways up the noisy-input model's bound: it never falls, and both end at the same place."""

from __future__ import annotations

import pytest
import torch
from regression.regressions import noisy_inputs
from synthetic_regression import Setting, draw
from torch import Tensor

from torchrbd.regression.noisy_input import NoiseRange, NoisyInputRegression
from torchrbd.regression.noisy_input.ascent import climb_by_gradient


def bound_of(model: NoisyInputRegression) -> float:
    return float(model.elbo().detach())


def forms(noise: Tensor) -> dict[str, dict]:
    return {
        "given": {"input_noise": noise},
        "learned": {},
        "hidden learned": {"hidden_noise": None},
        "hidden given": {"input_noise": noise, "hidden_noise": 0.01},
        "from below": {"input_noise": NoiseRange(low=noise)},
        "between": {"input_noise": NoiseRange(low=noise, high=3.0 * noise), "output_noise": NoiseRange(high=0.3)},
    }


FORMS = list(forms(torch.zeros(1)))


@pytest.mark.parametrize("form", FORMS)
def test_bound_never_falls(form: str) -> None:
    for seed in range(6):
        d = 2 + seed % 7
        X, y = noisy_inputs(seed + 50, n=20 + 15 * seed, d=d)
        X = X * torch.logspace(-3, 3, d).double()
        noise = (0.4 * torch.logspace(-3, 3, d).double()) ** 2
        history = NoisyInputRegression(**forms(noise)[form], iterations=60, tolerance=-1.0).fit(X, y).history
        assert len(history) == 61
        assert float(history.diff().min()) > -1e-10 * float(history.abs().max())


@pytest.mark.parametrize(
    ("form", "d"),
    [
        *((form, 6) for form in FORMS),
        *(pytest.param(form, 100, marks=pytest.mark.slow) for form in FORMS if form != "between"),
    ],
)
def test_both_methods_reach_the_same_bound(form: str, d: int) -> None:
    if d == 100:
        drawn = draw(Setting(30, 60, 5.0), columns=100, rows=1000, seed=7)
        X, y, noise = drawn.X, drawn.y, drawn.input_noise
    else:
        X, y = noisy_inputs(21, n=200, d=d)
        noise = torch.full((d,), 0.16).double()
    options = {**forms(noise)[form], "iterations": 20_000}
    by_coordinates = NoisyInputRegression(**options, tolerance=1e-9).fit(X, y)
    by_gradient = NoisyInputRegression(**options, tolerance=1e-10).fit(X, y, method="autograd")
    assert by_coordinates.converged
    assert by_gradient.converged
    assert bound_of(by_gradient) == pytest.approx(bound_of(by_coordinates), abs=1e-4)
    torch.testing.assert_close(by_gradient.coefficients, by_coordinates.coefficients, rtol=0.0, atol=1e-3)
    assert float(by_coordinates.history[-1]) == pytest.approx(bound_of(by_coordinates), rel=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [7, 8, 9, 10])
def test_with_noise_between_bounds_either_method_stays_where_the_other_ends(seed: int) -> None:
    """There the bound of 100 inputs has several maxima, about one nat apart: which one is reached may differ."""
    drawn = draw(Setting(30, 60, 5.0), columns=100, rows=1000, seed=seed)
    options = {**forms(drawn.input_noise)["between"], "iterations": 20_000, "tolerance": 1e-10}
    ends = {m: NoisyInputRegression(**options).fit(drawn.X, drawn.y, method=m) for m in ("coordinate", "autograd")}
    assert bound_of(ends["autograd"]) == pytest.approx(bound_of(ends["coordinate"]), abs=5.0)
    by_coordinates, by_gradient = (NoisyInputRegression(**options) for _ in ends)
    by_coordinates.load_state_dict(ends["autograd"].state_dict())
    by_gradient.load_state_dict(ends["coordinate"].state_dict())
    for _ in range(2000):
        by_coordinates.update()
    climb_by_gradient(by_gradient._data, by_gradient._priors, by_gradient.q, iterations=2000, tolerance=1e-10)
    assert bound_of(by_coordinates) == pytest.approx(bound_of(ends["autograd"]), abs=1e-4)
    assert bound_of(by_gradient) == pytest.approx(bound_of(ends["coordinate"]), abs=1e-4)


@pytest.mark.parametrize("form", ["given", "learned", "hidden learned"])
def test_coordinate_updates_end_where_the_gradient_vanishes(form: str) -> None:
    X, y = noisy_inputs(31, n=60, d=4)
    fitted = NoisyInputRegression(**forms(torch.full((4,), 0.16).double())[form], iterations=5000, tolerance=1e-12)
    fitted.fit(X, y)
    gradient = torch.autograd.grad(fitted.elbo(), [p for p in fitted.parameters() if p.requires_grad])
    assert max(float(g.abs().max()) for g in gradient) < 1e-3
    moved = NoisyInputRegression(**forms(torch.full((4,), 0.16).double())[form]).start(X, y)
    gradient = torch.autograd.grad(moved.elbo(), [p for p in moved.parameters() if p.requires_grad])
    assert max(float(g.abs().max()) for g in gradient) > 0.1


def test_any_optimizer_can_climb() -> None:
    X, y = noisy_inputs(41, n=80)
    expected = NoisyInputRegression(iterations=5000, tolerance=1e-9).fit(X, y)
    model = NoisyInputRegression().start(X, y)
    optimizer = torch.optim.LBFGS(model.parameters(), max_iter=400, line_search_fn="strong_wolfe", history_size=30)

    def closure() -> Tensor:
        optimizer.zero_grad()
        loss = -model.elbo()
        loss.backward()
        return loss

    optimizer.step(closure)
    assert bound_of(model) == pytest.approx(bound_of(expected), abs=1e-2)


@pytest.mark.parametrize("form", ["given", "learned", "between"])
def test_noise_stays_where_it_was_put(form: str) -> None:
    X, y = noisy_inputs(61, n=200, d=4)
    noise = torch.tensor([0.16, 0.1, 0.2, 0.16]).double()
    for method in ("coordinate", "autograd"):
        psi = NoisyInputRegression(**forms(noise)[form]).fit(X, y, method=method).input_noise
        if form == "given":
            torch.testing.assert_close(psi, noise)
        elif form == "between":
            assert bool((psi >= noise * (1 - 1e-12)).all() & (psi <= 3.0 * noise * (1 + 1e-12)).all())
        else:
            assert bool((psi > 0.0).all() & (psi < X.square().mean(0)).all())


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"input_noise": "known"}, {}], ids=["given", "learned"])
def test_bound_never_falls_in_ten_thousand_iterations(options: dict) -> None:
    drawn = draw(Setting(60, 30, 2.0), columns=100, rows=1000, seed=8)
    options = {key: drawn.input_noise for key in options}
    history = NoisyInputRegression(**options, iterations=10_000, tolerance=-1.0).fit(drawn.X, drawn.y).history
    assert len(history) == 10_001
    assert float(history.diff().min()) > -1e-12 * float(history.abs().max())
