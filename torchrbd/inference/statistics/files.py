"""Statistics as one safetensors file: moments as tensors, what they depend on as metadata; no code in either."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from torchrbd import __version__
from torchrbd.effects import JointScale
from torchrbd.errors import InputError
from torchrbd.inference.statistics.results import Conditions, Origin, Statistics
from torchrbd.likelihood.block_statistics import Block
from torchrbd.outputs import write_whole
from torchrbd.rebuilding import rebuilt

_FORMAT, _HEADER = "torchrbd-statistics-2", "statistics"


def write_file(found: Statistics, path: str | Path) -> None:
    """Write statistics, whole or not at all.

    Tensors: ``moments.<joint>`` (B, p, p), the last row and column the torque's; ``torque`` (B, n_dof, 3), see
    ``BlockStatistics``; ``time`` (B, 2) [s] and ``recording`` (B,), index into the origins. Metadata, as JSON under
    ``statistics``: ``format``, ``conditions``, ``origins``, ``scales`` and ``labels``, see ``results.py``. What is
    equal makes equal files.
    """
    number = {one.name: k for k, one in enumerate(found.origins)}
    tensors = {f"moments.{joint}": own for joint, own in zip(found.conditions.joints, found.moments, strict=True)}
    tensors["torque"] = found.torque
    tensors["time"] = torch.tensor([[b.start_s, b.end_s] for b in found.blocks], dtype=torch.float64).reshape(-1, 2)
    tensors["recording"] = torch.tensor([number[b.recording] for b in found.blocks], dtype=torch.int64)
    header = {
        "format": _FORMAT,
        "conditions": asdict(found.conditions),
        "origins": [asdict(one) for one in found.origins],
        "scales": [asdict(one) for one in found.scales],
        "labels": found.labels,
    }
    # One entry: safetensors writes several in an order that differs from run to run.
    metadata = {_HEADER: json.dumps(header)}
    write_whole(path, save({name: x.contiguous() for name, x in tensors.items()}, metadata))


def read_statistics(path: str | Path) -> Statistics:
    """Read what ``write_file`` wrote.

    Raises:
        InputError: no such file, none of ours, or of another version.
    """
    made, origins, scales, labels = read_header(path)
    if made.version != __version__:
        raise InputError(
            f"{path}: was made by torchrbd {made.version}, this is {__version__}; make it anew with 'torchrbd stats'"
        )
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        return _statistics(made, origins, scales, labels, tensors, str(path))
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, IndexError, RuntimeError) as error:
        raise _damaged(path, error) from None


def read_header(
    path: str | Path,
) -> tuple[Conditions, tuple[Origin, ...], tuple[JointScale, ...], tuple[tuple[str, ...], ...]]:
    """Return what a file says of itself, without its moments.

    Raises:
        InputError: no such file, or none of ours.
    """
    try:
        with safe_open(path, framework="pt") as file:
            text = (file.metadata() or {}).get(_HEADER, "{}")
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path}: cannot be read as statistics ({error})") from None
    try:
        header = json.loads(text)
        if header.get("format") != _FORMAT:
            raise InputError(
                f"{path}: is no statistics file of torchrbd {__version__}; expected format '{_FORMAT}', got "
                f"'{header.get('format')}'; make it anew with 'torchrbd stats'"
            )
        return (
            rebuilt(Conditions, header["conditions"]),
            rebuilt(tuple[Origin, ...], header["origins"]),
            rebuilt(tuple[JointScale, ...], header["scales"]),
            rebuilt(tuple[tuple[str, ...], ...], header["labels"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise _damaged(path, error) from None


def _damaged(path: str | Path, error: Exception) -> InputError:
    words = f"{path}: is damaged ({type(error).__name__}: {error}); make it anew with 'torchrbd stats'"
    return InputError(words)


def _statistics(
    made: Conditions,
    origins: tuple[Origin, ...],
    scales: tuple[JointScale, ...],
    labels: tuple[tuple[str, ...], ...],
    tensors: Mapping[str, Tensor],
    place: str,
) -> Statistics:
    moments, torque = tuple(tensors[f"moments.{joint}"] for joint in made.joints), tensors["torque"]
    count, sizes = len(torque), [m.shape[-1] for m in moments]
    if [tuple(m.shape) for m in moments] != [(count, p, p) for p in sizes]:
        raise ValueError("moments are no square matrices, one a block")
    if torque.shape != (count, len(moments), 3) or not len(scales) == len(labels) == len(moments):
        raise ValueError("torques, scales or labels are not those of the joints")
    if not all(x.dtype == torch.float64 and bool(torch.isfinite(x).all()) for x in (*moments, torque)):
        raise ValueError("moments are not finite numbers of 64 bits")
    blocks = tuple(
        Block(origins[k].name, start, end)
        for k, (start, end) in zip(tensors["recording"].tolist(), tensors["time"].tolist(), strict=True)
    )
    if len(blocks) != count:
        raise ValueError(f"{len(blocks)} blocks for {count} moments")
    return Statistics(made, origins, scales, labels, blocks, moments, torque, place)
