"""The command line as a user meets it: files in, files out, clear words, exit codes."""

import contextlib
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import joint_names, record

import torchrbd
from torchrbd.cli import main
from torchrbd.estimators import COMPARABLE, ESTIMATORS


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with arm.urdf, and day.csv and night.csv of it with friction at joint2 that the URDF leaves out."""
    folder = tmp_path_factory.mktemp("case")
    urdf = random_urdf(21, 3, kinds=("revolute",), branching=0.0, massless=0.0)
    (folder / "arm.urdf").write_text(urdf)
    names = joint_names(urdf)

    def friction(motion):
        tau = np.zeros_like(motion.q)
        tau[:, names.index("joint2")] = 0.7 * np.sign(motion.qd[:, names.index("joint2")])
        return tau

    for seed, name in enumerate(("day", "night")):
        write(folder / f"{name}.csv", names, record(urdf, seed, extra=friction, duration_s=20.0))
    return folder


def write(path: Path, names: list[str], recording: torchrbd.Recording) -> None:
    chunk = next(iter(recording.chunks(10**6)))
    header = ",".join(["t", *(f"q_{n}" for n in names), *(f"tau_{n}" for n in names)])
    np.savetxt(path, np.column_stack((chunk.t, chunk.q, chunk.tau)), delimiter=",", header=header, comments="")


def run(case: Path, *arguments: str) -> int:
    files = [
        str(case / a) if a.endswith((".urdf", ".csv", ".yaml", ".parquet")) and "=" not in a else a for a in arguments
    ]
    return main(files)


@pytest.fixture(scope="module")
def diagnosed(case: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder that diagnose wrote, and what it printed."""
    folder, printed = tmp_path_factory.mktemp("diagnosed"), io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert run(case, "diagnose", "arm.urdf", "day.csv", "--holdout", "night.csv", "-o", str(folder)) == 0
    return folder, printed.getvalue()


def test_diagnose_writes_everything(diagnosed: tuple[Path, str]) -> None:
    folder, told = diagnosed
    assert told.startswith("Missing physics: ")
    assert "Coulomb friction" in told
    assert str(folder / "report.html") in told.replace("\n", "")
    diagnosis = json.loads((folder / "diagnosis.json").read_text())
    assert diagnosis["schema"] == 1
    assert diagnosis["verdict"] == "missing_physics"
    assert diagnosis["joints"] == ["joint1", "joint2", "joint3"]
    (finding,) = diagnosis["findings"]
    assert (finding["effect"], finding["joints"]) == ("coulomb_friction", ["joint2"])
    assert finding["parameters"]["coulomb"]["value"] == pytest.approx(0.7, rel=0.1)
    assert finding["parameters"]["coulomb"]["unit"] == "N m"
    wanted = {"effect", "joints", "links", "probability", "log_evidence_gain", "parameters", "where", "statement"}
    assert finding.keys() >= wanted | {"indistinguishable_from", "nmse_before", "nmse_after"}
    assert finding["where"] == {"recordings": None, "time_s": None, "region": None}
    assert diagnosis["fit"].keys() == {"urdf", "baseline", "rigid_body", "extended"}
    assert diagnosis["fit"]["extended"]["nmse"].keys() == set(diagnosis["joints"])
    assert (folder / "report.html").read_text().startswith("<!")


def test_written_urdf_and_model_are_the_fitted_robot(diagnosed: tuple[Path, str]) -> None:
    folder, _ = diagnosed
    model = torchrbd.load_model(folder / "model.safetensors")
    from_urdf = torchrbd.RigidBodyDynamics.from_urdf(str(folder / "identified.urdf"))
    assert from_urdf.pi.detach().numpy() == pytest.approx(model.pi.detach().numpy(), rel=1e-9, abs=1e-12)
    assert from_urdf.robot.friction[1] == pytest.approx(0.7, rel=0.1)


@pytest.mark.slow
def test_second_opinion_on_the_identified_urdf(case: Path, tmp_path: Path) -> None:
    """The robot that was written explains the recordings it came from."""
    assert run(case, "diagnose", "arm.urdf", "day.csv", "night.csv", "-o", str(tmp_path / "first")) == 0
    again = torchrbd.diagnose(tmp_path / "first" / "identified.urdf", [case / "day.csv", case / "night.csv"])
    assert again.findings == ()
    assert again.verdict == "consistent"


