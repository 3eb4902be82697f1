"""The list of a fleet's robots is read strictly."""

from __future__ import annotations

from pathlib import Path

import pytest

from torchrbd import OptionError
from torchrbd.inference.robots_file import read_robots

ROBOT = "{name: a, urdf: arm.urdf, recordings: a.csv}"


def written(folder: Path, text: str) -> Path:
    path = folder / "robots.yaml"
    path.write_text(text)
    return path


def test_files_are_sought_from_the_folder_and_options_are_shared(tmp_path: Path) -> None:
    text = """
options: {cutoff: 5, kappa: 2}
robots:
  - {name: cell-1, urdf: arm.urdf, recordings: [a.csv, b.csv]}
  - {name: cell 2, urdf: other/arm.urdf, recordings: c.csv, mapping: m.yaml, options: {cutoff: 8, holdout-fraction: .3}}
"""
    one, other = read_robots(written(tmp_path, text))
    assert (one.name, one.urdf, one.recordings) == (
        "cell-1",
        tmp_path / "arm.urdf",
        (tmp_path / "a.csv", tmp_path / "b.csv"),
    )
    assert one.options == {"cutoff_hz": 5, "kappa": 2}
    assert other.urdf == tmp_path / "other" / "arm.urdf"
    assert other.options == {"cutoff_hz": 8, "kappa": 2, "holdout_fraction": 0.3, "mapping": tmp_path / "m.yaml"}


def test_files_are_found_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path, f"robots: [{ROBOT[:-1]}, mapping: m.yaml}}]")
    monkeypatch.chdir(tmp_path)
    (one,) = read_robots(Path("robots.yaml"))
    files = one.urdf, *one.recordings, one.options["mapping"]
    assert files == tuple(tmp_path / name for name in ("arm.urdf", "a.csv", "m.yaml"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robots: [", "robots.yaml: is not YAML in UTF-8"),
        ("[]", "robots.yaml: expected options or robots, got []"),
        ("robots: []", "expected 'robots:' and a list of robots"),
        (f"robots: [{ROBOT}]\nrobot: 1", "line 2: unknown key 'robot' (did you mean 'robots'?)"),
        (f"robots: [{ROBOT}]\nrobots: [{ROBOT}]", "the key 'robots' stands twice"),
        ("robots: [{name: a, urdf: b}]", "line 1: robot 1, 'a': 'recordings' is missing"),
        (
            "robots: [{name: a, urdf: b, recordings: c, recording: d}]",
            "robot 1, 'a': unknown key 'recording' (did you mean 'recordings'?)",
        ),
        (f"robots: [{ROBOT}, {ROBOT}]", "two robots are called 'a'; results are named after them"),
        ("robots: [{name: ../a, urdf: b, recordings: c}]", "robot 1, '../a': the name is that of its folder"),
        ("robots: [{name: a, urdf: 3, recordings: c}]", "'a': urdf: expected the name of a file, got 3"),
        ("robots: [{name: a, urdf: b, recordings: [{c: d}]}]", "'a': recordings: expected the name of a file"),
        (
            f"options: {{cutof: 3}}\nrobots: [{ROBOT}]",
            "robots.yaml: line 1: unknown option 'cutof'; did you mean 'cutoff'?",
        ),
        (f"options: {{holdout: x.csv}}\nrobots: [{ROBOT}]", "'holdout' names files, which belong to a robot"),
        (f"options: 3\nrobots: [{ROBOT}]", "options: expected 'option: value'"),
        (f"options: {{cutoff: -1}}\nrobots: [{ROBOT}]", "robots.yaml: line 1: cutoff is -1 Hz"),
        (f"robots:\n  - {ROBOT}\n  - name: b\n    urdf: 3\n    recordings: c", "line 4: robot 2, 'b': urdf: expected"),
        (f"robots:\n  - {ROBOT}\n  - {{name: b, urdf: c}}", "line 3: robot 2, 'b': 'recordings' is missing"),
        (
            f"robots:\n  - {ROBOT[:-1]},\n    options: {{seed: 1,\n    sed: 2}}}}",
            "robot 1, 'a': line 4: unknown option 'sed'; did you mean 'seed'?",
        ),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(OptionError) as found:
        read_robots(written(tmp_path, text))
    assert words in str(found.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"none.yaml: cannot be read"):
        read_robots(tmp_path / "none.yaml")
