"""The public interface as it was: names and signatures, JSON schemas, help texts.

A change that is meant is written down with TORCHRBD_SNAPSHOTS=write; the diff of ``snapshots/`` then shows it.
"""

from __future__ import annotations

import inspect
import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import torchrbd
from torchrbd.cli import main
from torchrbd.export.schemas import NAMES, schema

SNAPSHOTS = Path(__file__).parent / "snapshots"


def same(name: str, text: str) -> None:
    file = SNAPSHOTS / name
    if os.environ.get("TORCHRBD_SNAPSHOTS") == "write":
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
    assert text == file.read_text(), f"{name} changed; if this is meant, run with TORCHRBD_SNAPSHOTS=write"


def interface() -> Iterator[str]:
    """Yield each public name with its signature, and the public members of classes."""
    for name in sorted(torchrbd.__all__):
        thing = getattr(torchrbd, name)
        if inspect.isclass(thing):
            yield f"class {name}"
            members = sorted(k for k in vars(thing) if not k.startswith("_"))
            yield from (f"    {k}" for k in members)
        else:
            arguments = ", ".join(str(p).split(":")[0].split("=")[0].strip() for p in parameters(thing))
            yield f"def {name}({arguments})"


def parameters(function: object) -> Iterator[inspect.Parameter]:
    yield from inspect.signature(function).parameters.values()  # pyright: ignore[reportArgumentType]


def test_public_names() -> None:
    same("interface.txt", "\n".join(interface()) + "\n")


@pytest.mark.parametrize("name", NAMES)
def test_schemas(name: str) -> None:
    same(f"{name}.schema.json", json.dumps(schema(name), indent=1, sort_keys=True) + "\n")


@pytest.mark.skipif(sys.version_info < (3, 11), reason="cyclopts for Python 3.10 lays help out differently")
def test_help(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    assert main(["--help"]) == 0
    whole = capsys.readouterr().out
    commands = re.findall(r"^[│ ]+([a-z][a-z-]+) {2,}[A-Z]", whole, re.MULTILINE)
    assert len(commands) > 10
    for command in commands:
        assert main([command, "--help"]) == 0
        whole += f"\n$ torchrbd {command} --help\n{capsys.readouterr().out}"
    same("help.txt", "\n".join(line.rstrip() for line in whole.splitlines()) + "\n")
