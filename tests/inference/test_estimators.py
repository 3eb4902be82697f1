"""Every estimator of a robot's parameters, against dense formulas in numpy and on robots whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from inference.problems import Dense, dense
from robot.random_robots import random_urdf
from simulated import inverse_dynamics, joint_names, multisine, with_wrong_inertials

from torchrbd.effects import effect
from torchrbd.errors import OptionError
from torchrbd.estimators import ESTIMATORS
from torchrbd.inference.estimators import estimate, estimators, linear_problem
from torchrbd.inference.estimators.plain import regress, regress_on_noisy_inputs, robot_moments
from torchrbd.inference.physical.fitting import judge, term_candidates
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.parameters import is_physical
from torchrbd.recordings import Recording
from torchrbd.regression.base import Regression
from torchrbd.regression.classical import OrdinaryLeastSquares
from torchrbd.regression.moments import Moments
from torchrbd.robot import RobotModel

URDF = random_urdf(5, 3, kinds=("revolute",), branching=0.0, massless=0.0)
ROBOT = RobotModel.from_urdf(with_wrong_inertials(URDF, 1))


def prepared_of(*recordings: Recording, effects: tuple[str, ...] = (), **options) -> Prepared:
    settings = Settings.from_mapping({"cutoff_hz": 5.0, "estimator": "physical", **options}, "test")
    return prepare(ROBOT, list(recordings), settings, [effect(name) for name in effects])


def recorded(
    seed: int, *, encoder_noise: float = 1e-5, torque_noise: float = 0.03, burst: float = 0.0,
    friction: tuple[float, ...] = (0.0, 0.0, 0.0), set_point: bool = True
) -> Recording:  # fmt: skip
    """Record a motion that the controller follows exactly; ``burst`` N m push every joint for .5 s in every 5 s."""
    names = joint_names(URDF)
    motion = multisine(len(names), seed, duration_s=20.0)
    rng = np.random.default_rng(seed)
    tau = inverse_dynamics(URDF, motion) + np.array(friction) * motion.qd
    tau = tau + torque_noise * tau.std(0) * rng.standard_normal(tau.shape) + burst * (motion.t % 5.0 < 0.5)[:, None]
    q = motion.q + encoder_noise * rng.standard_normal(tau.shape)
    q_ref = motion.q if set_point else None
    return Recording.from_arrays("noisy", names, motion.t, q, tau, q_ref=q_ref)


@pytest.fixture(scope="module")
def clean() -> Recording:
    return recorded(4)


@pytest.fixture(scope="module")
def prepared(clean: Recording) -> Prepared:
    return prepared_of(clean)


def training_rows(prepared: Prepared, recording: Recording) -> Dense:
    """Return the dense rows of the fitted blocks, every column computed and filtered by itself."""
    rows = dense(prepared.columns, recording)
    kept = np.zeros(len(rows.t), dtype=bool)
    for block in prepared.training.blocks:
        kept |= (rows.t >= block.start_s) & (rows.t <= block.end_s)
    return Dense(rows.t[kept], rows.A[:, kept], rows.tau[:, kept], rows.weight)


def nearest_to_urdf(prepared: Prepared, A: np.ndarray, tau: np.ndarray, Z: np.ndarray | None = None) -> np.ndarray:
    """Solve Z'(tau - A x) = 0 for rows A (N, n), tau (N,): of all solutions the nearest to the URDF in the prior."""
    S, x0 = prepared.prior.scale.numpy(), prepared.prior.mean.numpy()
    S = S[:, np.abs(S).max(0) > 0][:, : len(prepared.prior.inertial)]
    Z = A if Z is None else Z
    equations, known = (Z @ S).T @ (A @ S), (Z @ S).T @ (tau - A @ x0)
    return x0 + S @ (np.linalg.pinv(equations, rcond=1e-12) @ known)


