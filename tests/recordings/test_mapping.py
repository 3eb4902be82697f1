"""Check mappings: units, signs, gears, currents, patterns, and what is said about mistakes."""

import textwrap
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml

from torchrbd.errors import RecordingError
from torchrbd.recordings import open_recording, read_mapping
from torchrbd.recordings.mapping_file import MappingFile

CONFIGS = Path(__file__).parents[2] / "configs"


def write(tmp_path, text):
    path = tmp_path / "map.yaml"
    path.write_text(textwrap.dedent(text))
    return path


def read_row(tmp_path, mapping, header, row, joints):
    path = tmp_path / "r.csv"
    path.write_text(f"{header}\n{row}\n{row}\n")
    recording = open_recording(path, joints, mapping=mapping)
    return next(recording.chunks())


def test_motor_drive(tmp_path):
    header = "stamp,motor_angle,motor_speed,motor_current,output_angle,rail,force"
    mapping = read_mapping(CONFIGS / "mapping_motor_drive.yaml")
    chunk = read_row(tmp_path, mapping, header, "5,9000,60,1500,-60,250,2", ["joint1", "joint2"])
    assert chunk.q[0] == pytest.approx([-np.pi / 2 + 0.5236, 0.25])
    assert chunk.tau[0] == pytest.approx([-1.5 * 0.12 * 100, 2 * 0.98 * 1000])
    assert chunk.qd is None
    assert chunk.q_link is not None
    assert chunk.q_link[0] == pytest.approx([-np.pi / 3, np.nan], nan_ok=True)
    assert mapping.source("joint1", 0, "qd").scale == pytest.approx(-2 * np.pi / 60 / 100)
    assert mapping.time.scale == 1e-6


@pytest.mark.parametrize(
    ("name", "header", "joints"),
    [
        (
            "ros2_joint_states",
            "__time," + ",".join(f"/joint_states/j/{x}" for x in ("position", "velocity", "effort")),
            ["j"],
        ),
        ("ur_rtde", "timestamp,actual_q_0,actual_qd_0,actual_current_0", ["shoulder_pan_joint"]),
        ("franka", "time, state.q[0], state.dq[0], state.tau_J[0]", ["panda_joint1"]),
    ],
)
def test_driver_examples(tmp_path, name, header, joints):
    mapping = read_mapping(CONFIGS / f"mapping_{name}.yaml")
    if name == "ur_rtde":
        mapping = type(mapping)(mapping.file, mapping.time, {"*": mapping.joints["*"]})
    chunk = read_row(tmp_path, mapping, header, "7,0.1,0.2,0.3", joints)
    assert chunk.q[0, 0] == 0.1
    assert chunk.qd is not None
    assert chunk.qd[0, 0] == 0.2
    assert chunk.tau[0, 0] == pytest.approx(0.3 * (10.1 if name == "ur_rtde" else 1))


def test_every_example_is_read():
    assert len(list(CONFIGS.glob("mapping_*.yaml"))) == 6
    for path in CONFIGS.glob("mapping_*.yaml"):
        assert read_mapping(path).joints or read_mapping(path).drives


def test_short_form_and_precedence(tmp_path):
    path = write(tmp_path, "joints: {'*': {q: 'p_{joint}', tau: 'f{index}'}, b: {q: special}}")
    chunk = read_row(tmp_path, read_mapping(path), "t,p_a,special,f0,f1", "0,1,2,3,4", ["a", "b"])
    assert np.concatenate([chunk.q[0], chunk.tau[0]]).tolist() == [1, 2, 3, 4]


