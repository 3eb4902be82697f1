"""What SECURITY.md promises: files of others run nothing, open nothing, fetch nothing and fill no memory."""

from __future__ import annotations

import ast
import json
import os
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import pytest
from robot.random_robots import random_urdf
from safetensors.numpy import save_file
from scipy.io import savemat
from simulated import joint_names, record
from watched import read_alone

import torchrbd
from torchrbd import InputError, RecordingError, RobotError, RobotModel
from torchrbd._runtime.outputs import OutputFolder, write_whole
from torchrbd.cli import main
from torchrbd.recordings import open_recording, read_mapping

PACKAGE = Path(torchrbd.__file__).parent
BODY = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
ARM = (
    f'<robot name="{{name}}"><link name="base"/><link name="l">{BODY}{{more}}</link><joint name="j" type="continuous">'
    '<parent link="base"/><child link="l"/><axis xyz="0 1 0"/></joint></robot>'
)


@pytest.mark.parametrize(
    "declared",
    [
        '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>',
        '<!DOCTYPE robot [<!ENTITY secret SYSTEM "file://{file}">]>',
        '<!DOCTYPE robot SYSTEM "http://127.0.0.1:9/robot.dtd">',
    ],
)
def test_document_types_and_entities_are_refused(declared: str, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("hidden")
    text = declared.format(file=tmp_path / "secret") + ARM.format(name="arm", more="")
    with pytest.raises(RobotError, match="declares a document type or entities") as refused:
        RobotModel.from_urdf(text.encode())
    assert "hidden" not in str(refused.value)


def test_large_files_are_refused_before_they_are_read(tmp_path: Path) -> None:
    with (tmp_path / "large.urdf").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(RobotError, match="is 1048576 MB large; expected a URDF, at most 64 MB"):
        RobotModel.from_urdf(tmp_path / "large.urdf")
    (tmp_path / "map.yaml").write_text("# " + "a" * (1 << 20))
    with pytest.raises(RecordingError, match="expected a short file"):
        read_mapping(tmp_path / "map.yaml")
    np.savez_compressed(tmp_path / "bomb.npz", t=np.zeros(3), q=np.zeros((3, 1)), joints=np.zeros(10**7, "U1"))
    with pytest.raises(RecordingError, match="'joints' takes 40000128 bytes"):
        open_recording(tmp_path / "bomb.npz", ["j"])


def test_bags_and_data_sets_open_what_lies_in_their_folder_alone(tmp_path: Path) -> None:
    (tmp_path / "secret.db3").write_text("hidden")
    bag = tmp_path / "bag"
    bag.mkdir()
    told = "{version: 9, storage_identifier: sqlite3, relative_file_paths: [../secret.db3], message_count: 0}"
    (bag / "metadata.yaml").write_text(f"rosbag2_bagfile_information: {told}")
    with pytest.raises(RecordingError, match=r"Some database files are missing: .*bag/secret.db3"):
        open_recording(bag, ["j"])
    (bag / "metadata.yaml").write_text(f"a: !!python/object/apply:os.system ['touch {tmp_path}/ran']")
    with pytest.raises(RecordingError, match="not a readable bag"):
        open_recording(bag, ["j"])
    assert not (tmp_path / "ran").exists()
    with (bag / "metadata.yaml").open("wb") as file:
        file.truncate(1 << 25)
    with pytest.raises(RecordingError, match="it is larger than 16 MB"):
        open_recording(bag, ["j"])
    (tmp_path / "set/meta").mkdir(parents=True)
    number = {"dtype": "float32", "shape": [1]}
    features = {name: number for name in ("timestamp", "episode_index", "q_j", "tau_j")}
    info = tmp_path / "set/meta/info.json"
    info.write_text(json.dumps({"features": features, "data_path": "../secret.db3"}))
    with pytest.raises(RecordingError, match="no files data/chunk-"):
        open_recording(tmp_path / "set", ["j"])
    with info.open("wb") as file:
        file.truncate(1 << 25)
    with pytest.raises(RecordingError, match="is larger than 16 MB"):
        open_recording(tmp_path / "set", ["j"])


def test_large_matlab_arrays_are_refused_before_they_are_read(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"t": np.zeros((1, 3))})
    content = (tmp_path / "a.mat").read_bytes()
    shape = np.array([1, 3], "<i4").tobytes()
    (tmp_path / "a.mat").write_bytes(content.replace(shape, np.array([1 << 15, 1 << 15], "<i4").tobytes()))
    with pytest.raises(RecordingError, match=r"too much to be read at once; save the file with '-v7.3'"):
        open_recording(tmp_path / "a.mat", ["j"])


def test_deep_nesting_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="not well-formed XML"):
        RobotModel.from_urdf(b'<robot name="a">' + b"<a>" * 100_000 + b"</a>" * 100_000 + b"</robot>")
    (tmp_path / "map.yaml").write_text("[" * 100_000)
    with pytest.raises(RecordingError, match="nested too deeply"):
        read_mapping(tmp_path / "map.yaml")
    (tmp_path / "diagnosis.json").write_text("[" * 200_000)
    with pytest.raises(InputError, match="is not JSON"):
        torchrbd.compare(tmp_path, tmp_path)


