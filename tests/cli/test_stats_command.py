"""The commands for statistics files, in one process and in several that torchrun has started."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from inference.problems import urdf_of
from simulated import joint_names, record

from torchrbd.cli import main
from torchrbd.inference.statistics.files import read_statistics

URDF = urdf_of(2, 2)
# What torchrun runs in place of the command: the second process kills itself when it has written one file.
DIES = """
import os, signal, sys
from torchrbd.inference.statistics import folder
from torchrbd.cli import main
usual = folder.write_file
def write_file(found, path):
    usual(found, path)
    if os.environ["RANK"] == "1":
        os.kill(os.getpid(), signal.SIGKILL)
folder.write_file = write_file
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with arm.urdf and five recordings."""
    folder = tmp_path_factory.mktemp("case")
    (folder / "arm.urdf").write_text(URDF)
    for seed in range(5):
        (chunk,) = record(URDF, seed, duration_s=12.0).chunks(10**6)
        np.savez(folder / f"run{seed}.npz", t=chunk.t, q=chunk.q, tau=chunk.tau, joints=np.array(joint_names(URDF)))
    return folder


def stats(case: Path, folder: Path) -> list[str]:
    """Return the command that makes statistics of all recordings, and their sum beside the folder."""
    files = [str(case / "arm.urdf"), *(str(case / f"run{k}.npz") for k in range(5))]
    return ["stats", *files, "--cutoff", "5", "-o", str(folder), "--merge", f"{folder}.stats"]


def side_by_side(processes: int, program: list[str], command: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a command in several processes."""
    start = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", str(processes), *program]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "default"}
    return subprocess.run([*start, *command], capture_output=True, text=True, env=environment, timeout=300)


def test_stats_and_merge_and_identify(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(stats(case, tmp_path / "made")) == 0
    assert "wrote 5 statistics files" in capsys.readouterr().out
    files = sorted(map(str, (tmp_path / "made").iterdir()))
    assert main(["merge", *files, "-o", str(tmp_path / "all.stats")]) == 0
    assert "5 recordings, 0.0167 hours" in capsys.readouterr().out
    assert (tmp_path / "all.stats").read_bytes() == (tmp_path / "made.stats").read_bytes()
    assert main(["identify", str(case / "arm.urdf"), str(tmp_path / "all.stats"), "-o", str(tmp_path / "out")]) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "parameters.json", "identified.urdf", "model.safetensors", "report.html",
    }  # fmt: skip


def test_bad_names_are_refused(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*stats(case, tmp_path / "made")[:-1], str(tmp_path / "all.bin")]) == 2
    assert "the name of a statistics file ends in .stats" in capsys.readouterr().err
    assert main(["merge", str(tmp_path / "none.stats"), "-o", str(tmp_path / "all.stats")]) == 2
    assert "none.stats: no such file" in capsys.readouterr().err


@pytest.mark.slow
def test_several_processes_are_equal_to_one(case: Path, tmp_path: Path) -> None:
    assert main(stats(case, tmp_path / "one")) == 0
    for processes in (2, 4):
        folder = tmp_path / str(processes)
        done = side_by_side(processes, ["-m", "torchrbd"], stats(case, folder))
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("wrote 5 statistics files") == 1
        assert Path(f"{folder}.stats").read_bytes() == (tmp_path / "one.stats").read_bytes()


@pytest.mark.slow
def test_a_process_that_dies_ends_the_run_and_leaves_whole_files(case: Path, tmp_path: Path) -> None:
    program, folder = tmp_path / "dies.py", tmp_path / "made"
    program.write_text(DIES)
    ended = side_by_side(2, [str(program)], stats(case, folder))
    assert ended.returncode != 0
    assert "SIGKILL" in ended.stderr
    assert not Path(f"{folder}.stats").exists()
    left = sorted(path for path in folder.iterdir() if path.suffix == ".stats")
    assert "run1.npz.stats" in [path.name for path in left]
    assert "run3.npz.stats" not in [path.name for path in left]
    for path in left:
        read_statistics(path)
    assert main(stats(case, folder)) == 0
    assert main(stats(case, tmp_path / "whole")) == 0
    assert Path(f"{folder}.stats").read_bytes() == (tmp_path / "whole.stats").read_bytes()
