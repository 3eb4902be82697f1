"""Read what ``identify`` has left of the robots of a fleet."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from torchrbd.comparison.reading import PARAMETERS, read_inertia
from torchrbd.diagnosis.results import Quantity
from torchrbd.errors import InputError
from torchrbd.fleet.results import Member


def read_member(folder: Path, name: str) -> Member:
    """Read what ``identify`` has left of one robot.

    Raises:
        InputError: no such file, none of ours, or one without intervals.
    """
    file = folder / PARAMETERS
    inertia, bodies = read_inertia(file)
    if inertia is None:
        raise InputError(f"{file}: is missing or has no intervals, which a comparison needs; identify '{name}' again")
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        terms = {
            str(p["name"]): Quantity(_number(p["value"]), _number(p["std"]), str(p["unit"]))
            for p in content["parameters"]
            if p["status"] == "term"
        }
        errors = [_number(value) for value in list(content["fit"].values())[-1]["nmse"].values()]
        known = [value for value in errors if math.isfinite(value)]
        words = str(content["robot"]), str(content["verdict"])
        doubts = tuple(map(str, content.get("doubts", ())))
        if not all(np.isfinite(x).all() for x in (inertia.pi, inertia.beta, inertia.covariance)):
            raise ValueError("inertial parameters that are not finite")
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(
            f"{file}: is no parameters.json as 'torchrbd fleet' writes it ({type(error).__name__}: {error}); remove "
            f"the folder and identify '{name}' again"
        ) from None
    nmse = sum(known) / len(known) if known else math.nan
    return Member(name, *words, nmse, inertia, bodies, terms, doubts)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
