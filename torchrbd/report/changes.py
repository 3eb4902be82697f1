"""The page of a comparison: what changed between two diagnoses, in one table."""

from __future__ import annotations

from pathlib import Path

from torchrbd._runtime.outputs import write_whole
from torchrbd.comparison.results import Change, Comparison, Difference
from torchrbd.report.templates import environment
from torchrbd.report.text.comparison import certainty, signed
from torchrbd.report.text.names import at, words_of

VERDICTS = {"changed": "≠ changed", "unchanged": "= unchanged", "open": "? undecided"}
# Inertial parameters that are shown; comparison.json has all.
MOST_INERTIAL, LIKELY = 8, 0.5


def write_changes_report(result: Comparison, path: Path) -> None:
    """Write one HTML file that needs nothing else: no scripts, no external style, font or picture."""
    templates = environment()
    templates.filters |= {"certainty": certainty, "signed": signed}
    templates.globals |= {"shown": shown, "title": title, "verdicts": VERDICTS}
    text = templates.get_template("changes.html.j2").render(result=result)
    write_whole(path, text.encode())


def title(change: Change) -> str:
    """Return what a change is of, "Coulomb friction at joint2"."""
    if change.kind == "inertia":
        return "inertial parameters"
    words = "unexplained" if change.kind == "unexplained" else words_of(change.effect)
    others = f" ({', '.join(change.depends_on)})" if change.depends_on else ""
    return words + others + (at(change.joints, change.links) or " of the whole robot")


def shown(change: Change) -> list[tuple[str, Difference]]:
    """Return the parameters to show: of inertial ones, those that are likely to have changed, most likely first."""
    if change.kind != "inertia":
        return list(change.parameters.items())
    likely = [(name, d) for name, d in change.parameters.items() if d.probability > LIKELY]
    return sorted(likely, key=lambda one: -one[1].probability)[:MOST_INERTIAL]
