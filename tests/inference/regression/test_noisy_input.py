"""The paper's noisy-input model: its bound against dense integration, its updates, its limits."""

import math

import pytest
import torch
from torch import Tensor
from torch.distributions import Gamma, InverseGamma, Normal, kl_divergence

from torchrbd.errors import InputError, OptionError
from torchrbd.inference.regression.moments import Moments
from torchrbd.inference.regression.noisy_input import NoiseRange, NoisyInputRegression
from torchrbd.inference.regression.noisy_input.elbo import (
    Evidence,
    NoisePrior,
    Posterior,
    Priors,
    collapse,
    elbo,
)

SETTINGS = [(r, u, snr) for r, u in ((90, 0), (0, 90), (30, 60), (60, 30)) for snr in (2.0, 5.0)]


def normal(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def experiment(redundant: int, irrelevant: int, snr: float, seed: int, n: int = 1000, test: int = 500):
    """Return X, y, noiseless test X and y, and the input noise variances of the paper's synthetic experiment."""
    T, b, R = normal(n + test, 10, seed=seed), normal(10, seed=seed + 10_000), normal(10, redundant, seed=seed + 20_000)
    X = torch.cat((T, T @ R / 10**0.5, normal(n + test, irrelevant, seed=seed + 30_000)), 1)
    y = T @ b
    noise = X[:n].var(0) / snr
    noisy = X[:n] + noise.sqrt() * normal(n, X.shape[1], seed=seed + 40_000)
    y_noisy = y[:n] + (y[:n].var() / 5.0).sqrt() * normal(n, seed=seed + 50_000)
    return noisy, y_noisy, X[n:], y[n:], noise


def nmse(b: Tensor, X: Tensor, y: Tensor) -> float:
    return float((y - X @ b).square().mean() / y.var())


def small(seed: int, n: int = 60, d: int = 3) -> tuple[Tensor, Tensor]:
    T = normal(n, d, seed=seed)
    y = T @ normal(d, seed=seed + 1) + 0.5 * normal(n, seed=seed + 2)
    return T + 0.4 * normal(n, d, seed=seed + 3), y


def random_posterior(d: int, seed: int, *, merged: bool) -> Posterior:
    positive = normal(5, d, seed=seed).mul(0.7).exp()
    x_mean, z_mean = normal(2, d, seed=seed + 1)
    hidden = None if merged else 0.2 * positive[4]
    return Posterior(x_mean, positive[0], z_mean, positive[1], positive[2], positive[3], hidden, positive[4, 0])


def bound_of(model: NoisyInputRegression) -> float:
    return float(model.elbo().detach())


PRIORS = Priors(0.7, 0.4, NoisePrior(1.5, 0.2), NoisePrior(1.2, 0.3), NoisePrior(2.5, 0.1))


def dense_elbo(X: Tensor, y: Tensor, s: Posterior) -> Tensor:
    """Integrate exp E_q(w)[log p(y, x, z, t | w)] over z and t row by row, as a Gaussian of 2 d (or d) dimensions."""
    d = X.shape[1]
    total = X.new_zeros(())
    xx, zz = s.x_mean**2 + s.x_var, s.z_mean**2 + s.z_var
    for x, target in zip(X, y, strict=True):
        if s.hidden_noise is None:
            A = torch.diag(1.0 + xx / s.input_noise + s.z_var / s.output_noise)
            A = A + torch.outer(s.z_mean, s.z_mean) / s.output_noise
            b = s.x_mean * x / s.input_noise + s.z_mean * target / s.output_noise
            constant = -0.5 * d * math.log(2.0 * math.pi)
        else:
            to_z = torch.diag(-s.z_mean / s.hidden_noise)
            of_z = torch.diag(1.0 / s.hidden_noise) + torch.ones(d, d).double() / s.output_noise
            of_t = torch.diag(1.0 + xx / s.input_noise + zz / s.hidden_noise)
            A = torch.cat((torch.cat((of_z, to_z), 1), torch.cat((to_z, of_t), 1)), 0)
            b = torch.cat((torch.ones(d).double() * target / s.output_noise, s.x_mean * x / s.input_noise))
            constant = -d * math.log(2.0 * math.pi) - 0.5 * s.hidden_noise.log().sum()
        constant = constant - 0.5 * (2.0 * math.pi * s.output_noise).log() - 0.5 * target**2 / s.output_noise
        constant = constant - 0.5 * ((2.0 * math.pi * s.input_noise).log() + x**2 / s.input_noise).sum()
        integral = 0.5 * (len(b) * math.log(2.0 * math.pi) - torch.logdet(A) + b @ torch.linalg.solve(A, b))
        total = total + constant + integral
    return total


def dense_divergence(s: Posterior) -> Tensor:
    """KL of q(w) q(alpha), from torch.distributions; E_q(alpha) of log N(w; 0, 1/alpha) by hand."""
    q_alpha = Gamma(torch.full_like(s.rate, PRIORS.shape + 1.0), s.rate)
    divergence = kl_divergence(
        q_alpha, Gamma(torch.tensor(PRIORS.shape, dtype=torch.float64), torch.tensor(PRIORS.rate, dtype=torch.float64))
    )
    mean_log = torch.digamma(q_alpha.concentration) - s.rate.log()
    for mean, var in ((s.x_mean, s.x_var), (s.z_mean, s.z_var)):
        expected = 0.5 * (mean_log - math.log(2.0 * math.pi) - q_alpha.mean * (mean**2 + var))
        divergence = divergence - expected - Normal(mean, var.sqrt()).entropy()
    return divergence.sum()


def log_inverse_gamma(psi: Tensor, prior: NoisePrior) -> Tensor:
    distribution = InverseGamma(
        torch.tensor(prior.shape, dtype=torch.float64), torch.tensor(prior.scale, dtype=torch.float64)
    )
    return distribution.log_prob(psi).sum()


@pytest.mark.parametrize("merged", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_bound_is_that_of_dense_integration(merged: bool, seed: int) -> None:
    X, y = small(seed, n=7)
    s = random_posterior(3, seed + 100, merged=merged)
    expected = dense_elbo(X, y, s) - dense_divergence(s)
    expected = expected + log_inverse_gamma(s.input_noise, NoisePrior(1.5, 0.2))
    expected = expected + log_inverse_gamma(s.output_noise, NoisePrior(2.5, 0.1))
    if s.hidden_noise is not None:
        expected = expected + log_inverse_gamma(s.hidden_noise, NoisePrior(1.2, 0.3))
    moments = Moments.from_data(X, y)
    got = elbo(Evidence(moments.xx, moments.xy, moments.yy, moments.n), PRIORS, s)
    assert float(got) == pytest.approx(float(expected), rel=1e-11)


@pytest.mark.parametrize("merged", [True, False])
def test_bound_gradient(merged: bool) -> None:
    X, y = small(11, n=9)
    moments = Moments.from_data(X, y)
    evidence = Evidence(moments.xx, moments.xy, moments.yy, moments.n)
    s = random_posterior(3, 12, merged=merged)
    fields = (s.x_mean, s.x_var, s.z_mean, s.z_var, s.rate, s.input_noise, s.output_noise)
    fields = fields if s.hidden_noise is None else (*fields, s.hidden_noise)

    def value(*v: Tensor) -> Tensor:
        return elbo(
            evidence, PRIORS, Posterior(v[0], v[1], v[2], v[3], v[4], v[5], v[7] if len(v) == 8 else None, v[6])
        )

    assert torch.autograd.gradcheck(value, [f.clone().requires_grad_() for f in fields])


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
        X, y = small(seed + 50, n=20 + 15 * seed, d=d)
        X = X * torch.logspace(-3, 3, d).double()
        noise = (0.4 * torch.logspace(-3, 3, d).double()) ** 2
        history = NoisyInputRegression(**forms(noise)[form], iterations=60, tolerance=-1.0).fit(X, y).history
        assert len(history) == 61
        assert float(history.diff().min()) > -1e-10 * float(history.abs().max())


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("d", [6, pytest.param(100, marks=pytest.mark.slow)])
def test_both_methods_reach_the_same_bound(form: str, d: int) -> None:
    if d == 100:
        X, y, _, _, noise = experiment(30, 60, 5.0, seed=7)
    else:
        X, y = small(21, n=200, d=d)
        noise = torch.full((d,), 0.16).double()
    options = {**forms(noise)[form], "iterations": 20_000}
    by_coordinates = NoisyInputRegression(**options, tolerance=1e-9).fit(X, y)
    by_gradient = NoisyInputRegression(**options, tolerance=1e-10).fit(X, y, method="autograd")
    assert by_coordinates.converged
    assert by_gradient.converged
    assert bound_of(by_gradient) == pytest.approx(bound_of(by_coordinates), abs=1e-4)
    torch.testing.assert_close(by_gradient.coefficients, by_coordinates.coefficients, rtol=0.0, atol=1e-3)
    assert float(by_coordinates.history[-1]) == pytest.approx(bound_of(by_coordinates), rel=1e-13)


@pytest.mark.parametrize("form", ["given", "learned", "hidden learned"])
def test_coordinate_updates_end_where_the_gradient_vanishes(form: str) -> None:
    X, y = small(31, n=60, d=4)
    fitted = NoisyInputRegression(**forms(torch.full((4,), 0.16).double())[form], iterations=5000, tolerance=1e-12)
    fitted.fit(X, y)
    gradient = torch.autograd.grad(fitted.elbo(), [p for p in fitted.parameters() if p.requires_grad])
    assert max(float(g.abs().max()) for g in gradient) < 1e-3
    moved = NoisyInputRegression(**forms(torch.full((4,), 0.16).double())[form]).start(X, y)
    gradient = torch.autograd.grad(moved.elbo(), [p for p in moved.parameters() if p.requires_grad])
    assert max(float(g.abs().max()) for g in gradient) > 0.1


def test_any_optimizer_can_climb() -> None:
    X, y = small(41, n=80)
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


def test_moments_data_and_units_give_the_same() -> None:
    X, y = small(51, n=300, d=5)
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


@pytest.mark.parametrize("form", ["given", "learned", "between"])
def test_noise_stays_where_it_was_put(form: str) -> None:
    X, y = small(61, n=200, d=4)
    noise = torch.tensor([0.16, 0.1, 0.2, 0.16]).double()
    for method in ("coordinate", "autograd"):
        psi = NoisyInputRegression(**forms(noise)[form]).fit(X, y, method=method).input_noise
        if form == "given":
            torch.testing.assert_close(psi, noise)
        elif form == "between":
            assert bool((psi >= noise * (1 - 1e-12)).all() & (psi <= 3.0 * noise * (1 + 1e-12)).all())
        else:
            assert bool((psi > 0.0).all() & (psi < X.square().mean(0)).all())


def test_irrelevant_and_empty_inputs_die_without_dividing_by_zero() -> None:
    X, y = small(71, n=2000, d=3)
    y = y - y.mean()
    X = torch.cat((X, normal(2000, 4, seed=72), torch.zeros(2000, 1).double(), X[:, :1]), 1)
    fitted = NoisyInputRegression(tolerance=1e-8).fit(X, y)
    assert fitted.coefficients[3:8].tolist() == [0.0] * 5
    assert bool((fitted.coefficients[1:3] != 0.0).all())
    assert bool(fitted.coefficients.isfinite().all())
    everything_is_noise = NoisyInputRegression(input_noise=10.0).fit(X, y)
    assert everything_is_noise.coefficients.tolist() == [0.0] * 9
    assert bool(NoisyInputRegression().fit(X, torch.zeros_like(y)).coefficients.eq(0.0).all())


def test_fewer_rows_than_inputs() -> None:
    X, y = normal(20, 40, seed=81), normal(20, seed=82)
    for noise in (None, 0.2):
        b = NoisyInputRegression(input_noise=noise).fit(X, y).coefficients
        assert bool(b.isfinite().all())


# What the likelihood cannot identify.


def point_weights(c: Tensor, rho: Tensor, S: Tensor) -> Posterior:
    """Return weights without uncertainty with noisy-query coefficients c and residual variance S."""
    psi_x, nearly_none = 1.0 - rho, torch.full_like(c, 1e-30)
    output = S - (c.square() * psi_x / rho).sum()
    return Posterior(rho.sqrt(), nearly_none, c / rho.sqrt(), nearly_none, torch.ones_like(c), psi_x, None, output)


def evidence_of(X: Tensor, y: Tensor) -> Evidence:
    X, y = X / X.square().mean(0).sqrt(), y / y.square().mean().sqrt()
    moments = Moments.from_data(X, y)
    return Evidence(moments.xx, moments.xy, moments.yy, moments.n)


def log_likelihood(evidence: Evidence, s: Posterior) -> Tensor:
    """The bound's part that depends on the data; exact for weights without uncertainty."""
    none = Priors(1.0, 1.0, None, None, None)
    return elbo(evidence, none, s) - elbo(Evidence(evidence.xx, evidence.xy, evidence.yy, 0.0), none, s)


def test_likelihood_is_flat_in_rho_until_output_noise_is_used_up() -> None:
    evidence = evidence_of(*small(91, n=500, d=4))
    c = torch.linalg.solve(evidence.xx, evidence.xy)
    S = evidence.yy - c @ evidence.xy
    reference = point_weights(c, torch.full((4,), 0.98).double(), S)
    for seed in range(20):
        rho = 0.9 + 0.09 * torch.rand(4, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        s = point_weights(c, rho, S)
        assert float(s.output_noise) > 0.0
        assert float(log_likelihood(evidence, s)) == pytest.approx(float(log_likelihood(evidence, reference)), abs=1e-8)
        b = s.z_mean / s.x_mean
        torch.testing.assert_close(b, c / rho)
    assert float(point_weights(c, torch.full((4,), 0.02).double(), S).output_noise) < 0.0


def test_noisy_query_likelihood_is_highest_at_least_squares() -> None:
    evidence = evidence_of(*small(101, n=500, d=4))
    ols = torch.linalg.solve(evidence.xx, evidence.xy)
    c = ols.clone().requires_grad_()
    S = (evidence.yy - ols @ evidence.xy).requires_grad_()
    rho = torch.full((4,), 0.97).double().requires_grad_()
    gradient = torch.autograd.grad(log_likelihood(evidence, point_weights(c, rho, S)), (c, S, rho))
    assert max(float(g.abs().max()) for g in gradient) < 1e-7
    best = float(log_likelihood(evidence, point_weights(ols, rho.detach(), S.detach())))
    for seed in range(5):
        moved = point_weights(ols + 0.01 * normal(4, seed=seed), rho.detach(), S.detach())
        assert float(log_likelihood(evidence, moved)) < best


def test_given_noise_is_right_for_independent_and_wrong_for_redundant_inputs() -> None:
    n, d, snr = 200_000, 5, 2.0
    T, b = normal(n, d, seed=111), normal(d, seed=112)
    y = T @ b + 0.3 * normal(n, seed=113)
    noise = torch.full((d,), 1.0 / snr).double()
    independent = NoisyInputRegression(input_noise=noise).fit(T + noise.sqrt() * normal(n, d, seed=114), y)
    torch.testing.assert_close(independent.coefficients, b, rtol=0.0, atol=0.02)
    ols = NoisyInputRegression(noise_share=1e-4).fit(T + noise.sqrt() * normal(n, d, seed=114), y)
    assert nmse(ols.coefficients, T, T @ b) > 20.0 * nmse(independent.coefficients, T, T @ b)
    # Twenty noisy copies of one input: together they are nearly noiseless, and 1 / rho = 1.5 is too much.
    copies = T[:20_000, :1].expand(-1, 20)
    X = copies + (1.0 / snr) ** 0.5 * normal(20_000, 20, seed=115)
    given = NoisyInputRegression(input_noise=1.0 / snr).fit(X, T[:20_000, 0]).coefficients
    least_squares = torch.linalg.lstsq(X, T[:20_000, 0]).solution
    assert float(least_squares.sum()) == pytest.approx(1.0, abs=0.05)
    assert float(given.sum()) > 1.2


# The paper's synthetic experiment.


def climb(options: dict, seed: int, setting: tuple, iterations: int) -> tuple[list[float], NoisyInputRegression]:
    """Return the error of the start and of each iterate."""
    X, y, X_test, y_test, noise = experiment(*setting, seed=seed)
    options = {key: noise if value == "known" else value for key, value in options.items()}
    model = NoisyInputRegression(**options).start(X, y)
    path = [model.coefficients]
    for _ in range(iterations):
        model.update()
        path.append(model.coefficients)
    errors = (y_test - torch.stack(path) @ X_test.T).square().mean(1) / y_test.var()
    return errors.tolist(), model


@pytest.mark.parametrize("options", [{"input_noise": "known"}, {}], ids=["given", "learned"])
@pytest.mark.parametrize(
    ("setting", "iterations"),
    [((0, 90, 5.0), 100), *(pytest.param(s, 10_000, marks=pytest.mark.slow) for s in SETTINGS)],
)
def test_iterating_long_does_no_harm(options: dict, setting: tuple, iterations: int) -> None:
    errors, model = climb(options, 3, setting, iterations)
    alive = int((model.coefficients != 0.0).sum())
    print(f"start {errors[0]:.4f} best {min(errors):.4f} last {errors[-1]:.4f}, {alive} alive")
    assert alive >= 5
    assert errors[-1] <= 1.05 * min(errors)
    assert errors[-1] < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"input_noise": "known"}, {}], ids=["given", "learned"])
