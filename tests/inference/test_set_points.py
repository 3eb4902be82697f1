"""Set-points that mean something else than they say are suspected, with the mapping that corrects them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import yaml
from likelihood.arms import arm_urdf, driven_columns
from simulated import joint_names

import torchrbd

URDF = arm_urdf(0, 2)
KP, KD = np.array([600.0, 250.0]), np.array([2.0, 0.8])
Columns = dict[str, np.ndarray]
FIRST, LAST = (f"q_ref_{name}" for name in joint_names(URDF))


def degrees(x: Columns) -> Columns:
    return x | {key: np.degrees(x[key]) for key in (FIRST, LAST)}


def swapped(x: Columns) -> Columns:
    return x | {FIRST: x[LAST], LAST: x[FIRST]}


def turned(x: Columns) -> Columns:
    return x | {LAST: -x[LAST]}


def diagnosed(tmp_path, change: Callable[[Columns], Columns], extra: str = "") -> torchrbd.Identification:
    columns = driven_columns(URDF, 2, lambda m: 0.3 * m.qd, KP, KD, duration_s=20.0, rate_hz=100.0)
    names = joint_names(URDF)
    drives = {n: {"drive": {"kp": float(p), "kd": float(d)}} for n, p, d in zip(names, KP, KD, strict=True)}
    more = yaml.safe_load(extra)["joints"] if extra else {}
    joints = {name: drives[name] | more.get(name, {}) for name in names}
    every = {name: one for name, one in more.items() if name not in joints}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump({"joints": joints | every}))
    return torchrbd.identify(URDF, change(columns), mapping=tmp_path / "map.yaml")


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        (degrees, "set-points in degrees", "all joints follow set-points in degrees"),
        (swapped, "swapped set-points", "joint1 and joint2 follow each other's set-points"),
        (turned, "set-points of the opposite sign", "joint2 follows set-points of the opposite sign"),
    ],
)
def test_what_they_mean_is_suspected_and_corrected(tmp_path, change, kind, words):
    found = diagnosed(tmp_path, change)
    assert found.verdict == "suspect"
    (one,) = found.suspicions.found
    assert one.kind == kind
    assert words in one.words
    assert one.times > 2
    again = diagnosed(tmp_path, change, yaml.safe_dump(one.mapping))
    assert not again.suspicions.found
    assert max(again.fits["extended"].nmse.values()) < 1e-3


def test_set_points_that_are_followed_are_not_suspected(tmp_path):
    assert not diagnosed(tmp_path, lambda x: x).suspicions.found
