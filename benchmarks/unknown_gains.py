"""Robots whose gains are withheld: how far estimates are from the gains that the drives had.

    TORCHRBD_DATA=/path/to/recordings python benchmarks/unknown_gains.py

The drives of a Unitree Z1 and of a Go2 are known. Here their stiffness is left to the data: the scale is that of the
URDF's bodies, at the default weight and at one that takes each link's scale to be known to 10 %. The gains of the
SO-101 are not known: what is estimated is listed.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import results_file

import torchrbd

# Damping and stiffness of the drives, by joint of the Z1.
DAMPING = {"z1": 2.5, "go2": 1.5}
Z1 = {f"joint{k}": 120.0 if k in (2, 3) else 80.0 for k in range(1, 7)} | {"jointGripper": 80.0}
# Weight of the URDF; the scale of a link has the standard deviation 1 / (2 sqrt(kappa)).
KAPPAS = {"default": 3.0, "links to 10 %": 25.0}


def main() -> None:
    data, rows = Path(os.environ["TORCHRBD_DATA"]), {}
    for robot, damping in DAMPING.items():
        folder = data / robot
        for name, kappa in KAPPAS.items():
            gains = estimated(folder / "robot.xml", [folder / "train.csv"], folder / "test.csv", kappa, damping)
            rows[f"{robot}: {name}"] = compared(gains, lambda joint, robot=robot: Z1[joint] if robot == "z1" else 20.0)
            print(*rows.items(), sep="\n")
    folder = data / "so101"
    recordings = sorted(folder.glob("*.csv"))
    held_out = folder / "large_amplitude.csv"
    recordings.remove(held_out)
    gains = estimated(folder / "robot.urdf", recordings, held_out, KAPPAS["default"], 0.0)
    rows["so101: default"] = {"joints": {g.joint: [round(x, 2) for x in (g.value, g.low, g.high)] for g in gains}}
    results_file.update("unknown_gains", "python benchmarks/unknown_gains.py", rows)


def estimated(
    robot: Path, recordings: list[Path], held_out: Path, kappa: float, damping: float
) -> tuple[torchrbd.recordings.Gain, ...]:
    """Return the gains of all drives, their stiffness withheld."""
    with TemporaryDirectory() as folder:
        mapping = Path(folder) / "drives.yaml"
        mapping.write_text(f"joints:\n  '*': {{drive: {{kp: estimate, kd: {damping}}}}}\n")
        return torchrbd.identify(robot, recordings, holdout=held_out, mapping=mapping, kappa=kappa).gains


def compared(gains, truth) -> dict[str, object]:
    """Return how many intervals hold the known gain, and how wide they are, as a factor around the middle."""
    inside = [g.low <= truth(g.joint) <= g.high for g in gains]
    return {
        "joints": {g.joint: [round(x, 2) for x in (g.value, g.low, g.high)] for g in gains},
        "inside": sum(inside),
        "of": len(inside),
        "median_factor": round(median(math.sqrt(g.high / g.low) for g in gains), 2),
        "median_ratio": round(median(g.value / truth(g.joint) for g in gains), 2),
    }


if __name__ == "__main__":
    main()
