"""Input that cannot be right is no diagnosis: the verdict says so, and every file does."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import joint_names, record

import torchrbd
from torchrbd.cli import main
from torchrbd.recordings import Recording

URDF = random_urdf(31, 3, kinds=("revolute",), branching=0.0, massless=0.0)
NAMES = joint_names(URDF)
# What the tests add to torques, and what may be taken for it.
EFFECTS = ["viscous_friction", "coulomb_friction", "asymmetric_coulomb_friction", "joint_spring", "torque_offset"]


@pytest.fixture(scope="module")
def arrays() -> dict[str, np.ndarray]:
    chunk = next(iter(record(URDF, 31, duration_s=20.0).chunks(10**6)))
    return {"t": chunk.t, "q": chunk.q, "tau": chunk.tau}


@pytest.fixture(scope="module")
def flipped(arrays: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with arm.urdf and a recording of it with one torque of the opposite sign."""
    folder = tmp_path_factory.mktemp("flipped")
    (folder / "arm.urdf").write_text(URDF)
    tau = arrays["tau"] * np.array([1.0, 1.0, -1.0])
    header = ",".join(["t", *(f"q_{n}" for n in NAMES), *(f"tau_{n}" for n in NAMES)])
    rows = np.column_stack((arrays["t"], arrays["q"], tau))
    np.savetxt(folder / "day.csv", rows, delimiter=",", header=header, comments="")
    return folder


@pytest.mark.usefixtures("without_simulation", "without_joint_figures")
@pytest.mark.parametrize("command", ["diagnose", "identify"])
def test_every_file_says_that_the_input_is_suspect(
    command: str, flipped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, str(flipped / "arm.urdf"), str(flipped / "day.csv"), "-o", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    says = "times better with the opposite sign"
    assert says in " ".join(told.split())
    assert "--mapping" in told
    assert "WARNING: the recordings are suspect, and these numbers with them: tau_joint3 fits" in (
        (tmp_path / "identified.urdf").read_text()
    )
    torchrbd.RobotModel.from_urdf(tmp_path / "identified.urdf")
    report = (tmp_path / "report.html").read_text()
    assert says in report
    parameters = json.loads((tmp_path / "parameters.json").read_text())
    (one,) = parameters["suspicions"]
    assert (one["kind"], one["joints"]) == ("torque sign", ["joint3"])
    assert one["times"] > 100
    assert parameters["suspicions_tested"]
    assert says in parameters["doubts"][0]
    if command == "identify":
        assert parameters["verdict"] == "suspect"
        return
    assert told.startswith("Suspect input: ")
    assert "Suspect input" in report
    diagnosis = json.loads((tmp_path / "diagnosis.json").read_text())
    assert (diagnosis["verdict"], diagnosis["findings"], diagnosis["unexplained"]) == ("suspect", [], [])
    assert diagnosis["suspicions"] == parameters["suspicions"]
    assert "degrees for radians" in diagnosis["statement"]


def test_nothing_is_searched_for_in_suspect_input(arrays: dict[str, np.ndarray]) -> None:
    began = time.perf_counter()
    degrees = Recording.from_arrays("day", NAMES, **{**arrays, "q": np.rad2deg(arrays["q"])})
    diagnosis = torchrbd.diagnose(URDF, degrees)
    assert time.perf_counter() - began < 20.0
    assert (diagnosis.verdict, diagnosis.ranking, diagnosis.findings) == ("suspect", None, ())
    assert "in degrees" in diagnosis.statement
    assert "suspect" in repr(diagnosis)
    assert "Suspect input" in diagnosis._repr_html_()  # type: ignore[attr-defined]


@pytest.mark.usefixtures("fit_alone")
def test_torques_of_nothing_have_no_findings(arrays: dict[str, np.ndarray]) -> None:
    noise = np.random.default_rng(0).standard_normal(arrays["tau"].shape)
    diagnosis = torchrbd.diagnose(URDF, Recording.from_arrays("day", NAMES, arrays["t"], arrays["q"], noise))
    assert diagnosis.findings == ()
    assert diagnosis.verdict == "suspect"
    assert "better than a constant" in diagnosis.statement


@pytest.mark.usefixtures("fit_alone")
def test_a_spring_that_is_gone_on_another_day_is_named_and_said_to_be_gone_there(arrays: dict[str, np.ndarray]) -> None:
    """What is held out says how much of it is there; what is found is what the fitted day shows."""
    speed = np.gradient(arrays["q"], arrays["t"], axis=0)
    torque = arrays["tau"] + 0.5 * np.tanh(speed / 0.02) + 0.3 * speed
    spring = 3.0 * arrays["q"][:, :1] * (np.arange(3) == 0)
    day, night = (
        Recording.from_arrays(name, NAMES, arrays["t"], arrays["q"], torque + more)
        for name, more in (("day", spring), ("night", 0.0))
    )
    friction = {(effect, (name,)) for effect in ("coulomb_friction", "viscous_friction") for name in NAMES}
    for held_out, gone in (((), False), ([night], True)):
        diagnosis = torchrbd.diagnose(URDF, day, effects=EFFECTS, holdout=held_out)
        assert {(f.effect, f.joints) for f in diagnosis.findings} == {*friction, ("joint_spring", (NAMES[0],))}
        (one,) = (f for f in diagnosis.findings if f.effect == "joint_spring")
        assert one.elpd is not None
        assert one.elpd.log_evidence > 10.0
        assert one.elpd.share > 0.9
        assert one.parameters["stiffness"].value == pytest.approx(3.0, rel=0.1)
        assert one.held_out is not gone
        assert ("Not confirmed on held-out data" in one.statement) is gone
        assert (f"A residual at {NAMES[0]} is unexplained." in diagnosis.statement) is gone
        assert (NAMES[0] in {joint for u in diagnosis.unexplained for joint in u.joints}) is gone


@pytest.mark.slow
def test_the_verdict_of_a_comparison_with_suspect_input(arrays: dict[str, np.ndarray]) -> None:
    good = torchrbd.diagnose(URDF, Recording.from_arrays("day", NAMES, **arrays))
    bad = torchrbd.diagnose(URDF, Recording.from_arrays("night", NAMES, arrays["t"], arrays["q"], -arrays["tau"]))
    with pytest.raises(torchrbd.InputError, match=r"after: its input is suspect, .*opposite sign"):
        torchrbd.compare(good, bad)
