"""What ``identify -o`` and ``diagnose -o`` wrote, as the parts of an ``Identification``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from torchrbd._runtime.rebuilding import Unsaved, read_json, rebuilt
from torchrbd.errors import InputError
from torchrbd.model import RigidBodyDynamics

_FILE = "parameters.json"
# Parts under other keys than their own names.
_KEYS = {
    "fits": "fit", "base": "base_parameters", "regime": "position_noise", "combinations": "combination_remarks",
}  # fmt: skip
_PLAIN = (
    "recordings", "held_out", "cutoff_hz", "fits", "verdict", "parameters", "combinations", "base", "noise",
    "regime", "remarks", "facts", "simulation", "closed_loop", "gains",
)  # fmt: skip


class UnsavedSeries(Unsaved):
    """Torques against time, which the files do not hold; names of joints and recordings are known."""

    def __init__(self, place: Path, joints: tuple[str, ...], recordings: tuple[str, ...]) -> None:
        super().__init__(place, "torques against time", "identify or diagnose the recordings again")
        self.joints, self.recordings = joints, recordings


def read_identification(kind: type, folder: str | Path) -> dict[str, Any]:
    """Return the parts of an identification that files hold, by name.

    Args:
        kind: the dataclass whose parts these are.
        folder: that ``identify -o`` or ``diagnose -o`` wrote.

    Raises:
        InputError: a file is missing, or none of ours.
    """
    folder = Path(folder)
    content, model = read_json(folder / _FILE, "identify"), RigidBodyDynamics.load(folder)
    types = get_type_hints(kind)
    try:
        found = {name: rebuilt(types[name], content[_KEYS.get(name, name)]) for name in _PLAIN}
        joints = tuple(map(str, content["joints"]))
        covariance, matrix = content["base_covariance"], content["base_combination"]["matrix"]
        columns = len(content["base_combination"]["columns"])
        found |= {
            "base_combination": np.array(matrix, dtype=float).reshape(len(found["base"]), columns),
            "base_covariance": None if covariance is None else np.array(covariance, dtype=float),
            "suspicions": rebuilt(
                types["suspicions"], {"found": content["suspicions"], "tested": content["suspicions_tested"]}
            ),
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{folder / _FILE}: is no {_FILE} as this version of torchrbd writes it ({type(error).__name__}: {error}); "
            "identify the recordings again"
        ) from None
    series = UnsavedSeries(folder, joints, found["recordings"])
    return found | {
        "robot": model.robot, "model": model, "series": series, "covariance": None, "posterior": None,
    }  # fmt: skip
