"""Statistics as one safetensors file: moments as tensors, what they depend on as metadata; no code in either."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from torchrbd._runtime.outputs import write_whole
from torchrbd._runtime.rebuilding import rebuilt
from torchrbd.dataset.block_statistics import Block
from torchrbd.effects import JointScale
from torchrbd.errors import InputError
from torchrbd.inference.statistics.results import Conditions, Origin, Statistics
from torchrbd.recordings.formats.opening import STATISTICS

FORMAT = 4
"""Of the files; it counts each change of what they hold or of what their numbers mean. Those of one format add."""

_HEADER = "statistics"
_REMEDY = "give those that 'torchrbd stats' wrote"
_LABELS = tuple[tuple[str, ...], ...]


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
        "format": FORMAT,
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
        InputError: no such file, none of ours, or of another format.
    """
    head = read_head(path)
    try:
        with safe_open(path, framework="pt") as file:
            *moments, torque = (file.get_tensor(name) for name in _numbers(head.conditions))
    except (OSError, SafetensorError) as error:
        raise _damaged(path, error) from None
    if not all(bool(torch.isfinite(x).all()) for x in (*moments, torque)):
        raise _damaged(path, ValueError("numbers are not finite"))
    return replace(head, moments=tuple(moments), torque=torque)


def read_head(path: str | Path) -> Statistics:
    """Read what a file says of itself and of its blocks: all but its numbers, of which there are none, (0, ...) each.

    Raises:
        InputError: no such file, none of ours, or of another format.
    """
    if Path(path).is_dir():
        raise InputError(f"{path}: is a folder; give the files in it, e.g. {path}/*{STATISTICS}")
    if not Path(path).exists():
        raise InputError(f"{path}: no such file; check the path")
    try:
        with safe_open(path, framework="pt") as file:
            header = _header(path, (file.metadata() or {}).get(_HEADER, "{}"))
            return _head(header, file, str(path))
    except InputError:
        raise
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path}: is no statistics file, or is damaged; {_REMEDY} ({error})") from None
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RuntimeError, RecursionError) as error:
        raise _damaged(path, error) from None


def _header(path: str | Path, text: str) -> dict[str, Any]:
    """Return the metadata of a file of this format."""
    header = json.loads(text)
    if not header:
        raise InputError(f"{path}: is no statistics file; {_REMEDY}")
    if header.get("format") != FORMAT:
        raise InputError(
            f"{path}: has format {header.get('format')}, and this torchrbd reads format {FORMAT}; make it anew with "
            "'torchrbd stats', or use the torchrbd that made it"
        )
    return header


def _head(header: dict[str, Any], file: Any, place: str) -> Statistics:
    """Return what an open file holds besides its numbers, whose shapes and kinds are checked."""
    made, origins = rebuilt(Conditions, header["conditions"]), rebuilt(tuple[Origin, ...], header["origins"])
    scales, labels = rebuilt(tuple[JointScale, ...], header["scales"]), rebuilt(_LABELS, header["labels"])
    time, recording = (file.get_tensor(name).tolist() for name in ("time", "recording"))
    blocks = tuple(Block(origins[k].name, start, end) for k, (start, end) in zip(recording, time, strict=True))
    slices = [file.get_slice(name) for name in _numbers(made)]
    *shapes, torque = (tuple(one.get_shape()) for one in slices)
    if any(shape != (len(blocks), shape[-1], shape[-1]) for shape in shapes):
        raise ValueError("moments are no square matrices, one a block")
    if torque != (len(blocks), len(shapes), 3) or not len(scales) == len(labels) == len(shapes):
        raise ValueError("torques, scales or labels are not those of the joints")
    if {one.get_dtype() for one in slices} != {"F64"}:
        raise ValueError("moments are not numbers of 64 bits")
    *moments, torque = (torch.zeros(0, *shape[1:], dtype=torch.float64) for shape in (*shapes, torque))
    return Statistics(made, origins, scales, labels, blocks, tuple(moments), torque, place)


def _numbers(made: Conditions) -> tuple[str, ...]:
    """Return the names of the tensors that grow with the columns."""
    return (*(f"moments.{joint}" for joint in made.joints), "torque")


def _damaged(path: str | Path, error: Exception) -> InputError:
    words = f"{path}: is damaged ({type(error).__name__}: {error}); make it anew with 'torchrbd stats'"
    return InputError(words)
