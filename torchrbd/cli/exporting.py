"""What ``torchrbd export`` does: read a model, check what it becomes, write it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from torchrbd._runtime.outputs import check_file as check_output
from torchrbd._runtime.outputs import write_whole
from torchrbd.cli.tables import print_export
from torchrbd.errors import InputError, OptionError
from torchrbd.export import load_model, not_exported
from torchrbd.export.check import check_file
from torchrbd.export.simulators import written

_MODEL = "model.safetensors"
_SUFFIXES = {"urdf": ".urdf", "mjcf": ".xml"}
# What is called otherwise may be a recording or a model, which is not to be overwritten.
_ALLOWED = ("", ".mjcf", *_SUFFIXES.values())


def export(
    given: Path, to: str, output: Path | None, check: Sequence[Path], mapping: Path | None, cutoff_hz: float | None
) -> None:
    """Write a model as a file for a simulator; with recordings to check on, compare the two before.

    Raises:
        InputError: no model there, or a recording or mapping that cannot be used.
        OptionError: a file that cannot be written, or options that are for the check without one.
    """
    if not check and (mapping or cutoff_hz is not None):
        raise OptionError("--mapping and --cutoff are of the recordings that --check names; name some")
    source = _source(given)
    file = output or source.with_suffix(_SUFFIXES[to])
    if file.is_dir():
        raise OptionError(f"output '{file}' is a folder; name a file, e.g. {file / source.stem}{_SUFFIXES[to]}")
    if file.suffix.lower() not in _ALLOWED:
        raise OptionError(f"output '{file}': expected a file that ends in {_SUFFIXES[to]}")
    check_output(file)
    model = load_model(source)
    content, lacking = written(model, to), not_exported(model, to)
    found = None
    if check:
        found = check_file(model, to, check, mapping=mapping, cutoff_hz=cutoff_hz)
    write_whole(file, content)
    print_export(file, lacking, found)


def _source(given: Path) -> Path:
    """Return the file of a model that is given by itself or by its folder."""
    if not given.is_dir():
        return given
    if not (given / _MODEL).is_file():
        raise InputError(
            f"{given}: holds no {_MODEL}; give the folder that 'torchrbd identify -o' or 'diagnose -o' wrote, "
            "or the file itself"
        )
    return given / _MODEL