@pytest.mark.usefixtures("fit_alone", "without_joint_figures")
def test_identify_writes_parameters(case: Path, tmp_path: Path) -> None:
    arguments = (
        "identify",
        "arm.urdf",
        "day.csv",
        "-o",
        str(tmp_path),
        "--effects",
        "coulomb_friction",
        "--cutoff",
        "6",
    )
    assert run(case, *arguments) == 0
    content = json.loads((tmp_path / "parameters.json").read_text())
    assert content["cutoff_hz"] == 6.0
    assert len([p for p in content["parameters"] if p["status"] == "term"]) == 3
    assert len([p for p in content["parameters"] if p["owner"] == "link1"]) == 10
    assert any(sentence.startswith("only ") for sentence in content["combinations"])
    assert not (tmp_path / "diagnosis.json").exists()


@pytest.mark.usefixtures("fit_alone", "without_joint_figures")
@pytest.mark.parametrize(("estimator", "sure"), [("wls", False), ("physical", True)])
def test_identify_says_the_same_on_the_screen_in_the_report_and_in_the_file(
    estimator: str, sure: bool, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(case, "identify", "arm.urdf", "day.csv", "-o", str(tmp_path), "--estimator", estimator) == 0
    told = re.sub(r"\s+", " ", capsys.readouterr().out)
    page = (tmp_path / "report.html").read_text()
    content = json.loads((tmp_path / "parameters.json").read_text())
    names = {"identified": "Identified", "doubtful": "Identified, with doubts", "worse": "Worse than the URDF"} | {
        "suspect": "Suspect input"
    }
    assert told.startswith(f"{names[content['verdict']]}: ")
    assert f"{names[content['verdict']]}</span>" in page
    for doubt in content["doubts"]:
        assert f"warning: {doubt}" in told
    assert set(content["doubts"]) <= set(content["notes"])
    for title in ("position noise", "residual torque", "standard deviation"):
        assert title in told
    assert ("without intervals, which come with auto, physical, smoother" in told) != sure
    fitted = [p for p in content["parameters"] if p["status"] != "held"]
    assert all((p["std"] is not None) == (p["prior_share"] is not None) == sure for p in fitted)
    assert (content["base_covariance"] is not None) == sure
    assert ("± –" in page) != sure


@pytest.mark.usefixtures("fit_alone", "without_joint_figures")
def test_names_in_brackets_are_no_markup(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("arm.urdf", "day.csv"):
        (tmp_path / name).write_text((case / name).read_text().replace("joint2", "j[/b]"))
    files = str(tmp_path / "arm.urdf"), str(tmp_path / "day.csv")
    assert main(["identify", *files, "-o", str(tmp_path / "o")]) == 0
    assert main(["compare-estimators", *files, "--estimators", "wls"]) == 0
    told = capsys.readouterr().out
    assert told.count("│ j[/b] ") == 2
    assert re.search(r"┃ +j\[/b\] ┃", told)


def test_options_before_the_files_are_answered_with_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare-estimators", "--estimators", "wls", "ols", "arm.urdf", "day.csv"]) == 2
    told = re.sub(r"\s+", " ", capsys.readouterr().err)
    assert "give the files first" in told


def test_help_explains_every_estimator(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("identify", "compare-estimators"):
        assert main([command, "--help"]) == 0
        told = re.sub(r"[\s│]+", " ", capsys.readouterr().out)
        for name, meaning in ESTIMATORS.items():
            assert meaning in told or (name not in COMPARABLE and command == "compare-estimators")
    assert "auto, the default of identify, is smoother where" in told


def test_effects_are_listed_with_their_torque(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    assert main(["effects"]) == 0
    told = capsys.readouterr().out
    for name, effect in torchrbd.known_effects().items():
        assert f"│ {name} " in told
        assert effect.words in told
    assert "c sign(qd)" in told


def test_compare_estimators_prints_and_writes_a_table(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = "compare-estimators", "arm.urdf", "day.csv", "--effects", "coulomb_friction"
    arguments = (*arguments, "--estimators", "wls", "iv")
    assert run(case, *arguments) == 0
    told = capsys.readouterr().out
    rows = re.findall(r"│ (\w+) +│ +(\S+) │ (\w*) +│ +(\S+)( \*)? +│ +(\d+\.\d\d s)? │", told)
    assert [row[0] for row in rows] == ["urdf", "wls"]
    assert [bool(row[4]) for row in rows] == [False, True]
    told = re.sub(r"\s+", " ", told)
    assert "iv is left out: estimator 'iv' needs the set-points" in told
    assert "physical? says whether every link" in told
    assert "Position noise" in told
    assert list(tmp_path.iterdir()) == []
    assert run(case, *arguments, "--holdout", "night.csv", "-o", str(tmp_path / "new")) == 0
    content = json.loads((tmp_path / "new" / "estimators.json").read_text())
    assert content["schema"] == 1
    assert content["held_out"] == "night.csv"
    urdf, wls, iv = content["rows"]
    assert [row["name"] for row in (urdf, wls, iv)] == ["urdf", "wls", "iv"]
    assert wls["raw"]["nmse"]["joint2"] < 0.1 * urdf["raw"]["nmse"]["joint2"]
    assert isinstance(wls["was_physical"], bool)
    assert iv["raw"] is None


@pytest.mark.usefixtures("fit_alone", "without_joint_figures")
def test_configuration_file_gives_options_and_the_command_line_wins(case: Path, tmp_path: Path) -> None:
    (case / "run.yaml").write_text(f"cutoff: 6\nholdout: [{case / 'night.csv'}]\nexclude: joint_spring\n")
    assert (
        run(case, "identify", "arm.urdf", "day.csv", "-o", str(tmp_path), "--config", "run.yaml", "--cutoff", "5") == 0
    )
    content = json.loads((tmp_path / "parameters.json").read_text())
    assert content["cutoff_hz"] == 5.0
    assert content["recordings"] == ["day.csv"]
    assert content["held_out"] == "night.csv"


@pytest.mark.usefixtures("fit_alone", "without_joint_figures")
def test_files_in_a_configuration_are_sought_from_its_folder(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "runs"
    folder.mkdir()
    (folder / "evening.csv").write_bytes((case / "night.csv").read_bytes())
    (folder / "names.yaml").write_text("time: {column: t, unit: s}\n")
    (folder / "run.yaml").write_text("holdout: evening.csv\nmapping: names.yaml\n")
    monkeypatch.chdir(case)
    command = ["identify", "arm.urdf", "day.csv", "-o", str(tmp_path / "o"), "--config", str(folder / "run.yaml")]
    assert main(command) == 0
    assert json.loads((tmp_path / "o" / "parameters.json").read_text())["held_out"] == "evening.csv"
    (folder / "evening.csv").unlink()
    assert main(command) == 2
    assert str(folder / "evening.csv") in capsys.readouterr().err


BAD = {
    "no file": (("identify", "arm.urdf", "dawn.csv"), "dawn.csv"),
    "no robot": (("identify", "leg.urdf", "day.csv"), "leg.urdf"),
    "holdout twice": (("identify", "arm.urdf", "day.csv", "--holdout", "day.csv"), "both fitted and held out"),
    "unknown joint": (("identify", "arm.urdf", "day.csv", "--joints", "jointX"), "no moving joint 'jointX'"),
    "unknown link": (("identify", "arm.urdf", "day.csv", "--trust", "linkX"), "no moving link 'linkX'"),
    "unknown effect": (("diagnose", "arm.urdf", "day.csv", "--effects", "friction"), "unknown effect 'friction'"),
    "bad time": (("identify", "arm.urdf", "day.csv", "--time", "5"), "expected FROM:TO"),
    "empty time": (("identify", "arm.urdf", "day.csv", "--time", "9:3"), "end must come after"),
    "bad payload": (("identify", "arm.urdf", "day.csv", "--payload", "day.csv=heavy"), "expected FILE=kg,x,y,z"),
    "payload of another file": (("identify", "arm.urdf", "day.csv", "--payload", "dawn.csv=1,0,0,0"), "dawn.csv"),
    "payload on nothing": (("identify", "arm.urdf", "day.csv", "--payload", "day.csv=1,0,0,0@linkX"), "linkX"),
    "bad fraction": (("identify", "arm.urdf", "day.csv", "--holdout-fraction", "0.9"), "holdout_fraction is 0.9"),
    "too short": (("identify", "arm.urdf", "day.csv", "--time", "0:3"), "give more recordings"),
    "cut-off too high": (("identify", "arm.urdf", "day.csv", "--cutoff", "90"), "too high"),
    "unknown estimator": (("identify", "arm.urdf", "day.csv", "--estimator", "smother"), 'Did you mean "smoother"?'),
    "estimator to compare": (("compare-estimators", "arm.urdf", "day.csv", "--estimators", "wsl"), "mean 'wls'?"),
    "auto to compare": (("compare-estimators", "arm.urdf", "day.csv", "--estimators", "auto"), "compare these two"),
    "bad gravity": (("identify", "arm.urdf", "day.csv", "--gravity", "0", "inf", "0"), "three finite numbers"),
    "bad encoder noise": (("identify", "arm.urdf", "day.csv", "--encoder-noise", "fine"), "expected a number"),
    "no encoder noise": (("diagnose", "arm.urdf", "day.csv", "--encoder-noise", "0"), "standard deviation above 0"),
    "no mapping": (("identify", "arm.urdf", "day.csv", "--mapping", "map.yaml"), "map.yaml"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_told_without_a_traceback(
    name: str, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, words = BAD[name]
    assert run(case, *arguments, "-o", str(tmp_path / "out")) == 2
    told = re.sub(r"\s+", " ", capsys.readouterr().err)
    assert told.startswith("torchrbd: error: ")
    assert words in told
    assert "Traceback" not in told
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("content", ["cutof: 6", "- 6", "cutoff: [", "cutoff: fast"])
def test_bad_configuration_is_told(
    content: str, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.yaml").write_text(content)
    assert (
        main(
            [
                "identify",
                str(case / "arm.urdf"),
                str(case / "day.csv"),
                "-o",
                str(tmp_path / "o"),
                "--config",
                str(tmp_path / "bad.yaml"),
            ]
        )
        == 2
    )
    told = capsys.readouterr().err
    assert "bad.yaml" in told
    assert "Traceback" not in told


def test_configuration_in_another_encoding_is_told(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (case / "latin.yaml").write_bytes("cutoff: 5 # Größe\n".encode("latin-1"))
    assert run(case, "identify", "arm.urdf", "day.csv", "-o", str(tmp_path / "o"), "--config", "latin.yaml") == 2
    assert "not YAML in UTF-8" in capsys.readouterr().err


def test_diagnose_needs_an_estimator_with_intervals(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (case / "plain.yaml").write_text("estimator: wls\n")
    assert run(case, "diagnose", "arm.urdf", "day.csv", "-o", str(tmp_path / "o"), "--config", "plain.yaml") == 2
    told = re.sub(r"\s+", " ", capsys.readouterr().err)
    assert "diagnose: estimator 'wls' has no intervals" in told
    assert "use auto, physical, smoother, or identify" in told


def test_output_that_cannot_be_written_is_told_first(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").write_text("")
    assert run(case, "identify", "arm.urdf", "no.csv", "-o", str(tmp_path / "taken" / "sub")) == 2
    assert "not a folder that can be written" in capsys.readouterr().err


def test_help_keeps_units(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diagnose", "--help"]) == 0
    assert "[N m, N]" in re.sub(r"[\s│]+", " ", capsys.readouterr().out)


@pytest.mark.usefixtures("fit_alone", "without_joint_figures")
@pytest.mark.parametrize(
    "path", sorted((Path(__file__).parent.parent / "configs").glob("run_*.yaml")), ids=lambda p: p.name
)
def test_bundled_run_settings_are_read(
    path: Path, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = str(case / "arm.urdf"), str(case / "day.csv")
    code = main(["identify", *files, "-q", "-o", str(tmp_path / "o"), "--config", str(path)])
    assert (code, capsys.readouterr().err) == (0, "")


def test_demo_names_the_concealed_friction(tmp_path: Path) -> None:
    assert main(["demo", "-o", str(tmp_path)]) == 0
    truth = json.loads((Path(torchrbd.__file__).parent / "demo" / "truth.json").read_text())
    (finding,) = json.loads((tmp_path / "diagnosis.json").read_text())["findings"]
    assert (finding["effect"], finding["joints"]) == (truth["effect"], [truth["joint"]])
    (quantity,) = finding["parameters"].values()
    assert quantity["value"] == pytest.approx(truth["value"], rel=0.1)
    assert (tmp_path / "report.html").exists()
