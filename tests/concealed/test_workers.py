"""Processes that work side by side do not outlive the program."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import time
from concealed.workers import workers

if __name__ == "__main__":
    with workers(1) as pool:
        pool.submit(time.sleep, 0.0).result()
        print("works", flush=True)
        pool.submit(time.sleep, 60.0).result()
"""


def test_workers_end_when_the_program_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "program.py"
    script.write_text(PROGRAM)
    path = str(Path(__file__).parents[2] / "benchmarks")
    program = subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": path}
    )
    assert program.stdout is not None
    assert program.stdout.readline() == "works\n"
    program.kill()
    # The output ends when the last process that could write to it does.
    assert program.communicate(timeout=20.0) == ("", None)
