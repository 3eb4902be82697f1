"""The bar on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


@contextmanager
def progress_bar(*, time_left: bool = False, shown: bool = True) -> Iterator[Callable[[str, float], None]]:
    """Show one bar on a terminal, and nothing where the output is not one.

    Args:
        time_left: say how long it will take, where the work is much of the same.
        shown: whether this process is the one that shows it.
    """
    columns: list[ProgressColumn] = [
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
    ]
    if time_left:
        columns += [TextColumn("left"), TimeRemainingColumn()]
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not (shown and console.is_terminal)) as bar:
        task = bar.add_task("reading", total=None)

        def report(stage: str, part: float) -> None:
            bar.update(task, description=stage, total=1.0 if part else None, completed=part)

        yield report
