"""Result files: ``benchmarks/results/NAME.json`` hold the figures that the documentation shows.

    {"what": "...", "results": {"<key>": {..., "measured": {"command", "commit", "date"}}}}

A benchmark updates the results of the keys that it ran and leaves the others.
"""

from __future__ import annotations

import datetime
import json
import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent / "results"


def read(name: str) -> dict[str, Any]:
    """Return a result file, with no results where there is none yet."""
    path = FOLDER / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"what": name, "results": {}}


def update(name: str, command: str, results: Mapping[str, Mapping[str, Any]]) -> Path:
    """Write results by their keys, with the command, the commit and the date of today."""
    content = read(name)
    measured = {"command": command, "commit": commit(), "date": datetime.date.today().isoformat()}
    for key, values in results.items():
        content["results"][key] = {**values, "measured": measured}
    FOLDER.mkdir(exist_ok=True)
    path = FOLDER / f"{name}.json"
    path.write_text(text(content), encoding="utf-8")
    return path


def text(content: Mapping[str, Any]) -> str:
    """Return JSON with the innermost lists on one line."""
    lines = json.dumps(content, indent=1, ensure_ascii=False)
    return re.sub(r"\[\s+([^\[\]{}]*?)\s+\]", lambda m: "[" + re.sub(r"\s*\n\s*", " ", m[1]) + "]", lines) + "\n"


def commit() -> str:
    """Return the commit that is checked out, with a plus where the code differs from it."""
    head = _git("rev-parse", "--short", "HEAD")
    changed = _git("status", "--porcelain", "--", "torchrbd", "benchmarks/*.py", "examples")
    return (head or "unknown") + "+" * bool(changed)


def _git(*arguments: str) -> str:
    found = subprocess.run(["git", *arguments], cwd=FOLDER.parents[1], capture_output=True, text=True, check=False)
    return found.stdout.strip()
