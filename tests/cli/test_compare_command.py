"""The command that compares two diagnoses: files in, table and files out."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from pathlib import Path

import pytest

from torchrbd.cli import main
from torchrbd.diagnosis.results import Finding, Quantity, Where


def diagnosed(folder: Path, coulomb: float, robot: str = "arm") -> Path:
    quantities = {"coulomb": Quantity(coulomb, 0.01, "N m")}
    found = Finding("coulomb_friction", ("joint[1]",), (), 0.999, 90.0, quantities, Where(), (), {}, {})
    content = {"robot": robot, "joints": ["joint[1]"], "recordings": [folder.name], "cutoff_hz": 5.0}
    folder.mkdir()
    (folder / "diagnosis.json").write_text(json.dumps(content | {"findings": [asdict(found)]}))
    return folder


def test_compare_prints_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, after = diagnosed(tmp_path / "before", 1.2), diagnosed(tmp_path / "after", 1.9)
    assert main(["compare", str(before), str(after / "diagnosis.json"), "-o", str(tmp_path / "out")]) == 0
    told = re.sub(r"\s+", " ", capsys.readouterr().out)
    assert told.startswith("arm: Coulomb friction of joint[1] grew from 1.20 to 1.90 N m")
    for part in ("│ coulomb │ 1.20 │ 1.90 │", "+0.700 ± 0.028", "wrote comparison.json and comparison.html"):
        assert part in told
    content = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert content["changes"][0]["verdict"] == "changed"
    assert "joint[1]" in (tmp_path / "out" / "comparison.html").read_text()


def test_what_changed_does_not_decide_the_exit_code(tmp_path: Path) -> None:
    before, after = diagnosed(tmp_path / "before", 1.2), diagnosed(tmp_path / "after", 1.2)
    assert main(["compare", str(before), str(after)]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"before", "after"}


def test_unusable_input_ends_with_two(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, other = diagnosed(tmp_path / "good", 1.2), diagnosed(tmp_path / "other", 1.2, robot="leg")
    for bad in (other, tmp_path / "none"):
        assert main(["compare", str(good), str(bad), "-o", str(tmp_path / "out")]) == 2
        told = capsys.readouterr().err
        assert told.startswith("torchrbd: error: ")
        assert "Traceback" not in told
    assert not (tmp_path / "out").exists()


def test_diagnose_tells_of_simulated_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diagnose", "--help"]) == 0
    told = re.sub(r"[\s│]+", " ", capsys.readouterr().out)
    assert "--simulated FILE" in told
    assert "is reported as inertial parameters" in told
