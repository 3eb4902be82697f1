"""Streamed moments and square roots of base parameters, against Pinocchio, numpy and exact arithmetic."""

from __future__ import annotations

import re
from fractions import Fraction

import numpy as np
import pinocchio as pin
import pytest
import torch
from inference.problems import urdf_of
from simulated import joint_names

from torchrbd import BaseRegression, InputError, RobotModel
from torchrbd.regression.square_root import SquareRoot

URDF = urdf_of(2, 4)
ROBOT = RobotModel.from_urdf(URDF.encode())


def samples(n: int, seed: int = 0, noise: float = 0.05) -> list[torch.Tensor]:
    """Return states and Pinocchio's torques with noise that grows from joint to joint."""
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.standard_normal((3, n, ROBOT.n_dof))
    model = pin.buildModelFromXML(URDF)
    assert tuple(joint_names(URDF)) == ROBOT.joint_names
    data = model.createData()
    tau = np.stack([pin.rnea(model, data, *row).copy() for row in zip(q, qd, qdd, strict=True)])
    tau += noise * np.arange(1, ROBOT.n_dof + 1) * rng.standard_normal(tau.shape)
    return [torch.from_numpy(x) for x in (q, qd, qdd, tau)]


def stacked(q: torch.Tensor, qd: torch.Tensor, qdd: torch.Tensor, tau: torch.Tensor, std: torch.Tensor) -> np.ndarray:
    """Return the whitened rows [Y_b, tau] of all joints, built at once."""
    base = BaseRegression(ROBOT).base
    Y = ROBOT.regressor(q, qd, qdd)[..., list(base.independent)]
    return (torch.cat((Y, tau.unsqueeze(-1)), -1) / std.unsqueeze(-1)).flatten(0, 1).numpy()


@pytest.mark.parametrize("square_root", [False, True])
def test_it_is_least_squares_of_all_whitened_rows(square_root: bool) -> None:
    given, std = samples(5000), torch.tensor([0.1, 0.2, 0.3, 0.4], dtype=torch.float64)
    regression = BaseRegression(ROBOT, square_root=square_root)
    regression.take(*given)
    found, rows = regression.solve(std), stacked(*given, std)
    expected = np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=None)[0]
    np.testing.assert_allclose(found.value.numpy(), expected, rtol=1e-8, atol=1e-9)
    covariance = np.linalg.inv(rows[:, :-1].T @ rows[:, :-1])
    np.testing.assert_allclose(found.covariance.numpy(), covariance, rtol=1e-6, atol=1e-9 * covariance.max())
    truth = found.base.combination @ ROBOT.pi
    assert float(((found.value - truth) / found.covariance.diagonal().sqrt()).abs().max()) < 5.0


@pytest.mark.parametrize("square_root", [False, True])
def test_noise_is_learnt_joint_by_joint(square_root: bool) -> None:
    regression = BaseRegression(ROBOT, square_root=square_root)
    regression.take(*samples(4000))
    torch.testing.assert_close(
        regression.solve().noise_std, 0.05 * torch.arange(1.0, 5.0, dtype=torch.float64), rtol=0.05, atol=0.0
    )


@pytest.mark.parametrize("square_root", [False, True])
def test_pieces_add(square_root: bool) -> None:
    given = samples(5000)
    whole, first, second = (BaseRegression(ROBOT, square_root=square_root) for _ in range(3))
    whole.take(*given)
    first.take(*(x[:1700] for x in given))
    second.take(*(x[1700:] for x in given))
    both = first + second
    assert both.samples == whole.samples == 5000
    torch.testing.assert_close(both.solve().value, whole.solve().value, rtol=1e-10, atol=1e-11)


def exact_least_squares(rows: np.ndarray) -> np.ndarray:
    """Solve by Gaussian elimination of the normal equations in rational numbers, without any rounding."""
    exact = [[Fraction(float(x)) for x in row] for row in rows]
    d = rows.shape[1] - 1
    A = [[sum(row[i] * row[k] for row in exact) for k in range(d + 1)] for i in range(d)]
    for k in range(d):
        pivot = max(range(k, d), key=lambda i: abs(A[i][k]))
        A[k], A[pivot] = A[pivot], A[k]
        for i in range(d):
            if i != k:
                factor = A[i][k] / A[k][k]
                A[i] = [a - factor * b for a, b in zip(A[i], A[k], strict=True)]
    return np.array([float(A[k][d] / A[k][k]) for k in range(d)])


def ill_conditioned(condition: float) -> np.ndarray:
    """Return rows [x, y] (400, 7) whose x has a condition number, nearly equal columns; y has noise."""
    rng = np.random.default_rng(3)
    U, V = np.linalg.qr(rng.standard_normal((400, 6)))[0], np.linalg.qr(rng.standard_normal((6, 6)))[0]
    X = U * np.geomspace(1.0, 1.0 / condition, 6) @ V.T
    return np.column_stack((X, X @ rng.standard_normal(6) + 1e-9 * rng.standard_normal(400)))


