"""What a diagnosis says on fixed cases: findings, evidence, figures and counters, as they were.

``make golden`` runs all of them. Where a change is meant, look at each difference, then write it down:

    python -m golden.record NAME...      (from tests/; all cases without a name)
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import real_sets
from golden.cases import CASES, Case
from golden.contents import differences
from golden.record import EXPECTED, file_of, run

CHOSEN = [pytest.param(case, id=name, marks=() if case.quick else pytest.mark.slow) for name, case in CASES.items()]


@pytest.mark.parametrize("case", CHOSEN)
def test_a_diagnosis_says_what_it_said(case: Case, tmp_path: Path) -> None:
    if case.needs_data and real_sets.data_folder() is None:
        pytest.skip("TORCHRBD_DATA is not set: no real recordings")
    expected = json.loads(file_of(case.name).read_text())
    found, counted = run(case, tmp_path)
    changed = list(differences(expected["contents"], found))
    assert not changed, "\n".join(changed)
    more = {k: (n, counted[k]) for k, n in expected["counters"].items() if k != "cpu_s" and counted[k] > n}
    assert not more, f"more work than before (before, now): {more}"


def test_every_file_belongs_to_a_case() -> None:
    assert {file.name for file in EXPECTED.glob("*.json")} == {file_of(name).name for name in CASES}
