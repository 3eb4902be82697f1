"""Figures of the README and of the documentation are those of the result files."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import results_file
import validation_page

ROOT = Path(__file__).parent.parent
FILES = sorted(results_file.FOLDER.glob("*.json"))


def test_pages_show_the_result_files() -> None:
    assert validation_page.main(["--check"]) == 0, "run python benchmarks/validation_page.py"


def test_a_figure_that_was_changed_by_hand_is_seen() -> None:
    page = ROOT / "README.md"
    text = page.read_text(encoding="utf-8")
    assert validation_page.filled(text) == text
    cell = re.search(r"\| \*\*([\d.]+)\*\* \|", text)
    assert cell is not None
    assert validation_page.filled(text.replace(cell[0], "| **0.0001** |")) == text


def test_every_table_is_shown_and_every_shown_table_exists() -> None:
    shown = {m["name"] for p in validation_page.pages() for m in validation_page.TABLE.finditer(p.read_text())}
    assert shown == set(validation_page.TABLES)


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_a_result_says_how_it_was_measured(path: Path) -> None:
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["what"]
    assert content["results"]
    for key, result in content["results"].items():
        measured = result["measured"]
        assert measured["command"], key
        assert re.fullmatch(r"[0-9a-f]{7,}\+?", measured["commit"]), key
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", measured["date"]), key
        if "columns" in result:
            assert {len(row) for row in result["rows"]} == {len(result["columns"])}, key


def test_text_of_the_pages_has_no_commits_and_no_private_words() -> None:
    banned = (
        r"\b(told|tells? apart|beside|set apart|stands? for|held-out time|at a glance|leftover|trifling|trifles?)\b"
    )
    for page in validation_page.pages():
        text = page.read_text(encoding="utf-8")
        assert not re.findall(banned, text, re.IGNORECASE), page
        assert not re.findall(r"\b(?=\w*\d)(?=\w*[a-f])[0-9a-f]{7,10}\b", text), page


def test_pages_are_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 700
    counts = {p: len(p.read_text(encoding="utf-8").split()) for p in (ROOT / "docs").rglob("*.md")}
    assert sum(counts.values()) <= 15_000


def test_results_keep_what_is_not_measured_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results_file, "FOLDER", tmp_path)
    results_file.update("some", "python a.py", {"a": {"rows": [[1, 2]], "columns": ["x", "y"]}})
    path = results_file.update("some", "python b.py", {"b": {"value": 1.0}})
    assert "[1, 2]" in path.read_text()
    assert set(results_file.read("some")["results"]) == {"a", "b"}
    assert results_file.read("some")["results"]["a"]["measured"]["command"] == "python a.py"
