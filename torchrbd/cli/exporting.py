"""What ``torchrbd export`` does: read a model, check what it becomes, write it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch

from torchrbd._runtime.outputs import check_file as check_output
from torchrbd._runtime.outputs import write_whole
from torchrbd.cli.tables import print_export
from torchrbd.errors import InputError, OptionError
from torchrbd.export import load_model, not_exported
from torchrbd.export.check import check_file
from torchrbd.export.simulators import written
from torchrbd.learning import BayesianDynamics
from torchrbd.model import RigidBodyDynamics

_MODEL = "model.safetensors"
_SUFFIXES = {"urdf": ".urdf", "mjcf": ".xml", "isaaclab": ".py"}
_MOST_SAMPLES = 10_000
# What is called otherwise may be a recording or a model, which is not to be overwritten.
_ALLOWED = ("", ".mjcf", *_SUFFIXES.values())


def export(
    given: Path,
    to: str,
    output: Path | None,
    check: Sequence[Path],
    mapping: Path | None,
    cutoff_hz: float | None,
    samples: int | None = None,
    seed: int = 0,
) -> None:
    """Write a model as a file for a simulator; with recordings to check on, compare the two before.

    Args:
        given: the model's file or folder.
        to: the format.
        output: file, or folder of the samples; None for one next to the model.
        check: recordings.
        mapping, cutoff_hz: of these.
        samples: how many robots to draw from the posterior, in place of the model.
        seed: of these.

    Raises:
        InputError: no model there, one without a posterior, or a recording or mapping that cannot be used.
        OptionError: a file that cannot be written, or options that are for the check without one.
    """
    if not check and (mapping or cutoff_hz is not None):
        raise OptionError("--mapping and --cutoff are of the recordings that --check names; name some")
    if check and to == "isaaclab":
        raise OptionError("--check compares files in MuJoCo, which reads no configuration of Isaac Lab; leave it out")
    source = _source(given)
    if samples is not None:
        if check:
            raise OptionError("--check compares one file with its model; leave out --samples, or the check")
        _export_samples(source, to, output or source.with_name("samples"), samples, seed)
        return
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


def _export_samples(source: Path, to: str, folder: Path, samples: int, seed: int) -> None:
    """Write robots drawn from the posterior to a folder, one file each.

    Raises:
        InputError: the model has no posterior.
        OptionError: a number that cannot be drawn, or a folder that cannot be written.
    """
    if not 1 <= samples <= _MOST_SAMPLES:
        raise OptionError(f"--samples: expected 1 to {_MOST_SAMPLES}, got {samples}")
    if folder.exists() and not folder.is_dir():
        raise OptionError(f"output '{folder}' is a file; with --samples name a folder")
    check_output(folder / f"robot{_SUFFIXES[to]}")
    robots = BayesianDynamics.load(source).sample_robots(samples, seed)
    digits = len(str(samples - 1))
    files = {f"robot_{k:0{digits}}{_SUFFIXES[to]}": written(_with_signs(robots[k]), to) for k in range(samples)}
    for name, content in files.items():
        write_whole(folder / name, content)
    print_export(folder, not_exported(_with_signs(robots[0]), to), None)


def _with_signs(model: RigidBodyDynamics) -> RigidBodyDynamics:
    """Return a drawn robot whose friction resists: a coefficient that is drawn below zero becomes zero."""
    with torch.no_grad():
        for term in model.terms:
            for k in term.effect.prior.positive:
                term.coefficients[k].clamp_(min=0.0)
    return model


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
