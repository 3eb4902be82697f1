"""The figures of the README that come from real robots; each recording is left out in turn and judged.

    TORCHRBD_DATA=/path/to/recordings python examples/real_recordings.py

TORCHRBD_DATA names a folder with ``kuka_kr300`` and ``dfki_double_pendulum``: robot URDFs and recordings as CSV with
the columns ``t, q_<joint>, tau_<joint>``, from github.com/JonasWeigand/Robot_Identification (MIT) and
github.com/dfki-ric-underactuated-lab/double_pendulum (BSD-3-Clause).
"""

from __future__ import annotations

import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

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
        return np.mean(np.concatenate(errors) ** 2, axis=0) / np.var(np.concatenate(torques), axis=0)


def left_out_in_turn(urdf: str | Path, recordings: list[Path], **options) -> LeftOut:
    """Diagnose as often as there are recordings, each time with one of them held out."""
    return LeftOut(
        {
            judged.name: torchrbd.diagnose(urdf, [r for r in recordings if r != judged], holdout=[judged], **options)
            for judged in recordings
        }
    )


def kuka(folder: Path) -> LeftOut:
    """Diagnose the KUKA KR300, its URDF as published: no friction, no counterbalance."""
    arm = folder / "kuka_kr300"
    return left_out_in_turn(arm / "robot.urdf", [arm / f"{name}.csv" for name in "ABC"])


def double_pendulum(folder: Path, design: str) -> LeftOut:
    """Diagnose recordings of the double pendulum of design A.

    Args:
        folder: of the recordings.
        design: "A" starts from the right link lengths and wrong inertials (masses times 0.6, centres of mass times
            1.5); "C" from the URDF of another pendulum, whose links have other lengths.
    """
    pendulum = folder / "dfki_double_pendulum"
    recordings = sorted(p for p in pendulum.glob("A_20220812_*.csv") if "compensated" not in p.name)
    urdf = (pendulum / f"robot_{design}.urdf").read_text()
    return left_out_in_turn(spoiled(urdf) if design == "A" else urdf, recordings, cutoff_hz=PENDULUM_CUTOFF_HZ)


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


def show(title: str, result: LeftOut, out: Console) -> None:
    """Print errors, findings and what is left unexplained."""
    first = next(iter(result.diagnoses.values())).identification
    table = Table(
        "model", *first.series.joints, "mean", title=f"{title}: held-out nmse, up to {first.cutoff_hz:.3g} Hz"
    )
    for model in ("urdf", "rigid_body", "extended"):
        nmse = result.nmse(model)
        table.add_row(model.replace("_", " "), *(f"{v:.3f}" for v in nmse), f"{nmse.mean():.4f}")
    out.print(table)
    for name, diagnosis in result.diagnoses.items():
        out.print(f"{name} held out ({diagnosis.verdict}): {diagnosis.statement}", markup=False)


def main() -> int:
    """Print everything."""
    out = Console(width=120, highlight=False)
    folder = data_folder()
    if folder is None:
        out.print("Set TORCHRBD_DATA to the folder of the recordings; see the head of this file for their sources.")
        return 2
    show("KUKA KR300", kuka(folder), out)
    for design, words in (("A", "right lengths, wrong inertials"), ("C", "wrong lengths")):
        result = double_pendulum(folder, design)
        show(f"Double pendulum, URDF with {words}", result, out)
        moments = [first_moments(d, LINK_LENGTH[design]) for d in result.diagnoses.values()]
        for name, published in PUBLISHED_FIRST_MOMENTS.items():
            values = [m[name] for m in moments]
            out.print(f"first moment, {name}: {min(values):.3f} to {max(values):.3f} kg m, published {published:.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