def test_delay_of_torques(tmp_path):
    mapping = read_mapping(write(tmp_path, "torque_delay: -0.004"))
    path = tmp_path / "r.csv"
    path.write_text("t,q_a,tau_a\n0,1,2\n")
    assert open_recording(path, ["a"], mapping=mapping).torque_delay_s == -0.004
    assert open_recording(path, ["a"], mapping=mapping).of_joints(["a"]).torque_delay_s == -0.004


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("jonts: {}", r"the file: unknown key 'jonts' \(did you mean 'joints'\?\); valid keys are time, joints"),
        ("torque_delay: true", "torque_delay: expected a number, got True"),
        ("torque_delay: 4", "torque_delay: expected seconds, at most 1 either way, got 4"),
        ("joints: {a: {tua: x}}", r"joints.a: unknown key 'tua' \(did you mean 'tau'\?\)"),
        ("joints: {a: {q: {column: x, units: deg}}}", r"joints.a.q: unknown key 'units' \(did you mean 'unit'\?\)"),
        (
            "joints: {a: {q: {column: x, unit: grad}}}",
            "joints.a.q.unit: unknown unit 'grad'; valid units are rad, mrad, deg",
        ),
        ("joints: {a: {q: {unit: deg}}}", "line 1: joints.a.q: 'column' is missing"),
        ("joints: {a: {q: {column: x, sign: 2}}}", "joints.a.q.sign: expected 1 or -1, got 2"),
        ("joints: {a: {q: {column: x, gear_ratio: 0}}}", "joints.a.q.gear_ratio: zero would erase"),
        ("joints: {a: {q: {column: x, scale: big}}}", "joints.a.q.scale: expected a number, got 'big'"),
        ("joints: {a: {tau: {current: x}}}", "joints.a.tau: a current needs its torque_constant"),
        ("joints: {a: {q: {current: x}}}", "joints.a.q: unknown key 'current'"),
        (
            "joints: {a: 3}",
            "joints.a: expected q or qd or qdd or tau or q_ref or q_link or temperature or drive, got 3",
        ),
        ("joints: [a]", r"joints: expected one key for each joint, got \['a'\]"),
        ("joints: {1: {}}", "the key 1 must be text"),
        ("time: {column: t, unit: h}", "time.unit: unknown unit 'h'; valid units are s, ms, us, ns"),
        ("", "the file: expected time or joints or topic or episodes or torque_delay or set_point_delay, got None"),
        ("a: [", "is not YAML in UTF-8"),
        (
            "joints:\n  a:\n    q: {column: x}\n    tau: {column: y, unit: Nmm, ratio: 2}",
            "line 4: joints.a.tau: unknown key 'ratio'",
        ),
        ("joints:\n  a:\n    q:\n      column: x\n      sign: 2", "line 5: joints.a.q.sign: expected 1"),
        ("joints:\n  a: {}\n  b: {q: {unit: rad}}", "line 3: joints.b.q: 'column' is missing"),
        ("topic: 3", "line 1: topic: expected a name"),
        ("episodes: [-1]", "line 1: episodes: expected numbers from 0"),
    ],
)
def test_mistakes(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(RecordingError, match=message) as caught:
        read_mapping(path)
    assert str(path) in str(caught.value)


def test_mapping_that_does_not_fit(tmp_path):
    with pytest.raises(RecordingError, match="cannot read the mapping"):
        read_mapping(tmp_path / "none.yaml")
    mapping = read_mapping(write(tmp_path, "joints: {elbw: {q: x}}"))
    with pytest.raises(RecordingError, match=r"no joint 'elbw' \(did you mean 'elbow'\?\)"):
        read_row(tmp_path, mapping, "t", "0", ["elbow"])
    mapping = read_mapping(write(tmp_path, "joints: {elbow: {tau: {column: trq}}}"))
    with pytest.raises(RecordingError, match="missing columns: trq"):
        read_row(tmp_path, mapping, "t,q_elbow,tau_elbow", "0,1,2", ["elbow"])


def test_the_schema_has_every_key_with_what_it_means():
    schema = MappingFile.model_json_schema()
    tables = [schema, *schema["$defs"].values()]
    keys = {key: entry for table in tables for key, entry in table.get("properties", {}).items()}
    assert {"time", "joints", "topic", "episodes", "torque_delay", "gear_ratio", "torque_constant"} <= keys.keys()
    assert all(len(entry["description"]) > 5 for entry in keys.values())
    assert all(table["additionalProperties"] is False for table in tables)


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("mapping_*.yaml")), ids=lambda path: path.name)
def test_examples_fit_the_schema(path):
    content = yaml.safe_load(path.read_text())
    jsonschema.validate(content, MappingFile.model_json_schema())
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(content | {"jonts": {}}, MappingFile.model_json_schema())
