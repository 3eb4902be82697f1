"""The real recordings as cases: robot, recordings to fit, recordings held out, options."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from lxml import etree


@dataclass(frozen=True)
class Case:
    """What a call of ``identify`` or ``diagnose`` gets."""

    robot: Path
    recordings: list[Path]
    holdout: list[Path] = field(default_factory=list)
    options: Mapping[str, Any] = field(default_factory=dict)


def data_folder() -> Path | None:
    """Return the folder of real recordings, if there is one."""
    given = os.environ.get("TORCHRBD_DATA")
    return Path(given) if given and Path(given).is_dir() else None


def emps(data: Path, _: Path) -> Case:
    own = data / "emps"
    return Case(own / "robot.urdf", [own / "train.csv"], [own / "pulses.csv"], {"cutoff_hz": 20.0})


def kuka(data: Path, _: Path) -> Case:
    own = data / "kuka_kr300"
    return Case(own / "robot.urdf", [own / "A.csv", own / "B.csv"], [own / "C.csv"])


def panda(data: Path, _: Path) -> Case:
    own = data / "panda"
    return Case(own / "robot.urdf", [own / "exciting_traj.csv"], options={"holdout_fraction": 0.5})


def ur10(data: Path, _: Path) -> Case:
    own = data / "ur10"
    return Case(own / "robot.urdf", [own / "fit.csv"], [own / "holdout.csv"])


def pendulum(data: Path, _: Path) -> Case:
    own = data / "dfki_pendulum"
    names = ("ddp.csv", "ilqr.csv", "pd_system_identification.csv")
    return Case(own / "robot.urdf", [own / name for name in names], [own / "energy_shaping.csv"])


def double_pendulum(data: Path, _: Path) -> Case:
    own = data / "dfki_double_pendulum"
    names = ("055032", "055640", "055903", "060143", "060440")
    files = [own / f"A_20220812_{name}.csv" for name in names]
    return Case(own / "robot_A.urdf", files[:-1], files[-1:], {"cutoff_hz": 5.0})


def z1(data: Path, into: Path) -> Case:
    gains = [80.0, 120.0, *[80.0] * 5]
    joints = [*(f"joint{k}" for k in range(1, 7)), "jointGripper"]
    files = [_driven(data / "z1" / f"{name}.csv", into, joints, gains, 2.5) for name in ("train", "test")]
    return Case(data / "z1" / "robot.xml", files[:1], files[1:])


def go2_leg(data: Path, into: Path) -> Case:
    """One leg, its torque made from the set-points by the gains of the drives."""
    joints = [f"FL_{part}_joint" for part in ("hip", "thigh", "calf")]
    files = [_driven(data / "go2" / f"{name}.csv", into, joints, [20.0] * 3, 1.5) for name in ("train", "test")]
    robot = into / "leg.urdf"
    robot.write_bytes(_only_leg((data / "go2" / "robot.urdf").read_bytes(), "FL"))
    return Case(robot, files[:1], files[1:])


CASES: dict[str, Callable[[Path, Path], Case]] = {
    "emps": emps,
    "kuka": kuka,
    "panda": panda,
    "ur10": ur10,
    "pendulum": pendulum,
    "double_pendulum": double_pendulum,
    "z1": z1,
    "go2_leg": go2_leg,
}


def _driven(file: Path, into: Path, joints: list[str], kp: list[float], kd: float) -> Path:
    """Write a recording of some joints with tau = kp (q_ref - q) - kd qd."""
    table = pd.read_csv(file)
    found = {"t": table["t"]}
    for joint, stiffness in zip(joints, kp, strict=True):
        q = table[f"q_{joint}"]
        qd = table.get(f"qd_{joint}", pd.Series(np.gradient(q, table["t"])))
        found |= {f"q_{joint}": q, f"qd_{joint}": qd}
        found[f"tau_{joint}"] = stiffness * (table[f"q_ref_{joint}"] - q) - kd * qd
    into.mkdir(exist_ok=True)
    pd.DataFrame(found).to_csv(into / file.name, index=False)
    return into / file.name


def _only_leg(urdf: bytes, leg: str) -> bytes:
    """Return a robot whose other legs are gone."""
    root = etree.fromstring(urdf)
    gone = {f"{other}_" for other in ("FL", "FR", "RL", "RR") if other != leg}
    for element in [*root.findall("link"), *root.findall("joint")]:
        if any(str(element.get("name")).startswith(prefix) for prefix in gone):
            root.remove(element)
    return etree.tostring(root)