def stacked(rows: Dense, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate(rows.A / std[:, None, None]), np.concatenate(rows.tau / std[:, None])


def weighted_reference(prepared: Prepared, rows: Dense) -> tuple[np.ndarray, np.ndarray]:
    """Return x and joint variances of weighted least squares, the parameters used by each joint from its leverages."""
    n_dof, n_rows = rows.tau.shape
    variance = 0.01 * np.mean(rows.tau**2, 1)
    for _ in range(30):
        A, tau = stacked(rows, np.sqrt(variance))
        x = nearest_to_urdf(prepared, A, tau)
        A = A[:, prepared.prior.inertial.numpy()]
        U, s, _ = np.linalg.svd(A / np.maximum(np.linalg.norm(A, axis=0), 1e-9), full_matrices=False)
        leverage = np.square(U[:, s > 1e-6 * s[0]]).sum(1).reshape(n_dof, n_rows).sum(1)
        count = rows.weight * n_rows
        rss = rows.weight * np.square(rows.tau - rows.A @ x).sum(1)
        variance = rss / (count - leverage)
    return x, variance


def assert_same(prepared: Prepared, got: torch.Tensor, expected: np.ndarray, rel: float) -> None:
    """Compare in units of the prior's standard deviations."""
    scale = prepared.prior.scale.norm(dim=1).numpy()[: prepared.robot.n_params]
    difference = (got.numpy() - expected)[: prepared.robot.n_params] / np.where(scale > 0, scale, 1.0)
    assert np.abs(difference).max() < rel


def test_every_name_is_known_to_the_settings() -> None:
    assert set(estimators()) == set(ESTIMATORS) - {"auto", "smoother", "moments"}


def test_ordinary_least_squares_is_that_of_numpy(prepared: Prepared, clean: Recording) -> None:
    rows = training_rows(prepared, clean)
    expected = nearest_to_urdf(prepared, *stacked(rows, np.ones(3)))
    assert_same(prepared, estimate(prepared, "ols").raw, expected, 1e-6)


def test_weighted_least_squares_is_that_of_numpy(prepared: Prepared, clean: Recording) -> None:
    expected, variance = weighted_reference(prepared, training_rows(prepared, clean))
    got = estimate(prepared, "wls")
    assert_same(prepared, got.raw, expected, 1e-3)
    assert linear_problem(prepared).weighted()[1].numpy() == pytest.approx(variance, rel=1e-2)


def test_condition_is_that_of_the_weighted_regressor(prepared: Prepared, clean: Recording) -> None:
    problem = linear_problem(prepared)
    rows = training_rows(prepared, clean)
    A, _ = stacked(rows, np.sqrt(0.01 * np.mean(rows.tau**2, 1)))
    A = A[:, problem.chosen.numpy()]
    assert problem.condition == pytest.approx(np.linalg.cond(A / np.linalg.norm(A, axis=0)), rel=1e-3)
    assert len(problem.chosen) == np.linalg.matrix_rank(A / np.linalg.norm(A, axis=0), tol=1e-5)


def test_irls_is_hubers_estimator() -> None:
    """The fixed point that plain numpy finds; pushes that no model explains hardly count."""
    recording = recorded(5, burst=20.0)
    prepared = prepared_of(recording)
    rows = training_rows(prepared, recording)
    x, variance = weighted_reference(prepared, rows)
    for _ in range(100):
        r = np.abs(rows.tau - rows.A @ x) / np.sqrt(variance)[:, None]
        w = np.sqrt(np.minimum(1.0, 1.345 / np.maximum(r, 1e-9)) / variance[:, None])
        x = nearest_to_urdf(prepared, np.concatenate(w[..., None] * rows.A), np.concatenate(w * rows.tau))
        variance = np.square(np.median(np.abs(rows.tau - rows.A @ x), axis=1) / 0.6745)
    robust, plain = (estimate(prepared, name).raw.numpy() for name in ("irls", "wls"))

    def distance(found: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.square(rows.A @ (found - x)) / variance[:, None, None].squeeze(-1))))

    assert distance(robust) < 0.02
    assert distance(plain) > 20 * distance(robust)


def test_instruments_remove_the_bias_of_encoder_noise() -> None:
    recording = recorded(6, encoder_noise=5e-3)
    prepared = prepared_of(recording)
    (chunk,) = recording.chunks(10**6)
    assert chunk.q_ref is not None
    wanted = Recording.from_arrays("wanted", recording.joints, chunk.t, chunk.q_ref, chunk.tau)
    rows, instruments = (training_rows(prepared, r) for r in (recording, wanted))
    std = np.sqrt(linear_problem(prepared).weighted()[1].numpy())
    A, tau = stacked(rows, std)
    expected = nearest_to_urdf(prepared, A, tau, stacked(instruments, std)[0])
    got = estimate(prepared, "iv")
    assert_same(prepared, got.raw, expected, 1e-5)
    exact = prepared_of(recorded(60, encoder_noise=0.0, torque_noise=0.0))
    errors = {name: judge(exact.judging, estimate(prepared, name).raw).mean_nmse for name in ("iv", "wls")}
    assert errors["iv"] < 0.3 * errors["wls"]


def test_moments_are_those_of_the_dense_rows(prepared: Prepared, clean: Recording) -> None:
    problem = linear_problem(prepared)
    rows, variance = training_rows(prepared, clean), problem.weighted()[1]
    moments = robot_moments(problem, 1.0 / variance)
    A, tau = stacked(rows, variance.sqrt().numpy())
    a = np.column_stack((A[:, problem.chosen.numpy()], tau - A @ prepared.prior.mean.numpy()))
    assert moments.total.numpy() == pytest.approx(rows.weight * a.T @ a, rel=1e-9, abs=1e-9 * np.abs(a).max() ** 2)
    assert moments.n == pytest.approx(rows.weight * len(a))
    assert 5 <= len(moments.count) <= 10
    assert_same(prepared, regress(problem, OrdinaryLeastSquares)[0], problem.weighted()[0].numpy(), 1e-7)


