"""Run golden cases; as a program, write down what they say.

python -m golden.record [NAME...]        (from tests/, with TORCHRBD_DATA for the real ones)
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from golden.cases import CASES, Case
from golden.contents import contents, differences
from golden.counters import counters

import torchrbd

EXPECTED = Path(__file__).parent / "expected"


def file_of(name: str) -> Path:
    """Return where the expected contents of a case are."""
    return EXPECTED / f"{name.replace(' ', '_').lower()}.json"


def run(case: Case, folder: Path) -> tuple[dict[str, Any], dict[str, float]]:
    """Return the contents of a case's diagnosis, as JSON has them, and its counters."""
    asked = case.make(folder)
    with counters() as counted:
        result = torchrbd.diagnose(asked.robot, asked.recordings, **asked.options)
    return json.loads(json.dumps(contents(result))), counted


def _write(name: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        found, counted = run(CASES[name], Path(folder))
    file = file_of(name)
    before = json.loads(file.read_text()) if file.exists() else None
    changed = [] if before is None else list(differences(before["contents"], found))
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps({"contents": found, "counters": counted}, indent=1) + "\n")
    print(f"{name}: {found['verdict']}, {counted}", *changed, sep="\n  ", flush=True)


if __name__ == "__main__":
    for each in sys.argv[1:] or CASES:
        _write(each)
