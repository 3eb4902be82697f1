"""Whatever the output goes to: an old terminal, a full device, a pipe that nobody reads."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from shortened import slow_but

RUN = [sys.executable, "-m", "torchrbd"]


def ended(command: list[str], **more) -> subprocess.CompletedProcess:
    return subprocess.run(command, capture_output=True, check=False, **more)


@pytest.mark.parametrize(
    ("encoding", "command", "word"),
    slow_but(
        [("ascii", "--help", "diagnose")],
        [
            ("ascii", "--help", "diagnose"),
            ("ascii", "effects", "viscous_friction"),
            ("cp1252", "effects", "viscous_friction"),
        ],
    ),
)
def test_terminals_without_unicode(encoding: str, command: str, word: str) -> None:
    """Help has boxes, the list of effects superscripts and minus signs too."""
    told = ended([*RUN, command], env={**os.environ, "PYTHONIOENCODING": encoding, "COLUMNS": "120"})
    assert (told.returncode, told.stderr) == (0, b"")
    assert word in told.stdout.decode(encoding)


def test_numbers_stay_readable_in_ascii() -> None:
    code = "from torchrbd.cli.terminal import speak_plainly; speak_plainly(); print('2.4 ± 0.1 → −3·10⁻⁵ m² °C ✓')"
    told = ended([sys.executable, "-c", code], env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert told.stdout.decode().strip() == "2.4 +/- 0.1 -> -3*10-5 m2 degC ok"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_a_full_device_is_told_once() -> None:
    with Path("/dev/full").open("w") as full:
        told = subprocess.run([*RUN, "--help"], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert told.returncode == 2
    assert "No space left on device" in told.stderr
    assert "Traceback" not in told.stderr
    assert "Exception ignored" not in told.stderr


def test_a_pipe_that_nobody_reads_is_no_error() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    told = subprocess.run([*RUN, "--help"], stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writing)
    assert (told.returncode, told.stderr) == (0, "")


@pytest.mark.slow
def test_nobody_listens_at_all() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    told = subprocess.run([*RUN, "compare", "no", "no"], stdout=writing, stderr=writing, check=False)
    os.close(writing)
    assert told.returncode == 2
