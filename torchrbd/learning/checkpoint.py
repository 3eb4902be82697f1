"""How far a training is, as one safetensors file: nothing in it can run code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from torchrbd._runtime.outputs import write_whole
from torchrbd.errors import InputError

_FORMAT = "torchrbd-training-1"
_MODEL, _BEST, _OPTIMISER = "model.", "best.", "optimiser."


def write_checkpoint(
    path: str | Path,
    model: nn.Module,
    optimiser: torch.optim.Optimizer,
    best: Mapping[str, Tensor] | None,
    progress: Mapping[str, Any],
) -> None:
    """Write a training to a file, which is replaced at once or not at all.

    Args:
        path: of the file.
        model, optimiser: as they are.
        best: state of the model that was best so far, if one was chosen.
        progress: what else there is to know, for JSON.
    """
    tensors = {_MODEL + name: x for name, x in model.state_dict().items()}
    tensors |= {_BEST + name: x for name, x in (best or {}).items()}
    for k, own in optimiser.state_dict()["state"].items():
        tensors |= {f"{_OPTIMISER}{k}.{name}": torch.as_tensor(x) for name, x in own.items()}
    content = save(
        {name: x.detach().cpu().clone(memory_format=torch.contiguous_format) for name, x in tensors.items()},
        {"format": _FORMAT, "progress": json.dumps(progress)},
    )
    write_whole(path, content)


def read_checkpoint(
    path: str | Path, model: nn.Module, optimiser: torch.optim.Optimizer
) -> tuple[dict[str, Tensor] | None, dict[str, Any]]:
    """Bring model and optimiser to where a training was; return the best state so far, and its progress.

    Raises:
        InputError: no checkpoint, or one of another model.
    """
    try:
        with safe_open(path, framework="pt") as file:
            about = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path}: cannot be read as a checkpoint ({error})") from None
    if about.get("format") != _FORMAT:
        raise InputError(f"{path}: is no checkpoint of torchrbd; expected '{_FORMAT}', got '{about.get('format')}'")
    try:
        model.load_state_dict(_under(_MODEL, tensors))
    except RuntimeError as error:
        raise InputError(f"{path}: is of another model; delete it or give another path ({error})") from None
    state: dict[int, dict[str, Tensor]] = {}
    for name, x in _under(_OPTIMISER, tensors).items():
        k, _, own = name.partition(".")
        state.setdefault(int(k), {})[own] = x
    optimiser.load_state_dict({**optimiser.state_dict(), "state": state})
    return _under(_BEST, tensors) or None, json.loads(about["progress"])


def _under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): x for name, x in tensors.items() if name.startswith(prefix)}