def test_noise_of_the_columns_is_taken_out_of_both_sides() -> None:
    """Subtracting it from the moments is then the same as from the normal equations of the parameters themselves."""
    prepared = prepared_of(recorded(6, encoder_noise=3e-3))
    problem = linear_problem(prepared)
    _, variance = problem.weighted()

    class MomentCorrected(Regression):
        name = "corrected"

        def __init__(self, noise: torch.Tensor):
            self.noise = noise

        def _coefficients(self, moments: Moments) -> torch.Tensor:
            return torch.linalg.solve(moments.xx - self.noise, moments.xy)

    H, N = torch.zeros(2, prepared.columns.n, prepared.columns.n, dtype=torch.float64)
    h = torch.zeros(prepared.columns.n, dtype=torch.float64)
    grams = prepared.input_noise.columns_gram
    for own, total, gram, v in zip(prepared.columns.of_joint, problem.training.total(), grams, variance, strict=True):
        H[own[:, None], own] += total[:-1, :-1] / v
        h[own] += total[:-1, -1] / v
        N[own[:, None], own] += gram / v
    b, x0 = problem.chosen, problem.reference
    beta = torch.linalg.solve((H - N)[b][:, b], (h - (H - N) @ x0)[b])
    expected = x0 + problem.lift @ beta
    assert_same(prepared, regress_on_noisy_inputs(problem, MomentCorrected)[0], expected.numpy(), 1e-6)


@pytest.mark.parametrize("name", estimators())
def test_every_estimator_on_a_robot_with_friction(name: str) -> None:
    """Finite, physical, better than the URDF on data not seen; trusted links and absent terms are left as they are."""
    prepared = prepared_of(recorded(8, friction=(1.5, 1.5, 0.0)), effects=("viscous_friction",), trust="link1")
    terms = term_candidates(prepared.columns, ["viscous_friction"])[:2]
    found = estimate(prepared, name, terms)
    x0 = prepared.prior.mean
    moved = torch.tensor([*range(10, ROBOT.n_params), *(k for c in terms for k in prepared.columns.of(c))])
    for x in (found.raw, found.x):
        assert torch.isfinite(x).all()
        held = torch.ones(len(x), dtype=torch.bool).index_fill_(0, moved, False)
        assert torch.equal(x[held], x0[held])
        assert judge(prepared.judging, x).mean_nmse < 0.5 * judge(prepared.judging, prepared.prior.reference).mean_nmse
    assert is_physical(found.x[: ROBOT.n_params].reshape(-1, 10)).all()
    assert found.was_physical == bool(is_physical(found.raw[: ROBOT.n_params].reshape(-1, 10)).all())
    assert not found.was_physical or torch.equal(found.raw, found.x)
    assert found.name == name
    assert found.seconds > 0.0


def test_projection_is_nearer_than_another_physical_robot() -> None:
    """In torque on the fitted blocks, the metric of the projection."""
    prepared = prepared_of(recorded(4, torque_noise=10.0))
    found = estimate(prepared, "ols")
    problem = linear_problem(prepared)
    assert not found.was_physical
    weights = 1.0 / problem.weighted()[1]

    def distance(x: torch.Tensor) -> float:
        total = 0.0
        for own, moments, w in zip(prepared.columns.of_joint, problem.training.total(), weights, strict=True):
            d = (x - found.raw)[own]
            total += float(w * d @ moments[:-1, :-1] @ d)
        return total

    assert distance(found.x) < 0.5 * distance(estimate(prepared, "physical").x)


@pytest.mark.parametrize("name", ["irls", "iv", "ridge"])
def test_kept_back_torque_is_not_seen(name: str, clean: Recording) -> None:
    other = replace(recorded(9), name="other")
    (chunk,) = other.chunks(10**6)
    wrong = Recording.from_arrays("other", other.joints, chunk.t, chunk.q, 3.0 + 2.0 * chunk.tau, q_ref=chunk.q_ref)
    found = []
    for held in (other, wrong):
        both = prepared_of(clean, held)
        names = [b.recording for b in both.statistics.blocks]
        kept = torch.tensor([n == "other" for n in names])
        found.append(estimate(replace(both, held_out=kept), name).raw)
    assert torch.equal(*found)


def test_instruments_need_set_points() -> None:
    prepared = prepared_of(recorded(4, set_point=False))
    with pytest.raises(OptionError, match=r"'iv' needs the set-points of every joint, .* there are none in noisy: rec"):
        estimate(prepared, "iv")


def test_unknown_name_is_told_with_a_suggestion(prepared: Prepared) -> None:
    with pytest.raises(OptionError, match=r"unknown estimator 'steppwise'; did you mean 'stepwise'\?"):
        estimate(prepared, "steppwise")
    with pytest.raises(OptionError, match=r"unknown estimator 'zzz'; known: "):
        Settings(estimator="zzz")
