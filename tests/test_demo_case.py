"""The bundled demo case is small, readable, physical, and what ``examples/demo_case.py`` records."""

# pyright: reportAttributeAccessIssue=false
# (Pinocchio ships no type stubs)

import importlib.util
import json
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from torchrbd import diagnose
from torchrbd.cli.tables import print_diagnosis
from torchrbd.effects import known_effects
from torchrbd.export.json_files import write_diagnosis
from torchrbd.report import write_report
from torchrbd.report.text.numbers import number

ROOT = Path(__file__).resolve().parents[1]
DEMO = ROOT / "torchrbd" / "demo"
JOINTS = [f"joint{i}" for i in range(1, 7)]


def moving_joints() -> dict[str, ET.Element]:
    robot = ET.parse(DEMO / "arm.urdf").getroot()
    return {j.attrib["name"]: j for j in robot.iter("joint") if j.attrib["type"] != "fixed"}


def read(path: Path) -> dict[str, np.ndarray]:
    table = pq.read_table(path)
    return {name: table[name].to_numpy() for name in table.column_names}


def test_bundled_data_is_small():
    assert sum(f.stat().st_size for f in DEMO.iterdir() if f.is_file()) < 1.5e6


def test_urdf_holds_moving_joints_and_physical_inertias():
    assert list(moving_joints()) == JOINTS
    robot = ET.parse(DEMO / "arm.urdf").getroot()
    assert not list(robot.iter("dynamics")), "friction is what the URDF does not hold"
    for inertia in robot.iter("inertia"):
        xx, xy, xz, yy, yz, zz = (float(inertia.attrib[k]) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert moments[0] > 0
        assert moments[0] + moments[1] > moments[2]


@pytest.mark.parametrize(("name", "seconds"), [("fit", 40.0), ("holdout", 20.0)])
def test_recordings_have_the_columns_and_clock(name, seconds):
    data = read(DEMO / f"{name}.parquet")
    assert set(data) == {"t"} | {f"{s}_{j}" for s in ("q", "tau") for j in JOINTS}
    np.testing.assert_allclose(np.diff(data["t"]), 1 / 250)
    assert len(data["t"]) == seconds * 250
    assert all(np.isfinite(x).all() for x in data.values())
    steps = data["q_joint3"] / (2 * np.pi / 2**17)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_motion_stays_within_the_limits():
    limits = {name: next(joint.iter("limit")).attrib for name, joint in moving_joints().items()}
    for name in ("fit", "holdout"):
        data = read(DEMO / f"{name}.parquet")
        for joint, limit in limits.items():
            q = data[f"q_{joint}"]
            assert float(limit["lower"]) < q.min() < q.max() < float(limit["upper"])
            assert np.abs(np.gradient(q, data["t"])).max() < float(limit["velocity"]) * 1.05  # encoder noise: 2 %


def test_residual_of_the_true_rigid_body_is_the_concealed_friction():
    pin = pytest.importorskip("pinocchio")
    truth = json.loads((DEMO / "truth.json").read_text())
    assert (truth["effect"], truth["joint"], truth["unit"]) == ("coulomb_friction", "joint3", "N m")
    model = pin.buildModelFromUrdf(str(DEMO / "arm.urdf"))
    for name, pi in truth["inertials"].items():
        body = model.frames[model.getFrameId(name)].parentJoint
        model.inertias[body] = pin.Inertia.FromDynamicParameters(np.array(pi))
    data, record = model.createData(), read(DEMO / "fit.parquet")
    q, tau = (np.stack([record[f"{s}_{j}"] for j in JOINTS], 1) for s in ("q", "tau"))
    window = 25  # central local quadratic over +-0.1 s
    s = np.arange(-window, window + 1) / 250
    smooth = np.linalg.pinv(np.stack([np.ones_like(s), s, s**2 / 2, s**3 / 6, s**4 / 24], 1))[:3]
    q, qd, qdd = (np.stack([np.convolve(x, row[::-1], "valid") for x in q.T], 1) for row in smooth)
    rows = slice(None, None, 10)
    predicted = np.array([pin.rnea(model, data, *state) for state in zip(q[rows], qd[rows], qdd[rows], strict=True)])
    residual = tau[window:-window][rows] - predicted
    moving = np.abs(qd[rows, 2]) > 0.1
    sign = np.sign(qd[rows, 2])[moving]
    coulomb = sign @ residual[moving, 2] / len(sign)
    assert coulomb == pytest.approx(truth["value"], rel=0.01)
    residual[:, 2] -= coulomb * np.sign(qd[rows, 2])
    share = residual[moving].std(0) / tau.std(0)
    assert share.max() < 0.05, f"only the torque sensor's noise is left, got {share}"


@pytest.mark.slow
def test_same_seed_records_the_same(tmp_path):
    pytest.importorskip("mujoco")
    spec = importlib.util.spec_from_file_location("demo_case", ROOT / "examples" / "demo_case.py")
    assert spec is not None
    assert spec.loader is not None
    demo_case = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(demo_case)
    demo_case.record(tmp_path, seed=3, effect="coulomb_friction", joint="joint3", value=2.4)
    for name in ("fit", "holdout"):
        old, new = read(DEMO / f"{name}.parquet"), read(tmp_path / f"{name}.parquet")
        for column, x in new.items():
            off = np.abs(x - old[column])
            assert off.max() < 1.1e-3, column  # one quantum, where another machine rounds the other way ...
            assert np.mean(off > 1e-6) < 1e-3, column  # ... which is rare
    assert json.loads((tmp_path / "truth.json").read_text())["value"] == 2.4


def first_screen(page: str) -> str:
    return page.partition("<h2>Motion error")[0]


@pytest.mark.slow
def test_the_demo_has_one_finding_and_says_one_thing(tmp_path, capsys):
    diagnosed = diagnose(DEMO / "arm.urdf", [DEMO / "fit.parquet"], holdout=[DEMO / "holdout.parquet"])
    print_diagnosis(diagnosed)
    write_report(diagnosed, tmp_path / "report.html")
    write_diagnosis(diagnosed, tmp_path / "diagnosis.json")
    saved = json.loads((tmp_path / "diagnosis.json").read_text())
    (finding,) = saved["findings"]
    assert (finding["effect"], finding["joints"]) == ("coulomb_friction", ["joint3"])
    assert (saved["not_confirmed"], saved["ranking"]["adopted"]) == ([], [])
    coulomb = finding["parameters"]["coulomb"]
    assert coulomb["value"] == pytest.approx(2.4, abs=2 * coulomb["std"])
    console, page = capsys.readouterr().out, (tmp_path / "report.html").read_text()
    others = [one.words for name, one in known_effects().items() if name != "coulomb_friction"]
    for shown in (console, first_screen(page)):
        assert [words for words in others if words in " ".join(shown.split())] == []
    # One error, once: the card has that of the table.
    nmse = {model: fit["nmse"]["joint3"] for model, fit in saved["fit"].items()}
    card = first_screen(page)
    assert all(number(nmse[model]) in card for model in ("rigid_body", "extended"))
    assert finding["nmse_after"]["joint3"] == pytest.approx(nmse["extended"], rel=1e-3)
    assert f"to {number(nmse['extended'])} with it" in " ".join(card.split())
    assert nmse["extended"] < finding["nmse_before"]["joint3"] < nmse["rigid_body"], "baseline friction absorbs a part"
