"""What held-out torque says of a model that it has helped to choose, beside torque that nobody has seen.

    TORCHRBD_DATA=/path/to/recordings python examples/unseen_recordings.py

What held-out time does not show is set apart, and what it contradicts leaves the model, so that errors there are too
small. Each robot is diagnosed twice: one of two recordings is held out, the other is not given at all, and in turns.
Each of both is told by the model that it has judged and by the one that it has not, in one band.

``real_recordings.py`` says where the recordings come from.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import real_recordings as real
from real_robots import print_table
from rich.console import Console
from rich.progress import track

import torchrbd
from torchrbd import Diagnosis

KUKA_CUTOFF_HZ = 4.5


def left(diagnosis: Diagnosis, recording: Path) -> str:
    """Return the part of the torque variance of a recording that a model leaves, mean over joints."""
    data = torchrbd.residual_dataset(diagnosis, [recording])
    return f"{np.mean(real.nmse(data.residual.double().numpy(), data.measured.double().numpy())):.4f}"


def in_turns(urdf: Path, fitted: Sequence[Path], pair: Sequence[Path], cutoff_hz: float) -> list[list[str]]:
    """Return a row for each of two recordings: as it is told by the model that it judges, and by the other."""
    turns = track(pair, f"{urdf.parent.name}, in turns", console=Console(stderr=True), transient=True)
    models = [torchrbd.diagnose(urdf, fitted, holdout=[judge], cutoff_hz=cutoff_hz) for judge in turns]
    both = zip(pair, models, models[::-1], strict=True)
    return [[urdf.parent.name, judge.name, left(own, judge), left(other, judge)] for judge, own, other in both]


def main() -> int:
    """Print the table."""
    folder = real.data_folder()
    if folder is None:
        print("set TORCHRBD_DATA to the folder of recordings", file=sys.stderr)
        return 2
    arm, pendulum = folder / "kuka_kr300", folder / "dfki_double_pendulum"
    recordings = real.recordings_of(folder, "A")
    rows = [
        *in_turns(arm / "robot.urdf", [arm / "A.csv"], [arm / "B.csv", arm / "C.csv"], KUKA_CUTOFF_HZ),
        *in_turns(pendulum / "robot_A.urdf", recordings[:-2], recordings[-2:], real.PENDULUM_CUTOFF_HZ),
    ]
    print_table(["robot", "recording", "nmse where it judges the model", "nmse where it has not"], rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
