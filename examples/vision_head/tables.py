"""The experiment's figures for a terminal and for ``benchmarks/results/vision_head.json``."""

from __future__ import annotations

from collections import Counter

import numpy as np
from rich.table import Table

from .experiment import MEASURES, TRUTH, Conditions, Results
from .methods import DEFAULT

LIMIT = 0.8


def heading(conditions: Conditions) -> str:
    """Say in what the conditions differ from those of other runs."""
    effects = " and ".join(conditions.effects) or "no"
    return f"Recorded with a neck of up to {conditions.neck_hz:g} Hz, {effects} concealed effects"


def rows(results: Results, controller: str) -> list[tuple[str, ...]]:
    """Return one row per method: error mean and spread over seeds per measure, median excess per measure, failures."""
    excess, found = results.excess(controller), []
    for m, name in enumerate(results.names):
        errors, why = results.errors[controller][:, m], [w for w in results.failures[controller][:, m] if w]
        cells = [name]
        for k in range(len(MEASURES)):
            own = errors[~np.isnan(errors[:, k]), k]
            cells.append(f"{own.mean():.2g} ± {own.std():.1g}" if len(own) else "failure")
        cells += ["" if name == TRUTH else _number(value) for value in excess[m]]
        reasons = "; ".join(f"{n} {w}" for w, n in Counter(why).most_common())
        found.append((*cells, f"{len(why)} of {len(errors)}" + (f" ({reasons})" if why else "")))
    return found


def columns() -> list[str]:
    """Return the headings of ``rows``."""
    return [
        "parameters",
        *(f"{name} [{unit}]" for name, unit in MEASURES.items()),
        *(f"excess {name}" for name in MEASURES),
        "failures",
    ]


def ratios(results: Results) -> list[tuple[str, str, str, str, str]]:
    """Return per controller and measure the best classical method and the default's excess in parts of its."""
    found = []
    for controller in results.errors:
        own = results.excess(controller)[results.names.index(DEFAULT)]
        names, best = results.best_classical(controller)
        for k, (measure, unit) in enumerate(MEASURES.items()):
            ratio = results.ratio(controller)[k]
            found.append(
                (controller, f"{measure} [{unit}]", f"{_number(best[k])} ({names[k]})", _number(own[k]), f"{ratio:.2f}")
            )
    return found


RATIO_COLUMNS = ["controller", "measure", "best classical method's excess", f"{DEFAULT}'s excess", "ratio"]


def verdict(results: Results) -> str:
    """Say whether the default keeps the limit, and whether it ever failed."""
    worst = max(float(results.ratio(controller).max()) for controller in results.errors)
    m = results.names.index(DEFAULT)
    failures = sum(bool(why) for table in results.failures.values() for why in table[:, m])
    n_runs = sum(len(table) for table in results.failures.values())
    kept = "at most" if worst <= LIMIT else "above"
    return (
        f"Largest of the nine ratios: {worst:.2f}, {kept} the {LIMIT} that is asked for. "
        f"{DEFAULT} failed in {failures} of {n_runs} runs."
    )


def rich_table(title: str, heads: list[str], body: list[tuple[str, ...]]) -> Table:
    """Return a table for the terminal."""
    table = Table(*heads, title=title)
    for row in body:
        table.add_row(*row)
    return table


def stored(runs: list[tuple[Conditions, Results]]) -> dict[str, dict[str, list]]:
    """Return the tables as columns and rows, by what they show and the speed of the recorded neck."""
    found = {}
    for conditions, results in runs:
        hz = f"{conditions.neck_hz:g}_hz"
        found[f"summary_{hz}"] = {"columns": RATIO_COLUMNS, "rows": [list(row) for row in ratios(results)]}
        for controller in results.errors:
            body = [list(row) for row in rows(results, controller)]
            found[f"{controller.replace(' ', '_')}_{hz}"] = {"columns": columns(), "rows": body}
    return found


def _number(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "failure"
