"""``torchrbd inspect`` says what a file holds and what is wrong with it, and writes a mapping that works."""

import re

import numpy as np
import pytest
from recordings.test_lerobot import data_set
from recordings.test_ros_bags import ros2_bag, states
from rosbags import rosbag2

from torchrbd.cli import main
from torchrbd.recordings import inspect_recording, open_recording, read_mapping
from torchrbd.recordings.mapping import (
    CURRENT_UNITS,
    TIME_UNITS,
    UNITS,
)
from torchrbd.recordings.mapping_file import KEYS

CLOCK = np.arange(0, 20, 0.01)
JOINTS = ("lift", "turn")
URDF = """<robot name="arm"><link name="base"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="0" upper="0.5" effort="100" velocity="1"/></joint>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="10" velocity="4"/></joint>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"""


def columns(**changes):
    """Return a rich motion of a slide and a hinge."""
    rng = np.random.default_rng(1)
    found = {
        "t": CLOCK,
        "q_lift": 0.25 + 0.2 * np.sin(2 * np.pi * 0.31 * CLOCK),
        "q_turn": 1.2 * np.sin(2 * np.pi * 0.57 * CLOCK) + 0.5 * np.sin(2 * np.pi * 0.23 * CLOCK),
        "tau_lift": 20 + 2 * np.sin(2 * np.pi * 0.31 * CLOCK) + 0.1 * rng.normal(size=len(CLOCK)),
        "tau_turn": 5 * np.sin(2 * np.pi * 0.57 * CLOCK) + 0.05 * rng.normal(size=len(CLOCK)),
    }
    return found | changes


def write(path, table, names=None):
    header = ",".join(names or table)
    np.savetxt(path, np.column_stack(list(table.values())), "%.9g", ",", header=header, comments="")
    return path


@pytest.fixture
def look(tmp_path, capsys, monkeypatch):
    """Return what the command prints, in one line, and where its mapping is."""
    monkeypatch.setenv("COLUMNS", "200")

    def run(file, *options, code=0):
        assert main(["inspect", str(file), *map(str, options)]) == code
        told = capsys.readouterr()
        return " ".join((told.out if code == 0 else told.err).split())

    (tmp_path / "arm.urdf").write_text(URDF)
    return run


def test_a_joint_without_torque_hides_no_other(tmp_path, look):
    without = {name: x for name, x in columns().items() if name != "tau_lift"}
    told = look(write(tmp_path / "r.csv", without), tmp_path / "arm.urdf")
    noise = re.search(r"tau_turn │ \S+ │ \S+ │ (\S+) │ – │ 0 │", told)
    assert noise is not None
    assert float(noise[1]) == pytest.approx(0.05, rel=0.1)


def test_a_sound_recording(tmp_path, look):
    write(tmp_path / "r.csv", columns())
    told = look(tmp_path / "r.csv", tmp_path / "arm.urdf", "-o", tmp_path / "map.yaml")
    assert "r.csv: 2 joints, 2000 rows, 100 Hz, 19.99 s, no gaps" in told
    assert "warning" not in told
    assert re.search(r"lift │ 0.0500 │ 0.450 │ 0.27\d │ 12 │ yes", told)
    noise = re.search(r"tau_turn │ \S+ │ \S+ │ (\S+) │ – │ 0 │", told)
    assert noise is not None
    assert float(noise[1]) == pytest.approx(0.05, rel=0.1)
    text = (tmp_path / "map.yaml").read_text()
    assert 'q: {column: "q_lift", unit: m}' in text
    assert 'tau: {column: "tau_turn", unit: N m}' in text
    mapped = open_recording(tmp_path / "r.csv", JOINTS, mapping=read_mapping(tmp_path / "map.yaml"))
    for one, other in zip(mapped.chunks(), open_recording(tmp_path / "r.csv", JOINTS).chunks(), strict=True):
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.tau, other.tau)
    assert "exists, and may have been edited" in look(tmp_path / "r.csv", "-o", tmp_path / "map.yaml", code=2)


def test_what_is_wrong_is_told(tmp_path, look):
    q = columns()["q_turn"]
    write(
        tmp_path / "r.csv",
        columns(
            t=np.round(1000 * CLOCK),
            q_turn=np.round(np.rad2deg(q)),
            q_lift=np.linspace(0.1, 0.11, len(CLOCK)),
            tau_turn=np.clip(columns()["tau_turn"], -3.5, 4),
            tau_lift=np.repeat(columns()["tau_lift"][::5], 5),
        ),
    )
    told = look(tmp_path / "r.csv", tmp_path / "arm.urdf", "-o", tmp_path / "map.yaml")
    for words in (
        "t looks like ms: if so, say 'unit: ms' in the mapping",
        "q_turn looks like deg",
        "tau_turn is cut off at -3.5 and 4: leave these times out",
        "tau_lift keeps each value for 5 rows",
        "little range, slow, never turns back",
    ):
        assert words in told
    text = (tmp_path / "map.yaml").read_text()
    assert 'time: {column: "t", unit: ms}  # a guess, from the size of the values: if it is wrong, write s' in text
    assert 'q: {column: "q_turn", unit: deg}  # a guess, from the size of the values: if it is wrong, write rad' in text
    assert 'q: {column: "q_lift", unit: m}\n' in text
    told = look(tmp_path / "r.csv", tmp_path / "arm.urdf", "--mapping", tmp_path / "map.yaml")
    assert "looks like" not in told
    assert "2000 rows, 100 Hz" in told


