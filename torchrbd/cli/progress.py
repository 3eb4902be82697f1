"""How far the work is, on stderr: a bar on a terminal, and a line a stage wherever it goes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress

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

# Lines come no sooner and no faster than this [s]; a stage that lasts is named again after so long [s].
_EVERY_S, _STILL_S = 2.0, 30.0


@contextmanager
def progress_bar(
    *, time_left: bool = False, shown: bool = True, quiet: bool = False
) -> Iterator[Callable[[str, float], None]]:
    """Say on stderr what is done, if it takes more than two seconds: "torchrbd: 12 s, fitting, 40 %".

    Args:
        time_left: let the bar say how long it will take, where the work is much of the same.
        shown: whether this process is the one that shows it.
        quiet: show nothing.
    """
    columns: list[ProgressColumn] = [
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeElapsedColumn(),
    ]
    if time_left:
        columns += [TextColumn("left"), TimeRemainingColumn()]
    console, loud = Console(stderr=True, highlight=False, soft_wrap=True), shown and not quiet
    with Progress(*columns, console=console, transient=True, disable=not (loud and console.is_terminal)) as bar:
        task = bar.add_task("reading", total=None)
        lines = _Lines(console)

        def report(stage: str, part: float) -> None:
            bar.update(task, description=stage, total=1.0 if part else None, completed=part)
            lines.now = stage, part

        with lines if loud else nullcontext():
            yield report


class _Lines:
    """Prints the stage of the work, and how far it is, from a thread of its own.

    Attributes:
        now: the stage, and the part of it that is done; 0 where that is not known.
    """

    def __init__(self, console: Console) -> None:
        self.now: tuple[str, float] = ("reading", 0.0)
        self._console, self._start, self._ended = console, time.monotonic(), threading.Event()
        self._thread = threading.Thread(target=self._print, daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _print(self) -> None:
        last, since = "", 0.0
        while not self._ended.wait(_EVERY_S):
            (stage, part), elapsed = self.now, time.monotonic() - self._start
            if stage == last and elapsed - since < _STILL_S:
                continue
            last, since = stage, elapsed
            done = f", {100 * part:.0f} %" if part else ""
            # Who listens may have gone; rich exits then.
            with suppress(OSError, ValueError, SystemExit):
                self._console.print(f"torchrbd: {elapsed:.0f} s, {stage}{done}", markup=False)
