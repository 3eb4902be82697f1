"""Input that is meant to break things, or was made by mistake, ends with a message and exit code 2."""

import re
from pathlib import Path

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import joint_names, record

from torchrbd.cli import main

URDF = random_urdf(21, 2, kinds=("revolute",), branching=0.0, massless=0.0)
NAMES = joint_names(URDF)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hostile")
    (folder / "arm.urdf").write_text(URDF)
    chunk = next(iter(record(URDF, 21, duration_s=15.0).chunks(10**6)))
    table = {"t": chunk.t[:, None], "q": chunk.q, "tau": chunk.tau}
    for name, changed in {"day": (), "torque": ("tau",), "position": ("q",), "clock": ("t",)}.items():
        columns = [table[key] * (1e300 if key in changed else 1.0) for key in table]
        header = ",".join(["t", *(f"q_{n}" for n in NAMES), *(f"tau_{n}" for n in NAMES)])
        np.savetxt(folder / f"{name}.csv", np.hstack(columns), delimiter=",", header=header, comments="")
    return folder


def refused(capsys: pytest.CaptureFixture[str], *command: str | Path) -> str:
    assert main([str(word) for word in command]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert told.startswith("torchrbd: error: ")
    assert "Traceback" not in told
    return told


@pytest.mark.parametrize(
    ("pattern", "spoilt", "words"),
    [
        (r'<mass value="[^"]+"', '<mass value="1e300"', 'link .*: <mass value="1e300">: more than any robot has'),
        (r'<mass value="[^"]+"', '<mass value="1e-300"', "mass is 1e-300, less than 1e-09 kg"),
        (r'ixx="[^"]+"', 'ixx="1e300"', '<inertia ixx="1e300">: more than any robot has'),
        (r'<origin xyz="[^"]+"', '<origin xyz="1e200 0 0"', "more than any robot has"),
        (r'<axis xyz="[^"]+"', '<axis xyz="1e300 1e300 0"', "joint .*more than any robot has"),
    ],
)
def test_numbers_that_no_robot_has(
    pattern: str, spoilt: str, words: str, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.urdf").write_text(re.sub(pattern, spoilt, URDF))
    told = refused(capsys, "identify", tmp_path / "bad.urdf", case / "day.csv", "-o", tmp_path / "o")
    assert re.search(words, told)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("torque", "column 'tau_joint1', data row 1: .* is more than any sensor gives; correct the column"),
        ("position", "column 'q_joint1', data row 1: .* is more than any sensor gives"),
        ("clock", "column 't', data row 2: .* is more than any sensor gives"),
    ],
)
def test_values_that_no_sensor_gives(
    name: str, words: str, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = refused(capsys, "identify", case / "arm.urdf", case / f"{name}.csv", "-o", tmp_path / "o")
    assert re.search(words, told)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("encoder_noise: 1.0e+300", "expected a standard deviation above 0 in rad or m, at most 1"),
        ("encoder_noise: {joint1: [1]}", "encoder_noise of joint1 is '[1]'; expected a number"),
        ("encoder_noise: true", "encoder_noise is 'True'; expected a number"),
        ("encoder_noise: {joint1: true}", "encoder_noise of joint1 is true; expected a number"),
        ("cutoff: true", "cutoff_hz is true; expected a number"),
        ("seed: false", "seed is false; expected a number"),
        ("gravity: [true, 0, 0]", "gravity is true; expected a number"),
        ("time: [true, 5]", "expected FROM:TO in seconds"),
        ("cutoff: 1.0e-300", "expected at least 0.001 Hz"),
        ("seed: -3", "seed is -3; expected a whole number that is not negative"),
        ("cutoff: 5\nseed: 1\ncutoff: 6", "the key 'cutoff' stands twice"),
        ("joints: &all [joint1]\ntrust: *all", "repeats another part"),
        ("seed: !!python/object/apply:os.system ['true']", "could not determine a constructor"),
    ],
)
def test_settings_that_are_no_settings(
    content: str, words: str, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.yaml").write_text(content)
    told = refused(
        capsys, "identify", case / "arm.urdf", case / "day.csv", "-o", tmp_path / "o", "--config", tmp_path / "bad.yaml"
    )
    assert words in told


def test_a_key_that_stands_twice_in_a_mapping(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "map.yaml").write_text("joints: {joint1: {q: q_joint1}, joint1: {tau: tau_joint1}}")
    given = case / "arm.urdf", case / "day.csv"
    told = refused(capsys, "identify", *given, "-o", tmp_path / "o", "--mapping", tmp_path / "map.yaml")
    assert "the key 'joint1' stands twice" in told


def test_a_negative_seed_on_the_command_line(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = refused(capsys, "identify", case / "arm.urdf", case / "day.csv", "-o", tmp_path / "o", "--seed", "-1")
    assert "seed is -1" in told


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("excite arm.urdf --seed -3 -o m.csv", "seed is -3; expected a whole number that is not negative"),
        ("simulate arm.urdf day.csv -o day.csv", "'day.csv' is the recording; name another file for the motion"),
        ("simulate arm.urdf day.csv -o ./day.csv", "is the recording; name another file for the motion"),
        ("simulate arm.urdf day.csv --rate 1e12 -o m.csv", "rate is 1e+12; expected at most 100000 samples a second"),
        ("identify arm.urdf day.csv day.csv -o o", "'day.csv' is given twice; give it once"),
        ("identify arm.urdf day.csv ./day.csv -o o", "'day.csv' is given twice; give it once"),
        ("export day.csv --to mjcf -o m.xml", "give the folder that 'torchrbd identify -o' wrote, or its model"),
        ("simulate . day.csv -o m.csv", "give the folder that 'torchrbd identify -o' wrote, or its model"),
        ("identify arm.urdf empty.csv -o o", "1600 of 1600 rows dropped: a value is missing, in all rows of q_joint1"),
    ],
)
def test_slips_are_told_with_what_to_do(
    command: str, words: str, case: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = (case / "day.csv").read_bytes()
    (case / "empty.csv").write_text(
        f"t,q_{NAMES[0]},q_{NAMES[1]},tau_{NAMES[0]},tau_{NAMES[1]}\n"
        + "".join(f"{k / 100},,{k % 7},1,{k % 3}\n" for k in range(1600))
    )
    monkeypatch.chdir(case)
    assert words in refused(capsys, *command.split())
    assert (case / "day.csv").read_bytes() == before
