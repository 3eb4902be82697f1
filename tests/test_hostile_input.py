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
    # Work of over two seconds says before how far it is.
    lines = [line for line in capsys.readouterr().err.splitlines() if not re.match(r"torchrbd: [\d.]+ (s|min), ", line)]
    told = " ".join(" ".join(lines).split())
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


@pytest.fixture(scope="module")
def results(case: Path) -> Path:
    """A folder with results of commands, and files that are none."""
    (case / "folder").mkdir()
    (case / "nothing.csv").write_text("")
    (case / "nothing.urdf").write_text("")
    (case / "nothing.stats").write_text("")
    (case / "other.json").write_text('{"a": 1}')
    (case / "robots.yaml").write_text("robots:\n  - {name: one, urdf: arm.urdf, recordings: [day.csv]}\n")
    arm, day = str(case / "arm.urdf"), str(case / "day.csv")
    assert main(["identify", arm, day, "-o", str(case / "fit")]) == 0
    assert main(["diagnose", arm, day, "-o", str(case / "found"), "--effects", "joint_spring"]) == 0
    assert main(["stats", arm, day, "-o", str(case / "sums"), "--cutoff", "5"]) == 0
    return case


_LIMITS = "--range joint1=-1:1 joint2=-1:1 --velocity joint1=2 joint2=2 --effort joint1=500 joint2=500"
EXCITE = f"excite arm.urdf -o m.csv {_LIMITS}"


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("merge folder -o m.stats", "folder: is a folder; give the files in it, e.g. folder/*.stats"),
        ("merge none.stats -o m.stats", "none.stats: no such file; check the path"),
        ("merge nothing.stats -o m.stats", "nothing.stats: is no statistics file, or is damaged; give those that 'tor"),
        ("merge day.csv -o m.stats", "day.csv: is no statistics file, or is damaged; give those that 'torchrbd stats"),
        ("merge fit/model.safetensors -o m.stats", "is no statistics file; give those that 'torchrbd stats' wrote"),
        ("merge sums/day.csv.stats -o sums/day.csv.stats", "is one of the files to add; name another for the sum"),
        ("identify day.csv day.csv -o o", "day.csv: not well-formed XML: Start tag expected, '<' not found, line 1,"),
        ("identify nothing.urdf day.csv -o o", "nothing.urdf: the file is empty; expected a URDF or MJCF file"),
        ("identify arm.urdf none.csv -o o", "none.csv: no such file; check the path"),
        ("identify arm.urdf nothing.csv -o o", "nothing.csv: the file is empty; leave it out, or record again"),
        ("identify arm.urdf day.csv -o o --mapping folder", "folder: cannot read the mapping: Is a directory; name a"),
        ("identify arm.urdf day.csv -o o --time nan:5", "expected FROM:TO in seconds"),
        ("identify arm.urdf day.csv -o o --gravity 1e300 0 0", "gravity is [1e+300, 0.0, 0.0]; expected three number"),
        ("identify arm.urdf day.csv -o o --payload day.csv=1e300,0,0,0", "with a mass above zero, at most 1e+06 kg"),
        ("identify arm.urdf day.csv -o o --payload day.csv=1,1e300,0,0", "within 1000 m"),
        (
            "identify arm.urdf day.csv -o o --encoder-noise 1e-300",
            "encoder_noise is 1e-300; expected a standard dev",
        ),
        (f"{EXCITE} --velocity joint1=1e-300", "greatest speed of 'joint1' is 1e-300; expected a positive number"),
        ("stats arm.urdf day.csv day.csv --cutoff 5 -o o", "'day.csv' is given twice; give it once"),
        ("compare found fit/parameters.json", "fit/parameters.json: is no diagnosis.json"),
        ("export fit --to urdf -o fit/model.safetensors", "output 'fit/model.safetensors': expected a file that ends"),
        ("export fit --to mjcf -o day.csv", "output 'day.csv': expected a file that ends in .xml"),
        ("export fit --to urdf -o day.csv/m.urdf", "output 'day.csv/m.urdf': its folder cannot be made"),
        ("export sums/day.csv.stats --to urdf", "is no model of torchrbd; give the folder that 'torchrbd identify -o"),
        ("simulate arm.urdf day.csv -o day.csv/m.csv", "output 'day.csv/m.csv': its folder cannot be made"),
        ("simulate arm.urdf day.csv -o m.csv --from -1", "start is -1 s; expected a number that is not negative"),
        ("simulate arm.urdf day.csv -o m.csv --from nan", "start is nan s; expected a number that is not negative"),
        ("simulate arm.urdf day.csv -o m.csv --gravity nan 0 0", "gravity is [nan, 0.0, 0.0]; expected three numbers"),
        ("simulate arm.urdf day.csv -o m.csv --cutoff -1", "cut-off -1 Hz: expected a number above zero"),
        ("simulate arm.urdf day.csv -o m.csv --rate 1e-9", "hold no step of 1e+09 s; simulate longer, or give a high"),
        ("excite arm.urdf -o day.csv/m.csv", "output 'day.csv/m.csv': its folder cannot be made"),
        (f"{EXCITE} --harmonics 100000", "harmonics is 100000; expected at most 100"),
        (f"{EXCITE} --periods 1000000000", "1000000000 periods of 10 s at 100 Hz are 1e+12 samples; expected at most"),
        (f"{EXCITE} --rate 1e-6", "rate is 1e-06 Hz; expected more than 1 Hz, twice the highest frequency of the mot"),
        (f"{EXCITE} --gravity 1e300 0 0", "gravity is [1e+300, 0.0, 0.0]; expected three numbers of at most 1000 m/s"),
        (f"{EXCITE} --velocity joint1=1e300", "greatest speed of 'joint1' is 1e+300; expected a positive number"),
        (f"{EXCITE} --range joint1=1e300:2e300", "range of 'joint1' is 1e+300 to 2e+300; expected two numbers, the l"),
        (f"{EXCITE} --effort joint1=1e-6", "breaks the torque of joint1, by more than 1000 times it"),
        ("inspect day.csv -o day.csv/m.yaml", "output 'day.csv/m.yaml': its folder cannot be made"),
        ("fleet robots.yaml -o o --before folder", "--before 'folder': holds no results of 'torchrbd fleet -o'"),
    ],
)
def test_what_is_given_in_the_wrong_place(
    command: str, words: str, results: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(results)
    before = {path: path.read_bytes() for path in results.rglob("*") if path.is_file()}
    capsys.readouterr()
    assert words in refused(capsys, *command.split())
    assert {path: path.read_bytes() for path in results.rglob("*") if path.is_file()} == before


def test_a_mapping_that_is_no_mapping_is_not_told_whole(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = "identify", case / "arm.urdf", case / "day.csv", "-o", case / "o", "--mapping", case / "day.csv"
    told = refused(capsys, *command)
    assert (
        "the file: expected time or joints or topic or episodes or torque_delay or set_point_delay, got 't,q_" in told
    )
    assert len(told) < 400
