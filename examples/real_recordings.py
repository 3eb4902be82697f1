"""Recordings of real robots, and diagnoses of them with each recording left out in turn.

The environment variable TORCHRBD_DATA names a folder with ``kuka_kr300``, ``dfki_double_pendulum`` and
``dfki_pendulum``: robot URDFs and recordings as CSV with the columns ``t, q_<joint>, tau_<joint>``, from
github.com/JonasWeigand/Robot_Identification (MIT), github.com/dfki-ric-underactuated-lab/double_pendulum and
.../torque_limited_simple_pendulum (BSD-3-Clause). The URDFs are written from the numbers that these publish; columns
are renamed, units made SI, the KR300's motor torques multiplied by the gear ratios. Files: ``robot.urdf``, ``A.csv`` to
``C.csv`` and ``link_encoder_A.csv`` to ``_C.csv`` of the KR300; ``robot_A.urdf``, ``robot_C.urdf``, ``A_*.csv`` and
``C_*.csv`` of the double pendulum's two designs; ``robot.urdf`` and a file for each controller of
the pendulum.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.interpolate import CubicSpline

import torchrbd
from torchrbd import Diagnosis

PUBLISHED_FIRST_MOMENTS = {"stretched arm about the shoulder": 0.460, "forearm about the elbow": 0.111}
PENDULUM_CUTOFF_HZ = 8.0
LINK_LENGTH = {"A": 0.3, "C": 0.2}


def data_folder() -> Path | None:
    """Return the folder of real recordings, if the environment names one that exists."""
    folder = os.environ.get("TORCHRBD_DATA")
    return Path(folder) if folder and Path(folder).is_dir() else None


@dataclass(frozen=True)
class LeftOut:
    """Diagnoses with each recording left out in turn, by the name of the recording."""

    diagnoses: dict[str, Diagnosis]

    def nmse(self, model: str) -> np.ndarray:
        """Return per joint squared error over variance of the torque, both pooled over all recordings left out."""
        errors, torques = [], []
        for diagnosis in self.diagnoses.values():
            series = diagnosis.identification.series
            errors.append(series.residual(model)[series.held_out])
            torques.append(series.measured[series.held_out])
        return nmse(np.concatenate(errors), np.concatenate(torques))


def nmse(errors: np.ndarray, torques: np.ndarray) -> np.ndarray:
    """Return per joint squared error over variance of the torque, of (N, n) each."""
    return np.mean(errors**2, axis=0) / np.var(torques, axis=0)


def left_out_in_turn(urdf: str | Path, recordings: Sequence[Path], **options) -> LeftOut:
    """Diagnose as often as there are recordings, each time with one of them held out."""
    return LeftOut(
        {
            judged.name: torchrbd.diagnose(urdf, [r for r in recordings if r != judged], holdout=[judged], **options)
            for judged in track(recordings, "each left out in turn", console=Console(stderr=True), transient=True)
        }
    )


def kuka(folder: Path) -> LeftOut:
    """Diagnose the KUKA KR300, its URDF as published: no friction, no counterbalance."""
    arm = folder / "kuka_kr300"
    with tempfile.TemporaryDirectory() as into:
        return left_out_in_turn(arm / "robot.urdf", with_link_encoders(arm, Path(into)))


def with_link_encoders(arm: Path, into: Path) -> list[Path]:
    """Write the KR300's recordings with the encoders behind its gears, which lie in files of their own, beside."""
    written = []
    for name in "ABC":
        (columns, rows), (more, link) = (table(arm / f"{kind}{name}.csv") for kind in ("", "link_encoder_"))
        both = np.column_stack((rows, CubicSpline(link[:, 0], link[:, 1:])(rows[:, 0])))
        written.append(into / f"{name}.csv")
        np.savetxt(written[-1], both, "%.10g", ",", header=",".join((*columns, *more[1:])), comments="")
    return written


def table(path: Path) -> tuple[list[str], np.ndarray]:
    """Return the columns' names and the rows of a CSV file."""
    with path.open() as stream:
        columns = stream.readline().strip().split(",")
    return columns, np.loadtxt(path, delimiter=",", skiprows=1)


def slopes_on_torque(arm: Path) -> dict[str, tuple[float, float]]:
    """Return the least and largest torque over encoder difference [N m/rad] of three recordings, with nothing else."""
    found: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as into:
        for path in with_link_encoders(arm, Path(into)):
            columns, rows = table(path)
            of = dict(zip(columns, rows.T, strict=True))
            for joint in (name.removeprefix("q_link_") for name in columns if name.startswith("q_link_")):
                tau, e = of[f"tau_{joint}"], of[f"q_{joint}"] - of[f"q_link_{joint}"]
                found.setdefault(joint, []).append(float(np.var(tau) / np.cov(tau, e, bias=True)[0, 1]))
    return {joint: (min(values), max(values)) for joint, values in found.items()}


def recordings_of(folder: Path, design: str) -> list[Path]:
    """Return recordings of the double pendulum of one design, those with friction compensation left out."""
    pattern = "A_20220812_*.csv" if design == "A" else "C_20220914_??.csv"
    return sorted(p for p in (folder / "dfki_double_pendulum").glob(pattern) if "compensated" not in p.name)


def double_pendulum(folder: Path, design: str) -> LeftOut:
    """Diagnose recordings of the double pendulum of design A.

    Args:
        folder: of the recordings.
        design: "A" starts from the right link lengths and wrong inertials (masses times 0.6, centres of mass times
            1.5); "C" from the URDF of another pendulum, whose links have other lengths.
    """
    urdf = (folder / "dfki_double_pendulum" / f"robot_{design}.urdf").read_text()
    start = spoiled(urdf) if design == "A" else urdf
    return left_out_in_turn(start, recordings_of(folder, "A"), cutoff_hz=PENDULUM_CUTOFF_HZ)


def spoiled(urdf: str) -> str:
    """Multiply the masses of the double pendulum's URDF by 0.6 and its centres of mass by 1.5."""
    urdf = re.sub(r'(<mass value=")([^"]+)', lambda m: f"{m[1]}{0.6 * float(m[2])}", urdf)
    return re.sub(r'(<inertial><origin xyz="0 0 )([^"]+)', lambda m: f"{m[1]}{1.5 * float(m[2])}", urdf)


def first_moments(diagnosis: Diagnosis, link_length: float) -> dict[str, float]:
    """Return the double pendulum's first moments [kg m]: what gravity acts on, the arm stretched out."""
    value = {p.name: p.value for p in diagnosis.identification.parameters}
    forearm = abs(value["mcz_lower"])
    arm = abs(value["mcz_upper"]) + link_length * value["m_lower"] + forearm
    return dict(zip(PUBLISHED_FIRST_MOMENTS, (arm, forearm), strict=True))
