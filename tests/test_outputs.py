"""Nothing is lost: results are written whole, as a set, by one process at a time, and what stops that is told first."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from torchrbd._runtime.outputs import OutputFolder, write_whole
from torchrbd.cli import main
from torchrbd.errors import OptionError

NAMES = ("a.json", "b.urdf", "c.safetensors", "d.html")
SIZE = 200_000


def write_set(folder: Path, letter: str) -> None:
    for name in NAMES:
        (folder / name).write_text(letter * SIZE)


def letters(folder: Path) -> set[str]:
    """The letters of which the set in a folder is made; one, unless it is a mixture."""
    texts = [(folder / name).read_text() for name in NAMES]
    assert {len(text) for text in texts} == {SIZE}
    return {letter for text in texts for letter in set(text)}


def fill(folder: Path, letter: str) -> None:
    with OutputFolder(folder) as out:
        out.fill(lambda into: write_set(into, letter))


def python(code: str, *arguments: str | Path, **more) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=Path(__file__).parent, **more,
    )  # fmt: skip


def test_a_set_is_written_and_nothing_else_is_left(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    for letter in "ox":
        fill(tmp_path, letter)
        assert letters(tmp_path) == {letter}
    assert sorted(os.listdir(tmp_path)) == sorted((*NAMES, "notes.txt"))


def test_a_failed_run_leaves_what_was_there(tmp_path: Path) -> None:
    fill(tmp_path / "out", "o")

    def fail(into: Path) -> None:
        (into / NAMES[0]).write_text("x")
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"), OutputFolder(tmp_path / "out") as out:
        out.fill(fail)
    assert letters(tmp_path / "out") == {"o"}
    assert sorted(os.listdir(tmp_path / "out")) == sorted(NAMES)


def test_a_folder_that_was_made_for_nothing_is_removed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no"), OutputFolder(tmp_path / "new" / "deep"):
        raise ValueError("no")
    assert os.listdir(tmp_path) == []


# A process that is killed right before one of its changes to files, at each of them in turn.
KILLED = """
    import json, os, signal, sys
    from itertools import count
    from pathlib import Path
    from test_outputs import fill, letters
    from torchrbd._runtime import outputs

    outputs._ROOM = 1 << 20
    folder, changes = Path(sys.argv[1]), ("open", "os.mkdir", "os.remove", "os.rename", "os.rmdir")

    def killed_before(change):
        left = change

        def kill(event, _):
            nonlocal left
            if event in changes and (left := left - 1) == 0:
                os.kill(os.getpid(), signal.SIGKILL)

        if (child := os.fork()) == 0:
            sys.addaudithook(kill)
            fill(folder, "x")
            os._exit(0)
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL

    found = []
    for change in count(1):
        fill(folder, "o")
        if not killed_before(change):
            break
        mixed = sorted(letters(folder))
        if (folder / ".torchrbd-ready").exists():
            with outputs.OutputFolder(folder):
                pass
        found.append((mixed, sorted(letters(folder))))
    print(json.dumps(found))