def test_bound_never_falls_in_ten_thousand_iterations(options: dict) -> None:
    X, y, _, _, noise = experiment(60, 30, 2.0, seed=8)
    options = {key: noise for key in options}
    history = NoisyInputRegression(**options, iterations=10_000, tolerance=-1.0).fit(X, y).history
    assert len(history) == 10_001
    assert float(history.diff().min()) > -1e-12 * float(history.abs().max())


@pytest.mark.slow
def test_a_thousand_inputs() -> None:
    X, y, X_test, y_test, _ = experiment(490, 500, 5.0, seed=9, n=4000)
    moments = Moments.from_data(X, y)
    fitted = NoisyInputRegression().fit(moments)
    ols = torch.linalg.solve(moments.xx, moments.xy)
    assert nmse(fitted.coefficients, X_test, y_test) < nmse(ols, X_test, y_test)


# Input that cannot be used.


def test_wrong_input_is_refused() -> None:
    X, y = small(121)
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
    with pytest.raises(TypeError, match="y is missing"):
        NoisyInputRegression().fit(X)


def test_collapsed_coefficients_are_a_least_squares_fit_where_noise_is_small() -> None:
    X, y = small(131, n=5000)
    fitted = NoisyInputRegression(noise_share=1e-4, tolerance=1e-9).fit(X, y)
    ols = torch.linalg.lstsq(X, y).solution
    torch.testing.assert_close(fitted.noisy_coefficients, ols, rtol=0.0, atol=2e-3)
    assert bool(collapse(fitted._data, fitted.posterior).S > 0.0)
