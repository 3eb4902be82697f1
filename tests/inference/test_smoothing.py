"""Joint smoothing: its algebra and splines against dense ones, its updates against its bound, and what it is for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from inference.problems import urdf_of
from noisy_robots import development_robots, noisy_recording, perturbed, torque_nmse
from scipy.interpolate import BSpline
from simulated import record

import torchrbd
from torchrbd.effects import Site, effect
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.shapes.refine import refined_from
from torchrbd.inference.shapes.reread import reread
from torchrbd.inference.smoothing.block_tridiagonal import BlockCholesky, fold, fold_rows
from torchrbd.inference.smoothing.information import eliminate
from torchrbd.inference.smoothing.linearisation import linearise, residual
from torchrbd.inference.smoothing.smoother import StateSmoother
from torchrbd.inference.smoothing.stretch import Stretch, stretches
from torchrbd.robot import RobotModel

URDF = development_robots(1)["random0"]
LOUD = 3e-3


def block_matrix(diagonal: torch.Tensor, below: torch.Tensor) -> torch.Tensor:
    whole = torch.block_diag(*diagonal)
    b = diagonal.shape[-1]
    for k, block in enumerate(below):
        whole[(k + 1) * b : (k + 2) * b, k * b : (k + 1) * b] = block
        whole[k * b : (k + 1) * b, (k + 1) * b : (k + 2) * b] = block.T
    return whole


@pytest.fixture
def blocks() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    windows = torch.randn(4, 9, 6, generator=generator, dtype=torch.float64)
    diagonal, below = fold(windows.mT @ windows)
    return diagonal + torch.eye(3), below


def test_block_cholesky_is_the_dense_one(blocks: tuple[torch.Tensor, torch.Tensor]) -> None:
    A, factor = block_matrix(*blocks), BlockCholesky.of(*blocks)
    right = torch.randn(5, 3, 2, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    torch.testing.assert_close(factor.solve(right).reshape(15, 2), torch.linalg.solve(A, right.reshape(15, 2)))
    torch.testing.assert_close(factor.logdet(), torch.logdet(A))
    inverse = torch.linalg.inv(A)
    for k, window in enumerate(factor.inverse_windows()):
        torch.testing.assert_close(window, inverse[3 * k : 3 * k + 6, 3 * k : 3 * k + 6])


def test_block_cholesky_has_gradients(blocks: tuple[torch.Tensor, torch.Tensor]) -> None:
    right = torch.ones(5, 3, 1, dtype=torch.float64)

    def function(diagonal: torch.Tensor, below: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        factor = BlockCholesky.of(0.5 * (diagonal + diagonal.mT), below)
        return factor.logdet(), factor.solve(right)

    leaves = [block.clone().requires_grad_(True) for block in blocks]
    assert torch.autograd.gradcheck(function, leaves)


def test_indefinite_matrix_is_refused(blocks: tuple[torch.Tensor, torch.Tensor]) -> None:
    with pytest.raises(torch.linalg.LinAlgError):
        BlockCholesky.of(-blocks[0], blocks[1])


def test_folding_sums_windows() -> None:
    windows = torch.randn(3, 4, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    whole = torch.zeros(8, 8, dtype=torch.float64)
    for k, window in enumerate(windows):
        whole[2 * k : 2 * k + 4, 2 * k : 2 * k + 4] += window
    diagonal, below = fold(windows)
    for k in range(4):
        torch.testing.assert_close(diagonal[k], whole[2 * k : 2 * k + 2, 2 * k : 2 * k + 2])
    torch.testing.assert_close(below[1], whole[4:6, 2:4])
    torch.testing.assert_close(fold_rows(windows)[1], windows[0, 2:] + windows[1, :2])


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    recording, _ = noisy_recording(URDF, 11, duration_s=8.0, rate_hz=250.0, encoder_noise=LOUD)
    robot = RobotModel.from_urdf(perturbed(URDF, 12))
    return prepare(robot, [recording], Settings(cutoff_hz=8.0, estimator="physical"), ())


@pytest.fixture(scope="module")
def pieces(prepared: Prepared) -> tuple[Stretch, ...]:
    return stretches_of(prepared)


def stretches_of(prepared: Prepared) -> tuple[Stretch, ...]:
    return stretches(
        prepared.recordings[0],
        prepared.reading.surveys[0],
        prepared.filtering,
        prepared.tiles(0),
        lambda t: (~prepared.kept_back(prepared.recordings[0].name, t)).unsqueeze(1) & prepared.measured(0),
    )


def smoother_of(prepared: Prepared, pieces: tuple[Stretch, ...]) -> StateSmoother:
    start = prepared.fit()
    noise = torch.from_numpy(prepared.reading.surveys[0].q_noise_std)
    none = torch.zeros(0, dtype=torch.long)
    return StateSmoother(prepared.columns, prepared.prior, pieces, none, start.x, start.noise_variance.sqrt(), noise)


def test_encoder_spline_is_the_least_squares_one(prepared: Prepared, pieces: tuple[Stretch, ...]) -> None:
    (stretch,), (chunk,) = pieces, prepared.recordings[0].chunks()
    grid = stretch.grid
    knots = grid.start + grid.spacing * np.arange(-3, grid.n_coefficients + 1)
    inside = (chunk.t >= grid.start - 1e-9) & (chunk.t <= grid.end + 1e-9)
    basis = BSpline.design_matrix(chunk.t[inside].clip(grid.start, grid.end), knots, 3).toarray()
    c, rest, *_ = np.linalg.lstsq(basis, chunk.q[inside], rcond=None)
    np.testing.assert_allclose(stretch.encoder, c, atol=1e-9)
    np.testing.assert_allclose(stretch.misfit, rest, rtol=1e-6)


def test_encoder_noise_is_told_by_the_spline(pieces: tuple[Stretch, ...]) -> None:
    (stretch,) = pieces
    variance = stretch.misfit / (stretch.samples - stretch.grid.n_coefficients)
    torch.testing.assert_close(variance.sqrt(), torch.full_like(variance, LOUD), rtol=0.1, atol=0.0)


def test_slopes_are_those_of_finite_differences(prepared: Prepared, pieces: tuple[Stretch, ...]) -> None:
    (stretch,), x = pieces, prepared.prior.mean
    c = stretch.encoder
    block, n = stretch.grid.block, prepared.robot.n_dof
    J = linearise(prepared.columns, stretch, c, x).J
    generator = torch.Generator().manual_seed(1)
    direction = torch.randn(c.shape, generator=generator, dtype=torch.float64)
    step = 1e-6
    numeric = (
        residual(prepared.columns, stretch, c - step * direction, x)
        - residual(prepared.columns, stretch, c + step * direction, x)
    ) / (2 * step)
    padded = torch.zeros((len(J) + 1) * block, n, dtype=torch.float64)
    padded[: len(c)] = direction
    windows = torch.stack([padded[k * block : (k + 2) * block].flatten() for k in range(len(J))])
    told = (J @ windows.unsqueeze(-1)).reshape(-1, n)[: stretch.grid.outputs]
    torch.testing.assert_close(told, numeric, rtol=1e-6, atol=1e-6 * float(numeric.abs().max()))


def test_elimination_is_that_of_the_dense_system(prepared: Prepared, pieces: tuple[Stretch, ...]) -> None:
    (stretch,), x, columns = pieces, prepared.prior.mean, prepared.columns
    stretch = replace(stretch, counts=stretch.counts.clone())
    n, block = prepared.robot.n_dof, stretch.grid.block
    torque, encoder = torch.linspace(0.1, 1.0, n).double(), torch.full((n,), LOUD**2).double()
    wanted = prepared.prior.inertial
    c = stretch.encoder + 1e-3 * torch.randn(stretch.encoder.shape, generator=torch.Generator().manual_seed(5)).double()
    found, step = eliminate(columns, stretch, c, x, torque, encoder, wanted)
    at = linearise(columns, stretch, c, x)
    height = at.J.shape[1]
    J = torch.zeros(len(at.J) * height, (len(at.J) + 1) * block * n, dtype=torch.float64)
    for k, rows in enumerate(at.J):
        J[k * height : (k + 1) * height, k * block * n : (k + 2) * block * n] = rows
    J = J[: stretch.grid.outputs * n, : c.numel()]
    W = (stretch.counts / torque).flatten()
    Y, r = at.Y[..., wanted].flatten(0, 1), at.residual.flatten()
    prior = torch.kron(stretch.gram, torch.diag(1 / encoder))
    H = J.T @ (W[:, None] * J) + prior
    g = J.T @ (W * r) + prior @ (stretch.encoder - c).flatten()
    E = J.T @ (W[:, None] * Y)
    covariance = torch.linalg.inv(H)
    torch.testing.assert_close(step.flatten(), covariance @ g, rtol=1e-6, atol=1e-10)
    scale = found.gram.abs().max()
    torch.testing.assert_close(found.gram, Y.T @ (W[:, None] * Y), rtol=1e-9, atol=1e-9 * float(scale))
    torch.testing.assert_close(found.lost, E.T @ covariance @ E, rtol=1e-6, atol=1e-9 * float(scale))
    slope = Y.T @ (W * r) - E.T @ covariance @ g
    torch.testing.assert_close(found.slope, slope, rtol=1e-6, atol=1e-6 * float(slope.abs().max()))
    spread = ((J @ covariance) * J).sum(1).reshape(-1, n)
    torch.testing.assert_close(found.spread, (stretch.counts * spread).sum(0), rtol=1e-6, atol=0.0)
    wander = torch.stack([(stretch.gram * covariance[i::n, i::n]).sum() for i in range(n)])
    torch.testing.assert_close(found.wander, wander, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(found.entropy, -0.5 * torch.logdet(H), rtol=1e-6, atol=1e-6 * len(H))


@pytest.mark.slow
def test_gauss_newton_and_autograd_climb_to_the_same_bound() -> None:
    urdf = urdf_of(5, 2)
    recording = record(urdf, 6, duration_s=16.0, rate_hz=100.0, fastest_hz=0.8, encoder_noise=LOUD)
    small = prepare(RobotModel.from_urdf(urdf), [recording], Settings(cutoff_hz=3.0, estimator="physical"), ())
    newton, climber = (smoother_of(small, stretches_of(small)) for _ in range(2))
    first = float(climber.elbo().detach())
    newton.fit()
    newton.refresh()
    reached = float(newton.elbo().detach())
    for _ in range(10):
        climber.refresh()
        parameters = climber.parameters()
        optimiser = torch.optim.LBFGS(parameters, max_iter=100, history_size=50, line_search_fn="strong_wolfe")

        def closure(optimiser: torch.optim.Optimizer = optimiser) -> float:
            optimiser.zero_grad()
            loss = -climber.elbo()
            loss.backward()
            return float(loss.detach())

        optimiser.step(closure)
    climber.refresh()
    assert reached > first + 10
    assert float(climber.elbo().detach()) == pytest.approx(reached, abs=0.02 * (reached - first))


def test_noise_is_found_from_wrong_beginnings(prepared: Prepared, pieces: tuple[Stretch, ...]) -> None:
    found = []
    for factor in (0.3, 1.0, 4.0):
        smoother = smoother_of(prepared, pieces)
        smoother.log_encoder_std.data += np.log(factor)
        smoother.fit()
        found.append(smoother.log_encoder_std.detach().exp())
        assert torch.allclose(found[-1], torch.tensor(LOUD).double(), rtol=0.1)
    torch.testing.assert_close(found[0], found[2], rtol=0.01, atol=0.0)


@pytest.mark.slow
def test_smoothed_states_give_better_parameters_than_filtered_ones() -> None:
    recording, truth = noisy_recording(URDF, 21, duration_s=15.0, rate_hz=250.0, encoder_noise=LOUD)
    robot = RobotModel.from_urdf(perturbed(URDF, 22))
    results = {
        name: torchrbd.identify(robot, [recording], cutoff_hz=8.0, estimator=name) for name in ("physical", "auto")
    }
    assert [r.states for r in results.values()] == ["filtered", "smoothed"]
    assert "smoothed together" in results["auto"].regime.statement
    errors = {name: torque_nmse(URDF, r.model.pi.detach().numpy(), 23) for name, r in results.items()}
    assert errors["auto"] < errors["physical"] / 5
    for noise in results["auto"].noise.values():
        assert noise.position == pytest.approx(LOUD, rel=0.1)
    assert np.abs(truth.q).max() > 0.1


@pytest.mark.slow
def test_quiet_positions_are_filtered() -> None:
    recording, _ = noisy_recording(URDF, 31, duration_s=10.0, rate_hz=250.0, encoder_noise=1e-6)
    result = torchrbd.identify(RobotModel.from_urdf(perturbed(URDF, 32)), [recording], cutoff_hz=5.0)
    assert result.states == "filtered"
    assert "hardly matters" in result.regime.statement


def test_held_out_torque_is_not_looked_at() -> None:
    recording, _ = noisy_recording(URDF, 41, duration_s=12.0, rate_hz=250.0, encoder_noise=LOUD)
    robot = RobotModel.from_urdf(perturbed(URDF, 42))
    settings = Settings(cutoff_hz=8.0, estimator="smoother")
    first = prepare(robot, [recording], settings, ())
    (chunk,) = recording.chunks()
    held = first.kept_back(recording.name, torch.from_numpy(chunk.t)).numpy()
    core = held & np.roll(held, 120) & np.roll(held, -120)
    tau = chunk.tau.copy()
    tau[core] *= 3.0
    spoiled = torchrbd.Recording.from_arrays(recording.name, recording.joints, chunk.t, chunk.q, tau)
    second = prepare(robot, [spoiled], settings, ())
    one, two = (p.fit().x for p in (first, second))
    assert core.any()
    torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-6)


def test_what_is_known_of_states_follows_the_columns() -> None:
    """Plain friction has no shape to refine; its columns are new all the same."""
    recording, _ = noisy_recording(URDF, 41, duration_s=12.0, rate_hz=250.0, encoder_noise=LOUD)
    robot = RobotModel.from_urdf(perturbed(URDF, 42))
    prepared = prepare(robot, [recording], Settings(cutoff_hz=8.0, estimator="smoother"), ())
    offset = prepared.columns.candidate(effect("torque_offset"), Site(0), {})
    columns = prepared.columns.of_candidates((offset,), None)
    assert prepared.states is not None
    assert columns.n == prepared.columns.n + 1 == len(prepared.states.gram) + 1
    again, terms = refined_from(reread(prepared, columns, lambda *_: None), (offset,), lambda *_: None)
    assert terms == (offset,)
    assert again.states is not None
    assert again.states.gram.shape == again.states.lost.shape == (columns.n, columns.n)
    fitted = again.fit(terms)
    assert fitted.noise_variance.max() < 10.0 * prepared.fit().noise_variance.max()


def test_states_use_up_a_share_of_the_torque_samples(prepared: Prepared, pieces: tuple[Stretch, ...]) -> None:
    smoother = smoother_of(prepared, pieces)
    said = smoother.refresh(torch.arange(prepared.columns.n))
    variance = prepared.fit().noise_variance
    share = said.uncertain_states(variance).used
    torch.testing.assert_close(share * said.count * variance, said.spread)
    assert (share > 0).all()
    assert (share < 1).all()


@pytest.mark.parametrize(("fastest_hz", "per_output"), [(1.0, 1), (5.0, 2)])
def test_knots_are_as_dense_as_the_motion_needs(fastest_hz: float, per_output: int) -> None:
    recording, _ = noisy_recording(URDF, 51, duration_s=8.0, encoder_noise=1e-3, fastest_hz=fastest_hz)
    settings = Settings(cutoff_hz=7.0, estimator="physical")
    quick = prepare(RobotModel.from_urdf(perturbed(URDF, 52)), [recording], settings, ())
    pieces = stretches_of(quick)
    assert {stretch.grid.per_output for stretch in pieces} == {per_output}
    noise = torch.stack([s.misfit / (s.samples - s.grid.n_coefficients) for s in pieces]).mean(0).sqrt()
    torch.testing.assert_close(noise, torch.full_like(noise, 1e-3), rtol=0.1, atol=0.0)
