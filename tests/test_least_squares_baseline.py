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
    assert benchmark.nmse(unseen - V @ x, unseen).max() < 2e-3
    bodies = benchmark.weighted(W[..., :-FRICTION], tau)
    assert benchmark.nmse(unseen - V[..., :-FRICTION] @ bodies, unseen)[2] > 1e-2


def test_samples_are_those_nearest_in_time(arm: Path) -> None:
    recorded = benchmark.Recorded(arm / "fit.csv", arm / "arm.urdf", JOINTS, 10.0)
    tau, W = recorded.at(np.array([0.0, 1.0, 1.0001, 1e9]))
    step = round(1.0 / (recorded.t[1] - recorded.t[0]))
    np.testing.assert_array_equal(tau, recorded.tau[[0, step, step, -1]])
    assert W.shape == (4, 6, 60 + FRICTION)
