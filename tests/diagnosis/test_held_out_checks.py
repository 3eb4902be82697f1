"""The worth of a model on held-out torque, against errors whose worth and memory are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from inference.problems import columns_of, dense, prior_of, recorded, statistics_of

from torchrbd.diagnosis.held_out_checks import held_out_checks, held_out_ratio
from torchrbd.effects import Site, effect
from torchrbd.inference.physical.fitting import fit_model
from torchrbd.inference.results import TorqueSeries
from torchrbd.recordings import Recording

STEP_S = 0.05


def series(errors: dict[str, np.ndarray], held_out: np.ndarray | None = None) -> TorqueSeries:
    """Return series of one joint with given errors of the models."""
    M = len(next(iter(errors.values())))
    measured, nothing = np.zeros((M, 1)), np.zeros((M, 1))
    return TorqueSeries(
        joints=("hinge",),
        recordings=("a.csv",),
        recording=np.zeros(M, dtype=int),
        t=STEP_S * np.arange(M),
        held_out=np.ones(M, dtype=bool) if held_out is None else held_out,
        q=nothing,
        qd=nothing,
        qdd=nothing,
        measured=measured,
        predicted={model: -e[:, None] for model, e in errors.items()},
    )


def coloured(rng: np.random.Generator, M: int, time_s: float) -> np.ndarray:
    """Return noise whose autocorrelation falls as exp(-t / time_s)."""
    a = np.exp(-STEP_S / time_s)
    e = np.zeros(M)
    for k in range(1, M):
        e[k] = a * e[k - 1] + np.sqrt(1 - a**2) * rng.standard_normal()
    return e


def test_intervals_hold_the_true_ratio_as_often_as_they_say() -> None:
    """Errors of half the size leave a quarter of the power."""
    rng, held, hit = np.random.default_rng(0), 100, 0
    for seed in range(held):
        before = coloured(rng, 1200, 0.1)
        (proof,) = held_out_checks(
            series({"rigid_body": before, "extended": 0.5 * coloured(rng, 1200, 0.1)}), 10.0, seed
        )
        hit += proof.over["rigid_body"].low <= 0.25 <= proof.over["rigid_body"].high
    assert 0.86 * held <= hit <= held - 1


def test_only_what_is_held_out_counts() -> None:
    rng = np.random.default_rng(1)
    before, after, held_out = rng.standard_normal(1000), rng.standard_normal(1000), np.arange(1000) >= 500
    spoilt = np.where(held_out, after, 1e3)
    given = {"urdf": before, "rigid_body": 2 * before, "extended": after}
    (proof,) = held_out_checks(series({**given, "extended": spoilt}, held_out), 10.0)
    (same,) = held_out_checks(series(given, held_out), 10.0)
    assert proof == same
    assert proof.over["urdf"].value == pytest.approx((after[500:] ** 2).sum() / (before[500:] ** 2).sum())
    assert proof.over["rigid_body"].value == pytest.approx(proof.over["urdf"].value / 4)
    assert held_out_checks(series(given, np.zeros(1000, dtype=bool)), 10.0) == ()


@pytest.mark.parametrize("time_s", [0.1, 0.4])
def test_memory_is_the_integral_of_the_autocorrelation(time_s: float) -> None:
    """Of exp(-t / T) it is 2 T; of white noise one step."""
    rng = np.random.default_rng(2)
    slow, white = coloured(rng, 60_000, time_s), rng.standard_normal(60_000)
    (proof,) = held_out_checks(series({"rigid_body": slow, "extended": white}), 10.0)
    assert proof.memory_s["rigid_body"] == pytest.approx(2 * time_s, rel=0.15)
    assert proof.memory_s["extended"] == pytest.approx(STEP_S, rel=0.1)
    assert proof.white_s == 0.05


def test_what_is_added_is_regressed_on_what_others_leave() -> None:
    """Of a model that adds half of what is there, twice as much is; of what is not, nothing; and of nothing, no word.

    The slope is that of least squares without a constant (numpy), in parts of each joint's variance.
    """
    robot, recording = recorded(2, 3, torque_noise=0.05)
    columns = columns_of(robot)
    statistics, full = statistics_of(columns, recording), dense(columns, recording)
    model = fit_model(statistics, prior_of(columns))
    true = torch.zeros(columns.n, dtype=torch.float64)
    true[: robot.n_params] = robot.pi
    rng = np.random.default_rng(0)
    without = true + 0.2 * true.abs().max() * torch.from_numpy(rng.standard_normal(columns.n)) * (true != 0)
    for part in (1.0, 0.5):
        x = without + part * (true - without)
        found = held_out_ratio(statistics, replace(model, x=x), without)
        assert found is not None
        added, left = (full.A @ (x - without).numpy()).ravel(), (full.tau - full.A @ without.numpy()).ravel()
        weight = np.repeat(1.0 / full.tau.std(1), full.tau.shape[1])
        slope = np.linalg.lstsq((added * weight)[:, None], left * weight, rcond=None)[0][0]
        assert found.value == pytest.approx(slope, rel=1e-6)
        assert found.value == pytest.approx(1.0 / part, rel=0.01)
        assert found.low < found.value < found.high
    astray = held_out_ratio(statistics, replace(model, x=2.0 * true - without), true, [1])
    assert astray is not None
    assert astray.value == pytest.approx(0.0, abs=0.01)
    assert held_out_ratio(statistics, replace(model, x=true), true) is None


def test_its_interval_holds_one_where_what_was_found_is_right() -> None:
    """A spring of a fifth of its joint's torque, fitted to every other block beside noise of half of the torque."""
    robot, recording = recorded(2, 3, torque_noise=0.0, duration_s=40.0)
    (chunk,) = recording.chunks(10**7)
    columns, t, q, clean = columns_of(robot), chunk.t, chunk.q, chunk.tau.copy()
    clean[:, 1] += 0.2 * clean[:, 1].std() / q[:, 1].std() * q[:, 1]
    spring, prior = columns.candidate(effect("joint_spring"), Site(1), {}), prior_of(columns)
    hit, held = 0, 40
    for seed in range(held):
        noise = 0.5 * clean.std(0) * np.random.default_rng(seed).standard_normal(clean.shape)
        statistics = statistics_of(columns, Recording.from_arrays("noisy", recording.joints, t, q, clean + noise))
        fitted = torch.arange(len(statistics)) % 2 == 0
        training, judging = statistics.select(fitted), statistics.select(~fitted)
        there = held_out_ratio(judging, fit_model(training, prior, [spring]), fit_model(training, prior).x, [1])
        assert there is not None
        hit += there.low <= 1.0 <= there.high
    assert 0.8 * held <= hit