def test_a_guess_of_a_unit_keeps_what_the_mapping_says(tmp_path, look):
    """Time in microseconds that a mapping calls milliseconds; degrees that it turns round."""
    table = columns(t=1e6 * CLOCK, q_turn=np.rad2deg(columns()["q_turn"]))
    write(tmp_path / "r.csv", table)
    (tmp_path / "one.yaml").write_text("time: {column: t, unit: ms}\njoints: {turn: {q: {column: q_turn, sign: -1}}}")
    arm = tmp_path / "arm.urdf"
    look(tmp_path / "r.csv", arm, "--mapping", tmp_path / "one.yaml", "-o", tmp_path / "two.yaml")
    text = (tmp_path / "two.yaml").read_text()
    assert 'time: {column: "t", unit: us}  # a guess' in text
    assert 'q: {column: "q_turn", unit: deg, scale: -1.0}  # a guess' in text
    (mapped,) = open_recording(tmp_path / "r.csv", JOINTS, mapping=read_mapping(tmp_path / "two.yaml")).chunks()
    np.testing.assert_allclose(mapped.t, CLOCK, atol=1e-9)
    np.testing.assert_allclose(mapped.q[:, 1], -columns()["q_turn"], atol=1e-8)


def test_the_head_of_a_mapping_explains_every_key_and_unit(tmp_path, look):
    look(write(tmp_path / "r.csv", columns()), "-o", tmp_path / "map.yaml")
    text = (tmp_path / "map.yaml").read_text()
    head = [line for line in text.splitlines() if line.startswith("#")]
    assert text.startswith("\n".join(head))
    assert "docs/guide/recordings.md" in head[1]
    assert "README" not in text
    words = {line[1:].split()[0] for line in head}
    assert KEYS - {"joints"} <= words
    for units in (TIME_UNITS, CURRENT_UNITS, *UNITS.values()):
        assert any(", ".join(units) in line for line in head)
    assert max(map(len, text.splitlines())) <= 120
    assert len(head) < 35


def test_coarse_steps_and_gaps(tmp_path, look):
    table = {name: np.delete(x, slice(500, 700)) for name, x in columns().items()}
    write(tmp_path / "r.csv", table | {"q_turn": np.round(table["q_turn"] / 0.05) * 0.05})
    told = look(tmp_path / "r.csv")
    assert "2 pieces with gaps between them" in told
    assert re.search(r"q_turn has only \d\d steps of 0.05 in its range", told)


def test_torque_is_not_needed(tmp_path, look):
    write(tmp_path / "r.csv", {name: x for name, x in columns().items() if not name.startswith("tau")})
    assert "give their gains in a mapping" in look(tmp_path / "r.csv", tmp_path / "arm.urdf")


@pytest.mark.parametrize("robot", [False, True])
def test_unknown_names_are_guessed(tmp_path, look, robot):
    names = ["timestamp", "actual_q_0", "actual_q_1", "actual_current_0", "actual_current_1"]
    write(tmp_path / "r.csv", columns() | {"target_q_0": CLOCK}, [*names, "target_q_0"])
    more = [tmp_path / "arm.urdf"] if robot else []
    told = look(tmp_path / "r.csv", *more, "-o", tmp_path / "map.yaml")
    assert "6 columns, not matched with joints" in told
    assert "problem: " in told
    text = (tmp_path / "map.yaml").read_text()
    joint = "lift" if robot else "joint1"
    assert (
        f'"{joint}":\n    q: {{column: "actual_q_0", unit: rad}}  # guessed\n    tau: {{current: "actual_current_0"'
        in text
    )
    assert '# other columns: "target_q_0"' in text
    told = look(tmp_path / "r.csv", *more, "--mapping", tmp_path / "map.yaml")
    assert "2 joints, 2000 rows, 100 Hz" in told


def test_names_of_joints_in_columns(tmp_path, look):
    names = ["stamp", "lift.pos", "turn.pos", "lift.torque", "turn.torque"]
    write(tmp_path / "r.csv", columns(), names)
    look(tmp_path / "r.csv", tmp_path / "arm.urdf", "-o", tmp_path / "map.yaml")
    assert 'tau: {column: "turn.torque", unit: N m}' in (tmp_path / "map.yaml").read_text()