def test_square_roots_keep_the_digits_that_normal_equations_lose() -> None:
    rows = ill_conditioned(1e10)
    condition = np.linalg.cond(rows[:, :-1])
    assert 9e9 < condition < 1.1e10
    exact = exact_least_squares(rows)
    root = SquareRoot.empty(7)
    for tile in torch.from_numpy(rows).split(90):
        root = root.with_rows(tile)
    found = root.solve()[0].numpy()
    error = np.linalg.norm(found - exact) / np.linalg.norm(exact)
    # cond * eps is 2e-6; cond^2 * eps is 2e4: nothing would be left.
    assert error < 1e-5
    moments = rows.T @ rows
    lost = np.linalg.lstsq(moments[:-1, :-1], moments[:-1, -1], rcond=None)[0]
    assert np.linalg.norm(lost - exact) / np.linalg.norm(exact) > 1e-2


def test_what_rows_do_not_tell_stays_finite() -> None:
    rows = torch.randn(50, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    rows[:, 1] = 2.0 * rows[:, 0]
    rows[:, 2] = 0.0
    solution, root = SquareRoot.empty(4).with_rows(rows).solve()
    expected = np.linalg.lstsq(rows[:, :1].numpy(), rows[:, 3].numpy(), rcond=None)[0]
    np.testing.assert_allclose(float(solution[0] + 2.0 * solution[1]), expected, rtol=1e-12)
    assert float(solution[2]) == 0.0
    assert float(root[2].norm()) == 0.0


def test_roots_add_as_their_rows_do() -> None:
    rows = torch.randn(50, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    root = SquareRoot.empty(4).with_rows(rows[:20]) + SquareRoot.empty(4).with_rows(rows[20:])
    torch.testing.assert_close(root.factor.T @ root.factor, rows.T @ rows)


def test_bad_samples_are_refused_whole() -> None:
    regression, given = BaseRegression(ROBOT), samples(100)
    given[3][7, 2] = torch.nan
    with pytest.raises(InputError, match=r"tau of joint3, sample 7, is nan; leave such samples out"):
        regression.take(*given)
    with pytest.raises(InputError, match=r"qd has shape \(100, 3\); expected \(100, 4\), a column for each of joint1"):
        regression.take(given[0], given[1][:, :3], given[2], given[3])
    assert regression.samples == 0
    with pytest.raises(InputError, match=r"0 samples for \d+ base parameters of robot .* and their noise; take in"):
        regression.solve()
    with pytest.raises(
        InputError, match="regressions with square_root and without cannot be added; make all with the same"
    ):
        regression + BaseRegression(ROBOT, square_root=True)


def test_only_regressions_of_one_robot_and_gravity_add() -> None:
    origin = re.search(r'<joint name="joint2".*?<origin xyz="([^ ]+)', URDF, re.S)
    assert origin is not None
    taller = f"{URDF[: origin.start(1)]}{float(origin[1]) + 0.3}{URDF[origin.end(1) :]}"
    regression, other = BaseRegression(ROBOT), BaseRegression(RobotModel.from_urdf(taller.encode()))
    assert [c.tolist() for c in regression._columns] == [c.tolist() for c in other._columns]
    with pytest.raises(InputError, match=r"regressions of '.*' and '.*' cannot be added: their joints, axes, plac"):
        regression + other
    light = BaseRegression(RobotModel.from_urdf(URDF.encode(), gravity=(0.0, 0.0, -1.6)))
    with pytest.raises(
        InputError, match=r"of gravity \[0.0, 0.0, -9.81\] and \[0.0, 0.0, -1.6\] cannot be added; make"
    ):
        regression + light
    assert (regression + BaseRegression(RobotModel.from_urdf(URDF.encode()))).samples == 0


@pytest.mark.parametrize("joints", [1, 4])
@pytest.mark.parametrize("square_root", [False, True])
def test_noise_is_learnt_only_where_samples_are_left(joints: int, square_root: bool) -> None:
    regression = BaseRegression(RobotModel.from_urdf(urdf_of(2, joints).encode()), square_root=square_root)
    n = len(regression.base.independent)
    given = torch.randn(4, n + 1, joints, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    regression.take(*given[:, :n])
    with pytest.raises(InputError, match=rf"{n} samples for {n} base parameters .* noise; take in {n + 1} or more"):
        regression.solve()
    known = regression.solve(torch.ones(joints))
    assert bool(known.value.isfinite().all() and known.covariance.isfinite().all())
    regression.take(*given[:, n:])
    found = regression.solve()
    assert bool((found.noise_std.isfinite() & (found.noise_std > 0)).all())