def test_meshes_are_never_opened_and_nothing_is_fetched(tmp_path: Path) -> None:
    """Python tells of every file and connection that is opened."""
    meshes = (f"file://{tmp_path}/mesh.stl", f"{tmp_path}/mesh.stl", "http://127.0.0.1:9/mesh.stl", "package://a/m.dae")
    tags = "".join(
        f'<{tag}><geometry><mesh filename="{mesh}"/></geometry></{tag}>'
        for mesh in meshes
        for tag in ("visual", "collision")
    )
    (tmp_path / "mesh.stl").write_bytes(b"solid")
    (tmp_path / "arm.urdf").write_text(ARM.format(name="arm", more=tags))
    read_alone(tmp_path / "arm.urdf", "mesh.stl")


def test_reports_escape_every_name_from_a_file(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>\"'>--><img src=x onerror=alert(2)>"
    urdf = random_urdf(21, 2, kinds=("revolute",), branching=0.0, massless=0.0)
    recording = record(urdf, 21, duration_s=15.0)
    names = [f"{evil}{k}" for k in range(2)]
    text = urdf.replace('name="random21"', f'name="{escape(evil, {chr(34): "&quot;"})}"')
    for old, new in zip(joint_names(urdf), names, strict=True):
        text = text.replace(f'"{old}"', f'"{escape(new, {chr(34): "&quot;"})}"')
    chunk = next(iter(recording.chunks(10**6)))
    given = torchrbd.Recording.from_arrays(evil, names, chunk.t, chunk.q, chunk.tau * np.array([1.0, -1.0]))
    found = torchrbd.identify(text.encode(), given)
    assert found.suspicions.found
    torchrbd.write_report(found, tmp_path / "report.html")
    for page in ((tmp_path / "report.html").read_text(), found._repr_html_()):  # type: ignore[attr-defined]
        assert "&lt;script&gt;" in page
        assert "<script" not in page
        assert "<img src=x" not in page
    written = torchrbd.to_urdf(found.model, [f"-----{evil}-----", *(one.words for one in found.suspicions.found)])
    assert RobotModel.from_urdf(written).joint_names == tuple(names)


def test_yaml_makes_nothing_but_data(tmp_path: Path) -> None:
    for text, words in (
        (f"time: !!python/object/apply:os.system ['touch {tmp_path}/ran']", "could not determine a constructor"),
        ("joints: &a [*a]", "repeats another part"),
    ):
        (tmp_path / "map.yaml").write_text(text)
        with pytest.raises(RecordingError, match=words):
            read_mapping(tmp_path / "map.yaml")
    assert not (tmp_path / "ran").exists()


class Armed:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_pickles_are_not_opened(tmp_path: Path) -> None:
    armed = np.array([Armed(tmp_path / "ran")], dtype=object)
    for name, arrays in (
        ("joints", {"joints": armed, "t": np.zeros(3), "q": np.zeros((3, 1))}),
        ("t", {"joints": np.array(["j"]), "t": armed, "q": np.zeros((1, 1))}),
    ):
        np.savez(tmp_path / f"{name}.npz", **arrays)
        with pytest.raises(RecordingError):
            open_recording(tmp_path / f"{name}.npz", ["j"])
    assert not (tmp_path / "ran").exists()


def test_models_that_are_damaged_are_refused(tmp_path: Path) -> None:
    for metadata in (
        {"format": "torchrbd-model-2"},
        {"format": "torchrbd-model-2", "urdf": ARM.format(name="a", more=""), "gravity": "[" * 100_000, "terms": "[]"},
        {"format": "torchrbd-model-2", "urdf": "<robot/>", "gravity": "[0, 0, 0]", "terms": "[]"},
    ):
        save_file({"x": np.zeros(1)}, tmp_path / "model.safetensors", metadata)
        with pytest.raises(InputError):
            torchrbd.load_model(tmp_path / "model.safetensors")


def test_the_package_has_no_door_to_code() -> None:
    """Pickle serves helper processes alone; nothing is evaluated, YAML is loaded strictly, tensors safely."""
    forbidden = {"eval", "exec", "compile", "__import__", "torch.load", "os.system", "yaml.unsafe_load"}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = {alias.name for alias in node.names} | {getattr(node, "module", None)}
                assert not names & {"pickle", "shelve", "marshal", "dill", "joblib"} or path.name == "processes.py"
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert called not in forbidden, f"{path}: {called}"
                assert called != "yaml.load" or path.name == "strict_yaml.py"


def test_results_are_not_written_through_links_of_others(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("kept")
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / ".torchrbd.lock").symlink_to(tmp_path / "precious")
    (folder / f".one.{os.getpid()}.part").symlink_to(tmp_path / "precious")
    with pytest.raises(InputError, match=r"'\.torchrbd\.lock' in it is a link"):
        OutputFolder(folder).__enter__()
    write_whole(folder / "one", b"new")
    assert (tmp_path / "precious").read_text() == "kept"


def test_effects_are_names_and_no_modules(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "arm.urdf").write_text(ARM.format(name="arm", more=""))
    (tmp_path / "c.yaml").write_text("effects: ['os.system']")
    given = tmp_path / "arm.urdf", tmp_path / "no.csv", "-o", tmp_path / "o", "--config", tmp_path / "c.yaml"
    assert main(["diagnose", *map(str, given)]) == 2
    assert "Traceback" not in capsys.readouterr().err