"""


def test_killed_before_any_change_a_set_is_whole(tmp_path: Path) -> None:
    """What a kill has left is, once the next run has looked, one set or the other."""
    told, errors = python(KILLED, tmp_path).communicate()
    assert not errors
    mixed, found = zip(*json.loads(told), strict=True)
    # Once it is ready, and only then, the new set replaces the old one.
    first = found.index(["x"])
    assert list(found) == [["o"]] * first + [["x"]] * (len(found) - first)
    # Each of the files is written, and moved.
    assert first > len(NAMES)
    assert mixed.count(["o", "x"]) == len(NAMES) - 1
    assert letters(tmp_path) == {"x"}
    assert sorted(os.listdir(tmp_path)) == sorted(NAMES)


def test_what_was_ready_is_moved_by_the_next_run(tmp_path: Path) -> None:
    """Killed between two of the moves: the set is a mixture until then."""
    fill(tmp_path, "o")
    (tmp_path / ".torchrbd-ready").mkdir()
    write_set(tmp_path / ".torchrbd-ready", "x")
    (tmp_path / ".torchrbd-ready" / NAMES[0]).rename(tmp_path / NAMES[0])
    assert letters(tmp_path) == {"o", "x"}
    with OutputFolder(tmp_path):
        assert letters(tmp_path) == {"x"}


def test_two_runs_into_one_folder_are_refused(tmp_path: Path) -> None:
    with OutputFolder(tmp_path) as first:
        with pytest.raises(OptionError, match=rf"another torchrbd \(process {os.getpid()}\) is writing into it; wait"):
            OutputFolder(tmp_path).__enter__()
        first.fill(lambda into: write_set(into, "o"))
    with OutputFolder(tmp_path):
        pass


def run_into(folder: Path, work: Callable[[], None], write: Callable[[Path], None]) -> None:
    with OutputFolder(folder) as out:
        work()
        out.fill(write)


def removed_words(folder: Path) -> str:
    return rf"output '{folder}': another process has removed it.* nothing was written; .*run it again"


@pytest.mark.parametrize("when", ["before", "while"])
def test_a_folder_that_is_removed_meanwhile_is_told_with_what_to_do(when: str, tmp_path: Path) -> None:
    folder = tmp_path / "out"

    def write(into: Path) -> None:
        if when == "while":
            shutil.rmtree(folder)
        write_set(into, "x")

    with pytest.raises(OptionError, match=removed_words(folder)):
        run_into(folder, lambda: shutil.rmtree(folder) if when == "before" else None, write)
    assert os.listdir(tmp_path) == []


def test_a_folder_that_another_run_has_made_anew_is_left_to_it(tmp_path: Path) -> None:
    """The first run would write into the second's folder, and remove what it is writing."""
    folder = tmp_path / "out"
    second = OutputFolder(folder)

    def make_anew() -> None:
        shutil.rmtree(folder)
        second.__enter__()

    with pytest.raises(OptionError, match=removed_words(folder)):
        run_into(folder, make_anew, lambda into: write_set(into, "x"))
    second.fill(lambda into: write_set(into, "o"))
    second.__exit__(None, None, None)
    assert letters(folder) == {"o"}
    assert sorted(os.listdir(folder)) == sorted(NAMES)


def test_a_run_whose_folder_is_removed_ends_with_two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def removes(*_: object) -> None:
        shutil.rmtree(tmp_path / "out")

    monkeypatch.setattr("torchrbd.cli.running.compare", removes)
    assert main(["compare", "before", "after", "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert re.search(removed_words(tmp_path / "out"), told)
    assert "Errno" not in told


def test_files_that_others_write_into_a_removed_folder_are_told_likewise(tmp_path: Path) -> None:
    folder = tmp_path / "out"

    def write_own() -> None:
        shutil.rmtree(folder)
        write_whole(folder / "one", b"")

    with pytest.raises(OptionError, match=removed_words(folder)):
        run_into(folder, write_own, lambda into: write_set(into, "x"))


def test_a_file_that_is_missing_elsewhere_is_told_as_it_is(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no\.urdf"), OutputFolder(tmp_path / "out"):
        (tmp_path / "no.urdf").read_text()


def test_the_lock_of_a_dead_process_is_none(tmp_path: Path) -> None:
    holder = python(
        """
        import sys, time
        from pathlib import Path
        from torchrbd._runtime.outputs import OutputFolder
        with OutputFolder(Path(sys.argv[1])):
            print("held", flush=True)
            time.sleep(60)
        """,
        tmp_path,
    )
    assert holder.stdout is not None
    holder.stdout.readline()
    with pytest.raises(OptionError, match=f"process {holder.pid}"):
        OutputFolder(tmp_path).__enter__()
    holder.kill()
    holder.communicate()
    fill(tmp_path, "x")
    assert letters(tmp_path) == {"x"}


def test_a_disk_without_room_is_told_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A process that may not write large files stands for a full disk."""
    fill(tmp_path, "o")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, limits[1]))
    try:
        assert main(["identify", "no.urdf", "no.csv", "-o", str(tmp_path)]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    told = capsys.readouterr().err
    assert "cannot be written (File too large); make room or name another" in told
    assert "no.urdf" not in told
    assert letters(tmp_path) == {"o"}
    assert sorted(os.listdir(tmp_path)) == sorted(NAMES)


def test_an_output_that_is_no_folder_is_told_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").write_text("")
    for place in (tmp_path / "taken", tmp_path / "taken" / "deep", Path("/proc/torchrbd")):
        assert main(["compare", "no", "no", "-o", str(place)]) == 2
        told = capsys.readouterr().err
        assert "name another" in told
        assert "no:" not in told


def test_a_single_file_is_whole_or_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_whole(tmp_path / "one", b"old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr(os, "replace", full)
        with pytest.raises(OSError, match="No space"):
            write_whole(tmp_path / "one", b"new")
    assert (tmp_path / "one").read_bytes() == b"old"
    write_whole(tmp_path / "one", b"new")
    assert (tmp_path / "one").read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["one"]
    write_whole("/dev/null", b"anything")