def test_units_that_the_names_hold_are_guessed(tmp_path, look):
    names = ["Zeit_ms", "J1_pos_deg", "J2_Winkel [Grad]", "J1_current_mA", "J2_Strom_A"]
    scaled = [CLOCK * 1e3, *(np.degrees(columns()[q]) for q in ("q_lift", "q_turn")), CLOCK, CLOCK]
    write(tmp_path / "r.csv", dict(zip(names, scaled, strict=True)))
    look(tmp_path / "r.csv", tmp_path / "arm.urdf", "-o", tmp_path / "map.yaml")
    text = (tmp_path / "map.yaml").read_text()
    assert 'time: {column: "Zeit_ms", unit: ms}  # guessed' in text
    assert 'q: {column: "J1_pos_deg", unit: deg}' in text
    assert 'q: {column: "J2_Winkel [Grad]", unit: deg}' in text
    assert 'tau: {current: "J1_current_mA", unit: mA, torque_constant: 1.0' in text
    assert 'tau: {current: "J2_Strom_A", unit: A, torque_constant: 1.0' in text


def test_a_current_stays_a_current_and_a_constant_of_one_is_named(tmp_path, look):
    write(tmp_path / "r.csv", columns())
    text = "joints:\n  lift: {{tau: {{current: tau_lift, torque_constant: {}, sign: -1}}}}\n"
    (tmp_path / "one.yaml").write_text(text.format(1.0))
    (tmp_path / "real.yaml").write_text(text.format(12.5))
    told = look(tmp_path / "r.csv", tmp_path / "arm.urdf", "--mapping", tmp_path / "one.yaml")
    assert "torque_constant times gear_ratio is 1 for lift. The torque is then the current in ampere" in told
    told = look(
        tmp_path / "r.csv", tmp_path / "arm.urdf", "--mapping", tmp_path / "real.yaml", "-o", tmp_path / "map.yaml"
    )
    assert "torque_constant times" not in told
    assert 'tau: {current: "tau_lift", unit: A, torque_constant: 12.5, sign: -1}' in (tmp_path / "map.yaml").read_text()
    assert read_mapping(tmp_path / "map.yaml").source("lift", 0, "tau").scale == -12.5


def test_a_set_without_torque_and_with_other_names(tmp_path, look):
    names = [f"motor_{name}.pos" for name in ("a", "b")]
    path = data_set(tmp_path / "set", {"motors": names}, "observation.nothing")
    told = look(path, tmp_path / "arm.urdf", "-o", tmp_path / "map.yaml")
    assert "no column looks like a torque or a motor current" in told
    assert "if position drives follow recorded set-points, give their gains in a mapping" in told
    text = (tmp_path / "map.yaml").read_text()
    assert '"lift":\n    q: {column: "observation.state/motor_a.pos", unit: rad}  # guessed' in text
    assert '"turn":\n    q: {column: "observation.state/motor_b.pos", unit: rad}  # guessed' in text


def test_torques_of_other_names_are_guessed(tmp_path, look):
    path = data_set(tmp_path / "set", effort="observation.present_current")
    told = look(path, "-o", tmp_path / "map.yaml")
    assert "set: 2 joints, 270 rows, 50 Hz, 5.3 s, 3 pieces with gaps between them" in told
    assert "problem: " in told
    assert "; if observation.present_current/a, observation.present_current/b hold torques or motor currents" in told
    assert 'tau: {current: "observation.present_current/a", unit: A' in (tmp_path / "map.yaml").read_text()
    assert "problem:" not in look(path, "--mapping", tmp_path / "map.yaml")


def test_bags(tmp_path, look):
    path = ros2_bag(tmp_path / "bag", {"/joint_states": states()}, rosbag2.StoragePlugin.MCAP)
    assert "bag: 2 joints, 300 rows, 100 Hz" in look(path)
    assert inspect_recording(path).joints == ("b", "a")
    two = ros2_bag(tmp_path / "two", {"/l": states(), "/r": states()}, rosbag2.StoragePlugin.MCAP)
    assert "topic: /l" in look(two, code=2)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("r.csv", "t,q_a\n0,1\n", "too short to learn anything from"),
        ("r.csv", "t,q_a\n0,x\n", "expected a number, got 'x'"),
        ("r.doc", "", "cannot read '.doc' files"),
        ("none.csv", None, "no such file"),
    ],
)
def test_files_that_cannot_be_read(tmp_path, look, name, content, words):
    if content is not None:
        (tmp_path / name).write_text(content)
    assert words in look(tmp_path / name, code=2)
