"""Check what is learnt of coloured noise against its simulation, and drift's basis."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import multivariate_t, norm
from scipy.stats import t as student_t

from torchrbd.likelihood.noise import Noise, learnt, order_cost, predicted, predictors, tailed
from torchrbd.nuisance.drift import drift_basis

COEFFICIENTS = np.array([1.2, -0.5])


def coloured(seed: int, n: int, a: np.ndarray = COEFFICIENTS, sigma: float = 0.3) -> np.ndarray:
    e = sigma * np.random.default_rng(seed).normal(size=n + 500)
    return lfilter([1.0], np.concatenate(([1.0], -a)), e)[500:]


def of(e: np.ndarray, measured: np.ndarray | None = None, **options) -> Noise:
    n = len(e)
    given = {"spread": np.ones(n), "run": np.zeros(n), "used": 0.0, "dispersion": 1.0, **options}
    index = predicted(given["run"], np.ones(n, bool) if measured is None else measured)
    return learnt(e, index, **given)


def noise_of(noise: Noise, run: np.ndarray) -> Noise:
    """Return the same noise of other rows."""
    return Noise(predicted(run, np.ones(len(run), bool)), noise.predictor, noise.sigma, np.ones(len(run)))


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_is_found_white(seed: int) -> None:
    noise = of(coloured(seed, 5000, np.zeros(0)))
    assert len(noise.predictor) <= 1
    assert noise.sigma == pytest.approx(0.3, rel=0.03)


@pytest.mark.parametrize("seed", range(5))
def test_order_and_coefficients_of_an_autoregression_are_found(seed: int) -> None:
    noise = of(coloured(seed, 20_000))
    assert 2 <= len(noise.predictor) <= 4
    np.testing.assert_allclose(noise.predictor[:2], COEFFICIENTS, atol=0.05)
    np.testing.assert_allclose(noise.predictor[2:], 0.0, atol=0.05)
    assert noise.sigma == pytest.approx(0.3, rel=0.02)


def test_innovations_are_white_and_of_unit_variance() -> None:
    runs = [coloured(k, n) for k, n in enumerate((3000, 1, 7000, 2, 40, 4000))]
    e, run = np.concatenate(runs), np.repeat(np.arange(6), [len(r) for r in runs])
    noise = of(e, run=run)
    u = noise.white(e)
    assert u.var() == pytest.approx(1.0, rel=0.03)
    for lag in range(1, 6):
        assert abs(np.mean(u[lag:] * u[:-lag])) < 0.03
    assert len(u) == sum(max(0, len(r) - 16) for r in runs)
    alone = [noise_of(noise, np.zeros(len(r))).white(r) for r in runs if len(r) > 16]
    np.testing.assert_allclose(u, np.concatenate(alone))


def test_recording_without_torque_is_left_out() -> None:
    """What lies in rows that are not measured changes neither the noise nor the rows."""
    e = np.concatenate((coloured(0, 4000), np.full(3000, 1e6), coloured(1, 4000)))
    run = np.repeat([0, 1, 2], [4000, 3000, 4000])
    measured = run != 1
    # What is not measured holds zeros, as rows have it.
    noise, kept = of(np.where(measured, e, 0.0), measured, run=run), of(e[measured], run=run[measured])
    assert (run[noise.index] != 1).all()
    assert noise.sigma == pytest.approx(kept.sigma)
    np.testing.assert_allclose(noise.predictor, kept.predictor)
    np.testing.assert_allclose(noise.white(e), kept.white(e[measured]))


def test_rows_that_are_noisier_count_less() -> None:
    n = 20_000
    scale = 1.0 + 0.9 * np.sin(np.arange(n) / 500.0)
    e = scale * coloured(3, n)
    noise = of(e, spread=scale)
    np.testing.assert_allclose(noise.predictor[:2], COEFFICIENTS, atol=0.05)
    u = noise.white(e)
    large = scale[-len(u) :] > 1.0
    assert u[large].var() == pytest.approx(1.0, rel=0.05)
    assert u[~large].var() == pytest.approx(1.0, rel=0.05)


def test_signals_are_whitened_one_by_one_as_together() -> None:
    rng = np.random.default_rng(4)
    index = predicted(np.repeat([0, 1], 25), np.ones(50, bool))
    noise, A = Noise(index, COEFFICIENTS, 0.3, rng.uniform(0.5, 2.0, 50)), rng.normal(size=(3, 2, 50))
    got = noise.white(A)
    for i in range(3):
        for k in range(2):
            u, s = A[i, k], 0.3 * noise.spread
            one = [(u[m] - COEFFICIENTS[0] * u[m - 1] - COEFFICIENTS[1] * u[m - 2]) / s[m] for m in index]
            np.testing.assert_allclose(got[i, k], one)


def test_correlation_is_that_of_the_autoregression() -> None:
    e = coloured(8, 400_000, sigma=1.0)
    none = np.zeros(0, int)
    got = Noise(none, COEFFICIENTS, 1.0, np.ones(1)).correlation
    np.testing.assert_allclose(got, [np.mean(e[k:] * e[: len(e) - k]) for k in range(3)], rtol=0.03)
    np.testing.assert_allclose(Noise(none, np.zeros(0), 1.0, np.ones(1)).correlation, [1.0])
    assert Noise(none, COEFFICIENTS, 0.3, np.ones(1)).std == pytest.approx(0.3 * e.std(), rel=0.02)


def test_rows_that_err_more_for_a_while_are_learnt_as_such() -> None:
    """The likelihood tells how much noisier the rows of a stretch are; evidence is against all being alike."""
    n = 20_000
    inside = np.arange(n) % 400 < 80
    scale = np.where(inside, 3.0, 1.0)
    e = lfilter([1.0], np.concatenate(([1.0], -COEFFICIENTS)), 0.3 * scale * np.random.default_rng(10).normal(size=n))
    found = {x: of(e, spread=np.where(inside, x, 1.0)).surprise for x in (1.0, 2.0, 3.0, 4.5)}
    assert min(found, key=found.get) == 3.0
    assert found[1.0] > found[3.0] + 100


def test_surprise_is_the_log_density_but_for_half_the_squares() -> None:
    """Of white noise: each row has standard deviation sigma s."""
    rng, index = np.random.default_rng(11), np.arange(20, 50)
    noise, e = Noise(index, np.zeros(0), 0.3, rng.uniform(0.5, 2.0, 50)), rng.normal(size=50)
    u = noise.white(e)
    expected = -norm.logpdf(e[index], scale=0.3 * noise.spread[index]).sum()
    assert noise.surprise + 0.5 * u @ u + 15 * np.log(2 * np.pi) == pytest.approx(expected)


def test_degrees_of_freedom_and_dispersion_raise_the_variance() -> None:
    e = coloured(5, 4000)
    plain = of(e)
    assert of(e, used=0.25 * (4000 - 16)).sigma == pytest.approx(plain.sigma / np.sqrt(0.75))
    assert of(e, dispersion=4.0).sigma == pytest.approx(2.0 * plain.sigma)
    assert of(e, dispersion=0.1).sigma == pytest.approx(plain.sigma)


@pytest.mark.parametrize("unit", [1e-6, 1e5])
def test_predictor_does_not_depend_on_the_unit(unit: float) -> None:
    e = coloured(6, 4000)
    np.testing.assert_allclose(of(unit * e).predictor, of(e).predictor, rtol=1e-9)
    assert of(unit * e).sigma == pytest.approx(unit * of(e).sigma)


def test_no_error_at_all_is_allowed() -> None:
    noise = of(np.zeros(100))
    assert np.isfinite(noise.predictor).all()
    assert noise.sigma > 0
    assert len(of(np.zeros(0)).predictor) == 0


def test_predictors_are_those_of_the_noise_whatever_the_runs() -> None:
    runs = [coloured(k, n) for k, n in enumerate((9000, 1, 40, 15_000))]
    run = np.repeat(np.arange(4), [len(r) for r in runs])
    orders = list(predictors(np.concatenate(runs), run, 6))
    assert [len(a) for a, _ in orders] == list(range(7))
    np.testing.assert_allclose(orders[2][0], COEFFICIENTS, atol=0.02)
    for a, _ in orders[1:]:
        assert (np.abs(np.roots(np.concatenate(([1.0], -a)))) < 1.0).all()
    e, inside = np.concatenate(runs), np.arange(len(run)) >= 6
    inside[6:] &= run[6:] == run[:-6]
    a, error = orders[6]
    expected = e[inside] - sum(a[i] * e[np.flatnonzero(inside) - i - 1] for i in range(6))
    np.testing.assert_allclose(error[inside], expected, atol=1e-12)


def test_predictors_of_short_signals_are_those_of_least_squares_forwards_and_backwards() -> None:
    """A strong resonance in few samples, which the autocovariance's own estimate smears."""
    a = np.array([1.8, -0.97])
    e = coloured(3, 60, a)
    ((*_, (found, _)),) = [list(predictors(e, np.zeros(60), 2))]
    X = np.concatenate((np.stack((e[1:-1], e[:-2]), 1), np.stack((e[1:-1], e[2:]), 1)))
    expected = np.linalg.lstsq(X, np.concatenate((e[2:], e[:-2])), rcond=None)[0]
    np.testing.assert_allclose(found, expected, atol=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_that_is_chosen_is_that_of_the_greatest_evidence(seed: int) -> None:
    """Were orders not paid for in the same currency, a model would win by the order alone."""
    e = coloured(seed, 3000, np.array([1.2, -0.5, 0.0, 0.08]))
    chosen = of(e)

    def evidence(a: np.ndarray) -> float:
        sigma = np.sqrt(np.mean(Noise(chosen.index, a, 1.0, np.ones(len(e))).white(e) ** 2))
        return -Noise(chosen.index, a, sigma, np.ones(len(e))).surprise - 0.5 * len(chosen.index)

    best = max(evidence(a) for a, _ in predictors(e, np.zeros(len(e)), 16))
    assert evidence(chosen.predictor) == pytest.approx(best, abs=1e-6)


def test_drift_is_a_level_and_cosines_of_each_recording() -> None:
    t = np.concatenate((np.arange(0.0, 20.0, 0.1), 5.0 + np.arange(0.0, 2.0, 0.1)))
    recording = np.repeat([0, 3], [200, 20])
    basis, orders = drift_basis(t, recording, 0.1, 12)
    own = np.array([b[recording == 0].any() for b in basis])
    other = np.array([b[recording == 3].any() for b in basis])
    assert (own ^ other).all()
    # 19.9 s of at most .1 Hz hold three half periods; 1.9 s no whole one, but its slope.
    assert (own.sum(), other.sum()) == (1 + 3, 1 + 1)
    np.testing.assert_allclose(basis[0][:200], 1.0)
    np.testing.assert_allclose(basis[4][200:], 1.0)
    np.testing.assert_array_equal(orders, [0, 1, 2, 3, 0, 1])
    inner = basis[:4, :200] @ basis[:4, :200].T / 200
    np.testing.assert_allclose(inner, np.diag([1.0, 0.5, 0.5, 0.5]), atol=0.02)
    for k, b in enumerate(basis[:4, :200]):
        assert (np.diff(np.sign(b)) != 0).sum() == k


def test_drift_of_a_long_recording_has_as_many_functions_as_are_allowed() -> None:
    t = np.linspace(0.0, 1000.0, 500)
    assert len(drift_basis(t, np.zeros(500), 0.1, 12)[0]) == 13
    basis, _ = drift_basis(np.array([4.0]), np.zeros(1), 0.1, 12)
    assert np.isfinite(basis).all()


@pytest.mark.parametrize("nu", [4.0, 10.0])
def test_heavy_tails_have_students_density(nu: float) -> None:
    rng = np.random.default_rng(8)
    n, index = 0.3 * rng.standard_t(nu, 4000), np.arange(4000)
    size, tail = tailed(n, index, index // 100)
    assert tail is not None
    assert [part.freedom for part in tail.parts] == [nu]
    assert size == pytest.approx(0.3, rel=0.05)
    noise = Noise(index, np.zeros(0), size, np.ones(len(n)), tail)
    got = -noise.surprise + order_cost(1, len(n)) - 0.5 * (noise.white(n) ** 2).sum() - 0.5 * len(n) * np.log(2 * np.pi)
    assert got == pytest.approx(student_t.logpdf(n, nu, scale=size).sum(), rel=1e-6)
    # At any other place of the rows it lies below.
    for part in (0.5, 1.7):
        other = -noise.surprise + order_cost(1, len(n)) - 0.5 * (noise.white(part * n) ** 2).sum()
        assert other - 0.5 * len(n) * np.log(2 * np.pi) < student_t.logpdf(part * n, nu, scale=size).sum()


def test_normal_noise_has_no_tail() -> None:
    n = np.random.default_rng(9).normal(size=4000)
    size, tail = tailed(n, np.arange(4000), np.arange(4000) // 100)
    assert tail is None
    assert size == pytest.approx(n.std(), rel=1e-3)


def test_few_of_the_rows_may_be_whitened() -> None:
    rng = np.random.default_rng(10)
    n, index = rng.standard_t(2.0, 900), np.arange(50, 950)
    _, tail = tailed(n, index, np.arange(1000) // 50)
    assert tail is not None
    assert (tail.weight[:50] == 1.0).all()
    assert tail.weight[index][np.abs(n).argmax()] == tail.weight.min()


@pytest.mark.parametrize("nu", [4.0, 10.0])
def test_blocks_that_are_noisier_than_others_are_students_together(nu: float) -> None:
    rng, m, blocks = np.random.default_rng(11), 40, 200
    scale = np.sqrt(nu / rng.chisquare(nu, blocks))
    n, index = 0.3 * rng.normal(size=m * blocks) * np.repeat(scale, m), np.arange(m * blocks)
    block = index // m
    size, tail = tailed(n, index, block)
    assert tail is not None
    assert [part.freedom for part in tail.parts] == [nu]
    assert size == pytest.approx(0.3, rel=0.1)
    np.testing.assert_allclose(tail.weight.reshape(blocks, m).mean(1) ** -0.5, scale, rtol=0.5)
    noise = Noise(index, np.zeros(0), size, np.ones(len(n)), tail)
    got = -noise.surprise + order_cost(1, len(n)) - 0.5 * (noise.white(n) ** 2).sum() - 0.5 * len(n) * np.log(2 * np.pi)
    together = multivariate_t(np.zeros(m), size**2 * np.eye(m), df=nu)
    assert got == pytest.approx(together.logpdf(n.reshape(blocks, m)).sum(), rel=1e-6)


def test_spikes_in_recordings_of_different_noise_have_both_tails() -> None:
    rng = np.random.default_rng(12)
    n, block = rng.standard_t(4.0, 4000) * np.repeat([0.3, 1.0], 2000), np.arange(4000) // 100
    _, tail = tailed(n, np.arange(4000), block)
    assert tail is not None
    together, each = sorted(tail.parts, key=lambda part: part.group is None)
    assert each.group is None
    assert together.group is block
    assert np.sqrt(together.weight[:2000].mean() / together.weight[2000:].mean()) == pytest.approx(1 / 0.3, rel=0.2)
