"""Rivals on data whose answer is known."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from simulated import inverse_dynamics, multisine

pytest.importorskip("pysindy", reason="SINDy comes with an extra of the benchmark")
from concealed.rivals import SPARSE, bic, run_rivals

URDF = """<robot name="one"><link name="base"/>
<link name="arm"><inertial><origin xyz="0.02 0 -0.2"/><mass value="2"/>
<inertia ixx="0.03" iyy="0.03" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="a" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-9" upper="9" effort="50" velocity="10"/></joint></robot>"""


@pytest.mark.parametrize("name", SPARSE)
def test_planted_columns_are_held(name: str) -> None:
    rng = np.random.default_rng(1)
    X = rng.standard_normal((400, 25))
    w = SPARSE[name](X, 0.8 * X[:, 3] - 0.6 * X[:, 11] + 0.1 * rng.standard_normal(400), 1.0)
    assert {3, 11} <= set(np.flatnonzero(w))
    assert w[3] == pytest.approx(0.8, abs=0.05)
    assert w[11] == pytest.approx(-0.6, abs=0.05)


def test_no_further_column_would_lower_bic() -> None:
    rng = np.random.default_rng(2)
    X = rng.standard_normal((400, 25))
    y = X[:, 3] + 0.5 * X[:, 4] + 0.8 * rng.standard_normal(400)

    def criterion(columns: list[int]) -> float:
        left = y - X[:, columns] @ np.linalg.lstsq(X[:, columns], y, rcond=None)[0]
        return 400 * np.log(np.mean(left**2)) + len(columns) * np.log(400)

    chosen = np.flatnonzero(bic(X, y, 1.0)).tolist()
    assert {3, 4} <= set(chosen)
    for k in set(range(25)) - set(chosen):
        assert criterion([*chosen, k]) >= criterion(chosen)


def test_bic_counts_independent_samples() -> None:
    rng, wrong = np.random.default_rng(3), {1.0: 0, 0.1: 0}
    for _ in range(60):
        # Each value ten times over: a tenth of the samples is independent.
        X, y = (np.repeat(rng.standard_normal((60, k)), 10, axis=0) for k in (10, 1))
        for independent in wrong:
            wrong[independent] += bool(bic(X, y[:, 0], independent).any())
    assert wrong[0.1] < 0.5 * 60 < wrong[1.0]


def test_bic_leaves_a_column_twice_in_the_library_alone() -> None:
    rng = np.random.default_rng(4)
    x = rng.standard_normal((200, 1))
    w = bic(np.hstack((x, x, 2 * x, 0 * x)), x[:, 0], 1.0)
    assert np.count_nonzero(w) == 1


@pytest.mark.slow
def test_rivals_of_a_case(tmp_path: Path) -> None:
    files = []
    for k in range(2):
        motion, rng = multisine(1, k, duration_s=20.0), np.random.default_rng(k)
        tau = inverse_dynamics(URDF, motion) + 0.5 * np.sign(motion.qd) + 0.02 * rng.standard_normal(motion.q.shape)
        files.append(tmp_path / f"{k}.parquet")
        parquet.write_table(pa.table({"t": motion.t, "q_a": motion.q[:, 0], "tau_a": tau[:, 0]}), files[-1])
    (tmp_path / "robot.urdf").write_text(URDF)
    found = run_rivals(tmp_path / "robot.urdf", files[:1], files[1:])
    plain = found["errors"]["rigid body"]["inside"][0]
    for name in SPARSE:
        assert found["errors"][name]["inside"][0] < 0.5 * plain
    assert any("coulomb_friction" in kinds for kinds in found["terms"]["bic"]["a"])
    assert found["errors"]["network"]["inside"][0] < plain
