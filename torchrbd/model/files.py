"""A model as one safetensors file: numbers as tensors, URDF and terms as metadata. Nothing in it can run code."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import torch
from lxml import etree
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from torchrbd._runtime.outputs import write_whole
from torchrbd.effects import Site, Term, Window, effect
from torchrbd.errors import InputError, RobotError
from torchrbd.model.conditions import Condition, Reported, from_content, to_content
from torchrbd.parameters import from_log_cholesky
from torchrbd.recordings import Drives
from torchrbd.robot import RobotModel

NAME = "model.safetensors"
"""File name in a folder of results."""
# Prefix of the tensors of the posterior.
_POSTERIOR = "posterior."
_FORMAT = "torchrbd-model-2"


class Parts(NamedTuple):
    """The content of a model file.

    Attributes:
        pi: (n_params,) inertial parameters.
        state: of the module.
        posterior: its uncertainty, tensors by name; empty if the file has none.
        conditions: of recordings, by name.
        reported: the error that was reported for it, if any.
        drives: of the robot, if torques were those of drives.
    """

    robot: RobotModel
    pi: Tensor
    terms: list[Term]
    state: dict[str, Tensor]
    posterior: dict[str, Tensor]
    conditions: dict[str, Condition]
    reported: Reported | None
    drives: Drives | None


def write_model(
    path: str | Path,
    robot: RobotModel,
    terms: Sequence[Term],
    state: Mapping[str, Tensor],
    posterior: Mapping[str, Tensor] | None = None,
    *,
    conditions: Mapping[str, Condition],
    reported: Reported | None,
    drives: Drives | None = None,
) -> None:
    """Write a model to a safetensors file; arguments as of ``Parts``.

    Raises:
        RobotError: the robot was not made from a URDF.
    """
    if robot.urdf is None:
        raise RobotError(f"robot '{robot.name}' was not made from a URDF, which the file would have to hold")
    metadata = {
        "format": _FORMAT,
        "urdf": etree.tostring(etree.fromstring(robot.urdf), encoding="unicode"),
        "gravity": json.dumps(robot.gravity.tolist()),
        "terms": json.dumps([{"effect": t.effect.id, "site": asdict(t.site), "shape": t.shape} for t in terms]),
        "conditions": json.dumps(to_content(conditions)),
        "reported": json.dumps(None if reported is None else asdict(reported)),
        "drives": json.dumps(None if drives is None else drives.to_content()),
    }
    tensors = {**state, **{_POSTERIOR + name: value for name, value in (posterior or {}).items()}}
    # Written by Python, so the file has the user's usual permissions; safetensors would make it readable by the owner
    # only.
    write_whole(path, save({name: value.contiguous() for name, value in tensors.items()}, metadata))


def read_model(path: str | Path) -> Parts:
    """Read a file of ``write_model``, by its path or by the folder of results that contains it.

    Raises:
        InputError: there is no such file, or it is not a model of torchrbd.
    """
    path = Path(path) / NAME if Path(path).is_dir() else Path(path)
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        raise InputError(
            f"{path}: cannot be read as a model ({error}); give the folder that 'torchrbd identify -o' wrote, or its "
            f"{NAME}"
        ) from None
    if metadata.get("format") != _FORMAT:
        found = f" (format '{metadata['format']}', not '{_FORMAT}')" if "format" in metadata else ""
        raise InputError(
            f"{path}: is no model of torchrbd{found}; give the folder that 'torchrbd identify -o' wrote, or its {NAME}"
        )
    try:
        return _parts(metadata, tensors)
    except (KeyError, TypeError, ValueError, RuntimeError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: is damaged ({type(error).__name__}: {error}); write it again with 'torchrbd identify' or "
            "'save_model'"
        ) from None


def _parts(metadata: Mapping[str, str], tensors: dict[str, Tensor]) -> Parts:
    robot = RobotModel.from_urdf(metadata["urdf"].encode(), gravity=json.loads(metadata["gravity"]))
    state = {name: value for name, value in tensors.items() if not name.startswith(_POSTERIOR)}
    terms = [
        Term(effect(t["effect"]), _site(t["site"]), state[f"_terms.{k}.coefficients"], t["shape"])
        for k, t in enumerate(json.loads(metadata["terms"]))
    ]
    pi = state["constant_pi"].clone()
    pi[state["physical"]] += from_log_cholesky(state["raw_inertia"])
    posterior = {name.removeprefix(_POSTERIOR): tensors[name] for name in tensors.keys() - state.keys()}
    conditions, saved, driven = (json.loads(metadata.get(name, "{}")) for name in ("conditions", "reported", "drives"))
    reported = Reported.from_content(saved) if saved else None
    drives = Drives.from_content(driven) if driven else None
    bodies = pi.flatten().to(torch.float64)
    return Parts(robot, bodies, terms, state, posterior, from_content(conditions), reported, drives)


def _site(content: dict[str, Any]) -> Site:
    window, recordings = content.pop("window"), content.pop("recordings", None)
    return Site(
        **content,
        window=None if window is None else Window(**window),
        recordings=None if recordings is None else tuple(recordings),
    )
