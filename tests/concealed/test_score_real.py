"""Effects hidden in recordings that were measured, and cases run from folder to score; a made-up robot stands in."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from concealed import run
from concealed.effects import EFFECTS
from concealed.oracle import oracle_errors
from concealed.real import RealYardstick, added, draw_hidden, generate, write_case
from concealed.real_data import DATA_SETS, DataSet, RealRobot, take, told_hz
from concealed.score import score_case
from pyarrow import csv, parquet
from scipy.signal import butter, chirp, sosfiltfilt
from simulated import Motion, inverse_dynamics, multisine

URDF = """<robot name="two">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0.02 0 -0.2"/><mass value="2"/>
<inertia ixx="0.03" iyy="0.03" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0.01 -0.15"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="a" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit effort="50" velocity="10"/></joint>
<joint name="b" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -0.4"/><axis xyz="1 0 0"/>
<limit lower="-3" upper="3" effort="50" velocity="10"/></joint>
</robot>"""
BOUNDED = URDF.replace("continuous", "revolute")


def record(folder: Path, name: str, seed: int, extra=lambda m: 0.0) -> Motion:
    """Write a noisy recording as a CSV file and return its motion."""
    motion, rng = multisine(2, seed, duration_s=20.0), np.random.default_rng(seed)
    tau = inverse_dynamics(BOUNDED, motion) + 0.3 * np.sign(motion.qd) + extra(motion)
    tau = tau + 0.02 * rng.standard_normal(tau.shape)
    table = {"t": motion.t + 5.0}
    for j, joint in enumerate("ab"):
        table |= {f"q_{joint}": motion.q[:, j], f"tau_{joint}": tau[:, j]}
    csv.write_csv(pa.table(table), folder / name)
    return motion


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    for k, name in enumerate(("one.csv", "two.csv")):
        record(folder, name, k)
    (folder / "robot.urdf").write_text(URDF)
    return folder


def columns(path: Path, signal: str) -> np.ndarray:
    table = parquet.read_table(path) if path.suffix == ".parquet" else csv.read_csv(path)
    return np.stack([table[f"{signal}_{joint}"].to_numpy() for joint in "ab"], axis=1)


def test_joint_torque_is_added_to_the_measured_one(folder: Path, tmp_path: Path) -> None:
    robot = RealRobot("two", URDF)
    taken = take(robot, folder / "one.csv", "fit_1.parquet")
    rng = np.random.default_rng(0)
    spring = EFFECTS["joint_spring"].draw(rng, taken.motion, 1).of_strength(0.7)
    write_case(tmp_path / "case", robot, [taken], spring)
    told = spring.parameters(taken.motion)
    more = columns(tmp_path / "case" / "fit_1.parquet", "tau") - columns(folder / "one.csv", "tau")
    q = columns(folder / "one.csv", "q")[:, 1]
    np.testing.assert_allclose(more[:, 0], 0.0, atol=1e-12)
    # But for what smoothing takes at the ends.
    inner = slice(100, -100)
    np.testing.assert_allclose(more[inner, 1], told["stiffness"] * (q - told["rest_position"])[inner], atol=0.01)


def test_masses_are_moved_by_fast_motion_too(tmp_path: Path) -> None:
    """A load that is not felt above a low-pass filter is none: the fast part of a motion would deny it."""
    t = np.arange(0.0, 10.0, 0.002)
    q = np.repeat(0.01 * chirp(t, 0.5, 10.0, 20.0)[:, None], 2, axis=1)
    noise = 1e-6 * np.random.default_rng(0).standard_normal(q.shape)
    both = {f"q_{j}": (q + noise)[:, k] for k, j in enumerate("ab")} | {f"tau_{j}": np.cos(t) for j in "ab"}
    csv.write_csv(pa.table({"t": t, **both}), tmp_path / "fast.csv")
    taken = take(RealRobot("two", URDF), tmp_path / "fast.csv", "fit_1.parquet")
    rotor = EFFECTS["rotor_inertia"].draw(np.random.default_rng(0), taken.motion, 1).of_strength(0.3)
    qdd = np.gradient(np.gradient(q[:, 1], t), t)
    expected = rotor.parameters(taken.motion)["rotor_inertia"] * qdd
    inner, none = slice(500, -500), np.zeros_like(q)
    whole, slow = (added(rotor, x, t, none)[:, 1] - expected for x in (taken.moved, taken.motion))
    assert np.std(whole[inner]) < 0.1 * np.std(expected[inner])
    assert np.std(slow[inner]) > 0.5 * np.std(expected[inner])


def test_motion_counts_up_to_where_its_positions_drown_in_noise() -> None:
    dt, rng, hz = 0.002, np.random.default_rng(1), 25.0
    # Twice summed white noise: its power at ``hz`` is ten times that of white noise of this size.
    walk = dt**2 * np.cumsum(np.cumsum(rng.standard_normal(20000)))
    size = dt**2 / np.sqrt(10.0) / (2.0 * np.sin(np.pi * hz * dt)) ** 2
    told = told_hz(np.stack((walk, walk + size * rng.standard_normal(20000)), 1), dt)
    assert told[1] == pytest.approx(hz, rel=0.3)
    assert told[0] > 2.0 * hz


def test_sensors_change_what_they_measured(folder: Path) -> None:
    robot = RealRobot("two", URDF)
    taken = take(robot, folder / "one.csv", "fit_1.parquet")
    gain = EFFECTS["torque_scale"].draw(np.random.default_rng(0), taken.motion, 0).of_strength(0.1)
    tau = columns(folder / "one.csv", "tau")
    more = added(gain, taken.motion, taken.table["t"], tau)
    scale = gain.parameters(taken.motion)["gain"] - 1.0
    np.testing.assert_allclose(more, np.stack((scale * tau[:, 0], np.zeros(len(tau))), axis=1), atol=1e-12)


def test_size_is_what_rigid_body_and_friction_leave(folder: Path) -> None:
    robot = RealRobot("two", URDF)
    taken = [take(robot, folder / name, name) for name in ("one.csv", "two.csv")]
    yardstick = RealYardstick(taken)
    effect = draw_hidden(np.random.default_rng(3), "torque_ripple", 0.08, yardstick)
    # The same by a plain regression: ripple of some periods looks like neither rigid body nor friction.
    torque = np.concatenate([effect.torque(r.motion) for r in taken])
    Y = np.concatenate([robot.regressor(r.motion.q, r.motion.qd, r.motion.qdd) for r in taken])
    qd = np.concatenate([r.motion.qd for r in taken])
    j = effect.joint
    own = np.column_stack([Y[:, j], qd[:, j], np.sign(qd[:, j])])
    left = torque[:, j] - own @ np.linalg.lstsq(own, torque[:, j], rcond=1e-8)[0]
    measured = np.concatenate([r.torque[:, j] for r in taken])
    smooth = sosfiltfilt(butter(4, 10.0, fs=100.0, output="sos"), left)
    size = np.sqrt(np.mean(smooth**2) / np.mean(measured**2))
    assert size == pytest.approx(0.08, rel=0.15)
    assert float(yardstick.of(effect).left.max()) == pytest.approx(0.08, rel=0.03)


def test_same_seed_same_files_and_an_untouched_case(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in list(DATA_SETS):
        monkeypatch.delitem(DATA_SETS, name)
    monkeypatch.setitem(DATA_SETS, "two", DataSet(folder.name, "robot.urdf", ("one.csv",), "two.csv"))
    outs = [tmp_path / "x", tmp_path / "y"]
    for out in outs:
        generate(folder.parent, out, 3, 7)
    files = sorted(p.relative_to(outs[0]) for p in outs[0].rglob("*") if p.is_file())
    assert len(files) >= 3 * 4
    for file in files:
        assert (outs[0] / file).read_bytes() == (outs[1] / file).read_bytes()
    truths = [json.loads(p.read_text()) for p in (outs[0] / "truth").glob("*.json")]
    (untouched,) = (t for t in truths if t["tier"] == "untouched")
    assert {t["baseline"] for t in truths if t["tier"] == "injected"} == {untouched["id"]}
    case = outs[0] / "cases" / untouched["id"]
    np.testing.assert_array_equal(columns(case / "fit_1.parquet", "tau"), columns(folder / "one.csv", "tau"))


@pytest.mark.slow
def test_from_recordings_to_score(tmp_path: Path) -> None:
    case, out = tmp_path / "cases" / "1", tmp_path / "out" / "1"
    case.mkdir(parents=True)
    out.mkdir(parents=True)
    (case / "robot.urdf").write_text(BOUNDED)
    spring = {"stiffness": 2.0, "rest_position": 0.3}

    def pull(m: Motion) -> np.ndarray:
        return np.stack((np.zeros_like(m.t), spring["stiffness"] * (m.q[:, 1] - spring["rest_position"])), axis=1)

    for k, name in enumerate(("fit_1", "holdout")):
        record(tmp_path, f"{name}.csv", 10 + k, pull)
        parquet.write_table(csv.read_csv(tmp_path / f"{name}.csv"), case / f"{name}.parquet")
    nowhere = {"recordings": None, "time_s": None, "region": None}
    rest = {"links": [], "other": None, "where": nowhere, "indistinguishable": [], "in_holdout": True, "depends_on": []}
    truth = {
        "id": "1", "tier": "field", "robot": {"name": "two", "joints": ["a", "b"], "links": ["upper", "lower"]},
        "effects": [{"effect": "joint_spring", "joints": ["b"], "parameters": spring, "target_size": 0.16, **rest}],
        "background": [
            {"effect": "coulomb_friction", "joints": [j], "parameters": {"coulomb": 0.3}, "target_size": None, **rest}
            for j in "ab"
        ],
    }  # fmt: skip
    run.diagnose_case(case, out)
    fit, holdout = run.recordings(case)
    oracle = oracle_errors(case / "robot.urdf", fit, holdout, truth)
    diagnosis = json.loads((out / run.DIAGNOSIS).read_text())
    assert oracle is not None
    assert oracle["b"] < 0.1 * diagnosis["fit"]["rigid_body"]["nmse"]["b"]
    score = score_case(truth, diagnosis, 1.0, oracle)
    (one,) = score.effects
    assert one.exact
    assert max(one.errors) < 0.02
    assert score.gain_share == pytest.approx(1.0, abs=0.05)
    assert score.background == (True,)
    series = np.load(out / run.SERIES)
    assert series["measured"].shape == series["extended"].shape
