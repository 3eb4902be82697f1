"""Input that cannot be right is no diagnosis: the verdict says so, and every file does."""

import json
import time
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from robot.random_robots import random_urdf
from shortened import slow_but
from simulated import joint_names, record

import torchrbd
from torchrbd.cli import main
from torchrbd.diagnosis.results import Ratio
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
@pytest.mark.parametrize("worse_than", slow_but(("the plain model",), ("a constant", "the plain model")))
def test_what_held_out_recordings_contradict_is_not_named(
    arrays: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch, worse_than: str
) -> None:
    """The plain model predicts them, what was found does not; of what is left a function of one signal is told."""
    diagnose, told = import_module("torchrbd.diagnosis.diagnose"), iter((worse_than == "a constant", False))
    monkeypatch.setattr(diagnose, "tells_nothing", lambda *_: next(told))
    monkeypatch.setattr(diagnose, "is_refuted", lambda *_: True)
    # The offset of the plain model takes a part of it.
    spring = 4.0 * arrays["q"][:, :1] * (np.arange(3) == 0)
    recording = Recording.from_arrays("day", NAMES, arrays["t"], arrays["q"], arrays["tau"] + spring)
    diagnosis = torchrbd.diagnose(URDF, recording, effects=EFFECTS)
    assert (diagnosis.verdict, diagnosis.findings) == ("unexplained", ())
    (one,) = diagnosis.unexplained
    assert one.joints == (NAMES[0],)
    if worse_than == "a constant":
        assert "Held-out data does not confirm it." in one.statement
        assert one.share > 0.9
    else:
        assert one.depends_on == (f"q_{NAMES[0]}",)
        assert one.share > 0.9
    assert "do not improve the prediction of held-out data" in diagnosis.statement
    assert [f.effect for f in diagnosis.not_confirmed] == ["joint_spring"]


LESS, PERHAPS_ALL = Ratio(0.4, 0.2, 0.7), Ratio(0.4, -0.2, 1.1)


@pytest.mark.parametrize(
    ("there", "found", "is_refuted"),
    [
        (LESS, [0.1, 0.4, 0.1, 0.4, 0.3], True),
        (LESS, [0.1, 0.1, 0.1, 0.4, 0.2], False),
        (PERHAPS_ALL, [0.1, 0.4, 0.1, 0.4, 0.3], False),
        (None, [0.1, 0.4, 0.1, 0.4, 0.3], False),
        (PERHAPS_ALL, [0.3, 0.4, 0.3, 0.4, 0.3], True),
        (None, [0.201, 0.202, 0.201, 0.202, 0.201], False),
    ],
    ids=["less and worse", "less but better", "worse by chance", "too little of it", "worse for certain", "by nothing"],
)
def test_held_out_time_refutes_what_it_has_less_of_or_is_certain_to_be_worse_with(
    monkeypatch: pytest.MonkeyPatch, there: Ratio | None, found: list[float], is_refuted: bool
) -> None:
    """The plain model leaves 0.2 in each of five blocks."""
    refuting = import_module("torchrbd.diagnosis.refuting")
    monkeypatch.setattr(refuting, "nmse_of_blocks", lambda _, x: torch.tensor(x))
    model, asked = SimpleNamespace(x=found), SimpleNamespace(judging=None)
    asked.columns, asked.fit = SimpleNamespace(urdf_friction=()), lambda _: SimpleNamespace(x=[0.2] * 5)
    assert refuting.refuted(SimpleNamespace(judging=None), model, asked, there) is is_refuted


@pytest.mark.usefixtures("fit_alone")
def test_friction_is_told_where_held_out_time_refutes_all_else(
    arrays: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(import_module("torchrbd.diagnosis.diagnose"), "is_refuted", lambda *_: True)
    friction = 0.5 * np.tanh(np.gradient(arrays["q"], arrays["t"], axis=0) / 0.02)
    spring = 3.0 * arrays["q"][:, :1] * (np.arange(3) == 0)
    recording = Recording.from_arrays("day", NAMES, arrays["t"], arrays["q"], arrays["tau"] + friction + spring)
    diagnosis = torchrbd.diagnose(URDF, recording, effects=EFFECTS)
    assert {f.effect for f in diagnosis.findings} <= {"coulomb_friction", "asymmetric_coulomb_friction"}
    assert {f.joints[0] for f in diagnosis.findings} >= set(NAMES[1:])
    assert "joint_spring" in {f.effect for f in diagnosis.not_confirmed}
    assert "do not improve the prediction of held-out data" in diagnosis.statement


@pytest.mark.usefixtures("fit_alone")
def test_a_spring_that_is_gone_on_another_day_is_not_named_but_friction_is(arrays: dict[str, np.ndarray]) -> None:
    """A joint that has ordinary friction may have something unexplained, too."""
    speed = np.gradient(arrays["q"], arrays["t"], axis=0)
    torque = arrays["tau"] + 0.5 * np.tanh(speed / 0.02) + 0.3 * speed
    spring = 3.0 * arrays["q"][:, :1] * (np.arange(3) == 0)
    day, night = (
        Recording.from_arrays(name, NAMES, arrays["t"], arrays["q"], torque + more)
        for name, more in (("day", spring), ("night", 0.0))
    )
    friction = {(effect, (name,)) for effect in ("coulomb_friction", "viscous_friction") for name in NAMES}
    alone = torchrbd.diagnose(URDF, day, effects=EFFECTS)
    assert {(f.effect, f.joints) for f in alone.findings} == {*friction, ("joint_spring", (NAMES[0],))}
    diagnosis = torchrbd.diagnose(URDF, [day], holdout=[night], effects=EFFECTS)
    told = {(f.effect, f.joints) for f in diagnosis.findings}
    # What the spring did to the joint's torque is noise now.
    assert {one for one in friction if one[1] != (NAMES[0],)} <= told <= friction
    for one in diagnosis.findings:
        (value,) = one.parameters.values()
        true = 0.5 if one.effect == "coulomb_friction" else 0.3
        assert abs(value.value - true) < max(3.0 * value.std, 0.1 * true) or one.joints == (NAMES[0],)
    assert ("joint_spring", (NAMES[0],)) in {(f.effect, f.joints) for f in diagnosis.not_confirmed}
    assert NAMES[0] in {joint for u in diagnosis.unexplained for joint in u.joints}
    assert all(u.depends_on == () for u in diagnosis.unexplained)


@pytest.mark.slow
def test_the_verdict_of_a_comparison_with_suspect_input(arrays: dict[str, np.ndarray]) -> None:
    good = torchrbd.diagnose(URDF, Recording.from_arrays("day", NAMES, **arrays))
    bad = torchrbd.diagnose(URDF, Recording.from_arrays("night", NAMES, arrays["t"], arrays["q"], -arrays["tau"]))
    with pytest.raises(torchrbd.InputError, match=r"after: its input is suspect, .*opposite sign"):
        torchrbd.compare(good, bad)
