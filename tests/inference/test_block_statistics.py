"""Second moments by blocks: equal to the dense matrices, however the recording is cut."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from inference.problems import LABELS, columns_of, dense, recorded, statistics_of

from torchrbd.dataset.block_statistics import BlockStatistics, assemble
from torchrbd.dataset.columns import Columns
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel


@pytest.fixture(scope="module")
def case() -> tuple[RobotModel, Recording]:
    return recorded(2, 3, torque_noise=0.05)


@pytest.fixture(scope="module")
def columns(case: tuple[RobotModel, Recording]) -> Columns:
    return columns_of(case[0])


@pytest.fixture(scope="module")
def statistics(case: tuple[RobotModel, Recording], columns: Columns) -> BlockStatistics:
    return statistics_of(columns, case[1])


def renamed(recording: Recording, name: str, tau: np.ndarray | None = None) -> Recording:
    (chunk,) = recording.chunks(10**7)
    return Recording.from_arrays(name, recording.joints, chunk.t, chunk.q, chunk.tau if tau is None else tau)


def close(a: torch.Tensor, b: torch.Tensor, tolerance: float = 1e-9) -> None:
    assert a.shape == b.shape
    assert (a - b).abs().max() <= tolerance * b.abs().max()


def test_layout_of_the_coefficients(case: tuple[RobotModel, Recording], columns: Columns) -> None:
    robot = case[0]
    assert all(labels == LABELS for labels in columns.labels)
    assert columns.n == robot.n_params + robot.n_dof * len(LABELS)
    for j in range(robot.n_dof):
        own = columns.of_joint[j].tolist()
        assert own == [*robot.columns(j).tolist(), *(columns.index(j, label) for label in LABELS)]
    assert sum(c.effect.id == "joint_spring" for c in columns.candidates) == robot.n_dof


def test_moments_are_the_dense_matrix_squared(
    case: tuple[RobotModel, Recording], columns: Columns, statistics: BlockStatistics
) -> None:
    full = dense(columns, case[1])
    number = np.floor(full.t / 1.5).astype(int)
    assert len(statistics) == len(np.unique(number))
    for b, block in zip(np.unique(number), statistics.blocks, strict=True):
        here = number == b
        assert (block.recording, block.start_s, block.end_s) == ("simulated", full.t[here][0], full.t[here][-1])
        k = statistics.blocks.index(block)
        for j, own in enumerate(columns.of_joint):
            a = np.column_stack((full.A[j][here][:, own.numpy()], full.tau[j][here]))
            close(statistics.moments[j][k], torch.from_numpy(full.weight * a.T @ a))
        tau = full.tau[:, here]
        expected = full.weight * np.stack((np.full(len(tau), here.sum()), tau.sum(1), (tau**2).sum(1)), -1)
        close(statistics.torque[k], torch.from_numpy(expected))


def test_counts_are_independent_samples(statistics: BlockStatistics) -> None:
    """Ten a second at a band limit of 5 Hz, whatever the clock."""
    seconds = statistics.blocks[-1].end_s - statistics.blocks[0].start_s
    assert statistics.torque[:, 0, 0].sum() == pytest.approx(10 * seconds, rel=0.02)


@pytest.mark.parametrize("rows", [100, 333, 10**6])
def test_tiles_may_be_of_any_size(
    rows: int, case: tuple[RobotModel, Recording], columns: Columns, statistics: BlockStatistics
) -> None:
    other = statistics_of(columns, case[1], rows=rows)
    assert other.blocks == statistics.blocks
    for a, b in zip((*other.moments, other.torque), (*statistics.moments, statistics.torque), strict=True):
        close(a, b)


def test_joining_selecting_and_leaving_out(
    case: tuple[RobotModel, Recording], columns: Columns, statistics: BlockStatistics
) -> None:
    second = statistics_of(columns, renamed(case[1], "second"), block_s=1.0)
    both = statistics + second
    assert len(both) == len(statistics) + len(second)
    assert both.blocks[-1].recording == "second"
    keep = torch.arange(len(both)) % 3 != 0
    for whole, kept, left in zip(both.total(), both.select(keep).total(), both.select(~keep).total(), strict=True):
        close(whole - left, kept)
    for a, b in zip(both.total(), statistics.total(), strict=True):
        close(a, 2 * b)
    assert len(both.select(torch.zeros(len(both), dtype=torch.bool))) == 0


def test_coarsening_keeps_the_sum_and_never_mixes_recordings(
    case: tuple[RobotModel, Recording], columns: Columns, statistics: BlockStatistics
) -> None:
    both = statistics + statistics_of(columns, renamed(case[1], "second"))
    for limit in (1000, 7, 3, 1):
        coarse = both.coarsened(limit)
        assert len(coarse) <= max(limit, 2)
        assert {b.recording for b in coarse.blocks} == {"simulated", "second"}
        assert coarse.blocks[0].start_s == both.blocks[0].start_s
        assert coarse.blocks[-1].end_s == both.blocks[-1].end_s
        for a, b in zip((*coarse.total(), coarse.torque.sum(0)), (*both.total(), both.torque.sum(0)), strict=True):
            close(a, b)
    assert both.coarsened(1000) is both


def test_squared_error_is_the_dense_residual(
    case: tuple[RobotModel, Recording], columns: Columns, statistics: BlockStatistics
) -> None:
    full = dense(columns, case[1])
    x = np.random.default_rng(0).normal(size=columns.n)
    residual = full.tau - full.A @ x
    number = np.floor(full.t / 1.5).astype(int)
    expected = [[full.weight * (r[number == b] ** 2).sum() for r in residual] for b in np.unique(number)]
    close(statistics.squared_error(torch.from_numpy(x)), torch.tensor(expected, dtype=torch.float64))
    close(statistics.torque_variance(), torch.from_numpy(full.tau.var(1)))


def test_normal_equations_are_weighted_least_squares(
    case: tuple[RobotModel, Recording], columns: Columns, statistics: BlockStatistics
) -> None:
    full = dense(columns, case[1])
    weights = np.array([0.5, 2.0, 1.0])
    H, h = assemble(columns, statistics.total(), torch.from_numpy(weights))
    rows = (np.sqrt(full.weight * weights)[:, None, None] * full.A).reshape(-1, columns.n)
    tau = (np.sqrt(full.weight * weights)[:, None] * full.tau).reshape(-1)
    close(H, torch.from_numpy(rows.T @ rows))
    close(h, torch.from_numpy(rows.T @ tau))


def test_a_joint_without_torque_counts_nothing(case: tuple[RobotModel, Recording], columns: Columns) -> None:
    (chunk,) = case[1].chunks(10**7)
    chunk.tau[:, 1] = np.nan
    partial = statistics_of(columns, renamed(case[1], "partial", chunk.tau))
    assert not partial.torque[:, 1].any()
    assert not partial.moments[1].any()
    assert torch.isfinite(partial.torque).all()
    close(partial.moments[0], statistics_of(columns, case[1]).moments[0])


def test_reference_holds_inertia_and_friction_of_the_urdf() -> None:
    robot = recorded(2, 3, duration_s=2.0)[0]
    robot.damping[1], robot.friction[2] = 0.4, 0.7
    columns = columns_of(robot)
    x = columns.reference()
    assert torch.equal(x[: robot.n_params], robot.pi)
    assert float(x[columns.index(1, "qd")]) == 0.4
    assert float(x[columns.index(2, "sign(qd)")]) == 0.7
    assert x[robot.n_params :].count_nonzero() == 2
