"""Nothing is written, moved or removed through a link, nor outside the output folder."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from inference.problems import urdf_of
from simulated import joint_names, record

import torchrbd
from torchrbd._runtime.outputs import OutputFolder, check_file, inside, write_whole
from torchrbd.cli import main
from torchrbd.cli.fleet import _identify
from torchrbd.errors import OptionError
from torchrbd.export import to_actuator_net
from torchrbd.inference.robots_file import RobotEntry
from torchrbd.inference.statistics.folder import write_statistics
from torchrbd.learning.checkpoint import write_checkpoint

URDF = urdf_of(2, 2)


@pytest.fixture
def victim(tmp_path: Path) -> Path:
    folder = tmp_path / "victim"
    folder.mkdir()
    for name in ("precious", "report.html", "model.safetensors"):
        (folder / name).write_text("kept")
    return folder


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("case")
    (folder / "arm.urdf").write_text(URDF)
    (chunk,) = record(URDF, 3, duration_s=12.0).chunks(10**6)
    np.savez(folder / "day.npz", t=chunk.t, q=chunk.q, tau=chunk.tau, joints=np.array(joint_names(URDF)))
    return folder


def kept(victim: Path) -> bool:
    return {path.name: path.read_text() for path in victim.iterdir()} == dict.fromkeys(
        ("precious", "report.html", "model.safetensors"), "kept"
    )


@pytest.mark.parametrize("name", [".torchrbd-ready", ".torchrbd-writing", ".torchrbd.lock"])
@pytest.mark.parametrize("to", ["../victim", "../victim/precious", "../nowhere"])
def test_a_planted_link_in_the_output_folder_is_refused(name: str, to: str, tmp_path: Path, victim: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / name).symlink_to(to)
    with pytest.raises(OptionError, match=rf"out.*'{name}' .*remove it"):
        OutputFolder(out).__enter__()
    assert kept(victim)
    assert os.listdir(out) == [name]
    assert sorted(os.listdir(tmp_path)) == ["out", "victim"]


def test_a_link_that_is_planted_while_the_work_is_done_is_not_followed(tmp_path: Path, victim: Path) -> None:
    with OutputFolder(tmp_path / "out") as out:
        (tmp_path / "out" / ".torchrbd-ready").symlink_to(victim)
        with pytest.raises(OptionError, match="remove it"):
            out.fill(lambda into: (into / "report.html").write_text("new"))
    assert kept(victim)
    with OutputFolder(tmp_path / "other") as out:
        (tmp_path / "other" / ".torchrbd-writing" / "room").unlink()
        (tmp_path / "other" / ".torchrbd-writing").rmdir()
        (tmp_path / "other" / ".torchrbd-writing").symlink_to(victim)
        with pytest.raises(OptionError, match="remove it"):
            out.fill(lambda into: (into / "report.html").write_text("new"))
    assert kept(victim)


def test_a_lock_that_is_another_name_of_a_file_is_refused(tmp_path: Path, victim: Path) -> None:
    (tmp_path / "out").mkdir()
    os.link(victim / "precious", tmp_path / "out" / ".torchrbd.lock")
    with pytest.raises(OptionError, match=r"'\.torchrbd\.lock'"):
        OutputFolder(tmp_path / "out").__enter__()
    assert kept(victim)


def test_a_result_replaces_a_link_and_not_what_it_leads_to(tmp_path: Path, victim: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").symlink_to(victim / "report.html")
    with OutputFolder(tmp_path / "out") as out:
        out.fill(lambda into: write_whole(into / "report.html", b"new"))
    assert (tmp_path / "out" / "report.html").read_text() == "new"
    assert kept(victim)


def _statistics(case: Path, file: Path) -> None:
    file.with_name("day.npz.stats").symlink_to(os.readlink(file))
    write_statistics(case / "arm.urdf", case / "day.npz", file.parent, cutoff_hz=5.0)


def _checkpoint(_: Path, file: Path) -> None:
    layer = torch.nn.Linear(1, 1)
    write_checkpoint(file.with_suffix(""), layer, torch.optim.SGD(layer.parameters()), None, {})


def _merged(case: Path, file: Path) -> None:
    write_statistics(case / "arm.urdf", case / "day.npz", file.parent / "all", cutoff_hz=5.0, merged=file)


WRITERS: dict[str, tuple[str, Callable[[Path, Path], object]]] = {
    "one file": ("a.json", lambda _, file: write_whole(file, b"new")),
    "a check before the work": ("a.json", lambda _, file: check_file(file)),
    "stats": ("x.stats", _statistics),
    "their sum": ("x.stats", _merged),
    "a model": ("a.safetensors", lambda _, file: torchrbd.RigidBodyDynamics.from_urdf(URDF.encode()).save(file)),
    "an actuator net": ("a.pt", lambda _, file: to_actuator_net(torch.nn.Linear(6, 1), file, n_history=3)),
}


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("dangling", [False, True])
def test_no_file_is_written_through_a_link(
    writer: str, dangling: bool, case: Path, tmp_path: Path, victim: Path
) -> None:
    name, write = WRITERS[writer]
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(victim / ("new" if dangling else "precious"))
    with pytest.raises(OptionError, match=r"is a link to '.*'; remove it or name another"):
        write(case, tmp_path / "out" / name)
    assert kept(victim)
    assert (tmp_path / "out" / name).is_symlink()


def test_a_part_file_that_is_a_link_is_not_followed(tmp_path: Path, victim: Path) -> None:
    (tmp_path / f".one.{os.getpid()}.part").symlink_to(victim / "precious")
    write_whole(tmp_path / "one", b"new")
    (tmp_path / "training.part").symlink_to(victim / "precious")
    _checkpoint(tmp_path, tmp_path / "training.part")
    assert (tmp_path / "training").is_file()
    assert kept(victim)


@pytest.mark.parametrize("command", ["export", "excite", "inspect", "simulate", "merge"])
def test_commands_say_before_the_work_that_an_output_is_a_link(
    command: str, case: Path, tmp_path: Path, victim: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torchrbd.RigidBodyDynamics.from_urdf(URDF.encode()).save(tmp_path / "model.safetensors")
    output = {"export": "a.urdf", "excite": "a.csv", "inspect": "a.yaml", "simulate": "a.npz", "merge": "a.stats"}
    file, arm, day = tmp_path / output[command], str(case / "arm.urdf"), str(case / "day.npz")
    given = {
        "export": [str(tmp_path / "model.safetensors"), "--to", "urdf"],
        "excite": [arm],
        "inspect": [day],
        "simulate": [arm, day],
        "merge": [str(tmp_path / "all" / "day.npz.stats")],
    }
    write_statistics(case / "arm.urdf", case / "day.npz", tmp_path / "all", cutoff_hz=5.0)
    for target in (victim / "precious", victim / "new"):
        file.unlink(missing_ok=True)
        file.symlink_to(target)
        assert main([command, *given[command], "-o", str(file)]) == 2
        told = capsys.readouterr().err
        assert "Traceback" not in told
        assert str(file) in told
        assert kept(victim)
        assert file.is_symlink()


def test_the_series_of_a_motion_is_not_written_through_a_link(
    case: Path, tmp_path: Path, victim: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.yaml").symlink_to(victim / "precious")
    assert main(["excite", str(case / "arm.urdf"), "-o", str(tmp_path / "a.csv")]) == 2
    assert "a.yaml' is a link" in capsys.readouterr().err
    assert kept(victim)


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "../b", "/b", "a\0b", ".torchrbd-ready", ".torchrbd-writing"])
def test_a_name_that_is_no_folder_inside_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="rename"):
        inside(tmp_path, name)


def test_a_folder_inside_may_be_there_and_may_be_no_link(tmp_path: Path, victim: Path) -> None:
    assert inside(tmp_path, "victim") == victim
    assert inside(tmp_path, "..a") == tmp_path / "..a"
    (tmp_path / "link").symlink_to(victim)
    with pytest.raises(OptionError, match=r"'.*link' is a link to '.*victim'; remove it"):
        inside(tmp_path, "link")


@pytest.mark.parametrize("name", ["...npz", "..npz", ".torchrbd-ready.npz", ".torchrbd-writing.npz"])
def test_identify_each_stays_in_its_folder(
    name: str, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The stem of '...npz' is '..'."""
    recording = tmp_path / "in" / name
    recording.parent.mkdir()
    recording.write_bytes((case / "day.npz").read_bytes())
    out = tmp_path / "deep" / "out"
    out.mkdir(parents=True)
    assert main(["identify", str(case / "arm.urdf"), str(recording), "--each", "-o", str(out), "--cutoff", "5"]) == 2
    told = capsys.readouterr().err
    assert str(recording) in told
    assert "rename" in told
    assert os.listdir(tmp_path / "deep") == ["out"]
    assert os.listdir(out) == []


def test_identify_each_writes_through_no_link(
    case: Path, tmp_path: Path, victim: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "day").symlink_to(victim)
    given = [str(case / "arm.urdf"), str(case / "day.npz"), "--each", "-o", str(tmp_path / "out"), "--cutoff", "5"]
    assert main(["identify", *given]) == 2
    assert "is a link to" in capsys.readouterr().err
    assert kept(victim)


def test_a_fleet_writes_through_no_link(case: Path, tmp_path: Path, victim: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "cell").symlink_to(victim)
    entry = RobotEntry("cell", case / "arm.urdf", (case / "day.npz",), {"estimator": "moments", "cutoff_hz": 5.0})
    with pytest.raises(OptionError, match="is a link to"):
        _identify(tmp_path / "out", (entry, "{}"))
    assert kept(victim)


def test_what_the_user_names_may_be_a_link_to_a_folder(tmp_path: Path) -> None:
    """Results on another disk: the folder of -o is the user's own word, what lies inside it is not."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to("disk")
    with OutputFolder(tmp_path / "out") as out:
        out.fill(lambda into: write_whole(into / "a", b"new"))
    assert (tmp_path / "disk" / "a").read_text() == "new"
