"""``torchrbd compare``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from torchrbd.cli.parameters import examples, file, value

_RESULT = "folder that 'diagnose -o' wrote, or its diagnosis.json: {}"
AFTER = examples(
    "torchrbd compare before/ after/",
    "torchrbd compare january/diagnosis.json june/diagnosis.json -o changes",
)


def compare(
    before: Annotated[Path, file("BEFORE", _RESULT.format("the first"))],
    after: Annotated[Path, file("AFTER", _RESULT.format("the second"))],
    /,
    *,
    output: Annotated[Path | None, value("DIR", "folder for comparison.json and comparison.html", short="o")] = None,
) -> None:
    """Report what changed between two diagnoses of one robot, and how certain that is."""
    from torchrbd.cli.running import compare_results

    compare_results(before, after, output)
