"""A model as one safetensors file: numbers as tensors, URDF and terms as metadata. Nothing in it can run code."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from lxml import etree
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from torchrbd.errors import InputError, RobotError
from torchrbd.model import RigidBodyDynamics
from torchrbd.parameters import from_log_cholesky
from torchrbd.physics import Site, Term, Window, effect
from torchrbd.robot import RobotModel

_FORMAT = "torchrbd-model-2"


def save_model(model: RigidBodyDynamics, path: str | Path) -> None:
    """Write a model to a safetensors file.

    Raises:
        RobotError: the robot was not made from a URDF.
    """
    if model.robot.urdf is None:
        raise RobotError(f"robot '{model.robot.name}' was not made from a URDF, which the file would have to hold")
    terms = [{"effect": t.effect.id, "site": asdict(t.site), "shape": t.shape} for t in model.terms]
    metadata = {
        "format": _FORMAT,
        "urdf": etree.tostring(etree.fromstring(model.robot.urdf), encoding="unicode"),
        "gravity": json.dumps(model.robot.gravity.tolist()),
        "terms": json.dumps(terms),
    }
    save_file({name: value.contiguous() for name, value in model.state_dict().items()}, path, metadata)


def load_model(path: str | Path) -> RigidBodyDynamics:
    """Read a model that ``save_model`` wrote.

    Raises:
        InputError: no such file, or none of ours.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path}: cannot be read as a model ({error})") from None
    if metadata.get("format") != _FORMAT:
        raise InputError(
            f"{path}: is no model of torchrbd; expected format '{_FORMAT}', got '{metadata.get('format')}'"
        )
    robot = RobotModel.from_urdf(metadata["urdf"].encode(), gravity=json.loads(metadata["gravity"]))
    terms = [
        Term(effect(t["effect"]), _site(t["site"]), state[f"_terms.{k}.coefficients"], t["shape"])
        for k, t in enumerate(json.loads(metadata["terms"]))
    ]
    pi = state["constant_pi"].clone()
    pi[state["physical"]] += from_log_cholesky(state["raw_inertia"])
    model = RigidBodyDynamics(robot, pi.flatten().to(torch.float64), terms)
    model.load_state_dict(state)
    return model


def _site(content: dict[str, Any]) -> Site:
    window, recordings = content.pop("window"), content.pop("recordings", None)
    return Site(
        **content,
        window=None if window is None else Window(**window),
        recordings=None if recordings is None else tuple(recordings),
    )
