"""The baseline of real robots: least squares on base parameters with friction, by Pinocchio and numpy."""

from __future__ import annotations

from pathlib import Path

import against_least_squares as benchmark
import numpy as np
import pandas as pd
import pytest

DEMO = Path(__file__).parent.parent / "torchrbd" / "demo"
JOINTS = tuple(f"joint{k}" for k in range(1, 7))
FRICTION = 3 * len(JOINTS)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the demo as CSV, and its URDF with a continuous joint."""
    into = tmp_path_factory.mktemp("arm")
    for name in ("fit", "holdout"):
        pd.read_parquet(DEMO / f"{name}.parquet").iloc[:4000:2].to_csv(into / f"{name}.csv", index=False)
    urdf = (DEMO / "arm.urdf").read_text(encoding="utf-8")
    (into / "arm.urdf").write_text(urdf, encoding="utf-8")
    (into / "turning.urdf").write_text(urdf.replace('type="revolute"', 'type="continuous"', 1), encoding="utf-8")
    return into


@pytest.mark.parametrize("urdf", ["arm.urdf", "turning.urdf"])
def test_friction_at_a_joint_is_fitted_and_predicts(arm: Path, urdf: str) -> None:
    fit, judge = (benchmark.Recorded(arm / f"{n}.csv", arm / urdf, JOINTS, 10.0) for n in ("fit", "holdout"))
    (tau, W), (unseen, V) = ((r.tau[50:-50], r.W[50:-50]) for r in (fit, judge))
    x = benchmark.weighted(W, tau)
    assert x[-FRICTION:].reshape(-1, 3)[2, 1] == pytest.approx(2.4, rel=0.05), "Coulomb friction of joint3"
    assert benchmark.nmse([unseen - V @ x], [unseen]).max() < 2e-3
    bodies = benchmark.weighted(W[..., :-FRICTION], tau)
    assert benchmark.nmse([unseen - V[..., :-FRICTION] @ bodies], [unseen])[2] > 1e-2


def test_samples_are_those_nearest_in_time(arm: Path) -> None:
    recorded = benchmark.Recorded(arm / "fit.csv", arm / "arm.urdf", JOINTS, 10.0)
    tau, W = recorded.at(np.array([0.0, 1.0, 1.0001, 1e9]))
    step = round(1.0 / (recorded.t[1] - recorded.t[0]))
    np.testing.assert_array_equal(tau, recorded.tau[[0, step, step, -1]])
    assert W.shape == (4, 6, 60 + FRICTION)


def test_errors_of_folds_are_added() -> None:
    rng = np.random.default_rng(0)
    tau, error = rng.standard_normal((2, 3, 50, 4))
    tau += 10.0 * np.arange(3)[:, None, None]
    within = tau - tau.mean(axis=1, keepdims=True)
    expected = (error**2).sum((0, 1)) / (within**2).sum((0, 1))
    np.testing.assert_allclose(benchmark.nmse(list(error), list(tau)), expected)


def test_every_part_of_a_recording_is_held_out_once(tmp_path: Path) -> None:
    for name, rows in (("a", range(6)), ("b", range(6, 10))):
        (tmp_path / f"{name}.csv").write_text("t,q\n" + "\n".join(f"{k},0" for k in rows), encoding="utf-8")
    chosen = benchmark.RealSet("arm", "sensor", ("a.csv", "b.csv"), parts=3)
    seen = []
    for fitted, held_out in benchmark.folds(chosen, tmp_path, tmp_path):
        times = [[t for p in paths for t in np.atleast_1d(benchmark.table(p)["t"])] for paths in (fitted, held_out)]
        assert sorted([*times[0], *times[1]]) == list(range(10))
        assert times[1] == list(range(int(times[1][0]), int(times[1][-1]) + 1)), "one piece"
        seen += times[1]
    assert sorted(seen) == list(range(10))


def test_files_are_held_out_together(tmp_path: Path) -> None:
    chosen = benchmark.RealSet("arm", "sensor", ("a", "b", "c", "d", "e"), together=2)
    found = [[p.name for p in held_out] for _, held_out in benchmark.folds(chosen, tmp_path, tmp_path)]
    assert found == [["d", "e"], ["b", "c"], ["a"]]
