"""What held-out torque says of a model that it has helped to choose, beside torque that nobody has seen.

    TORCHRBD_DATA=/path/to/recordings python examples/unseen_recordings.py

What held-out time does not show is set apart, and what it contradicts leaves the model, so that errors there are too
small. Each robot is diagnosed twice: one of two recordings is held out, the other is not given at all, and in turns;
each is told by both models, by one that it has judged and by one that it has not, so that it does not matter which of
them moves in an easier way. The Panda has one recording: what it moves in its last seconds is not given.

``real_recordings.py`` says where the recordings come from.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import real_recordings as real
from real_robots import print_table

import torchrbd
from torchrbd import Diagnosis

PANDA_S = 15.0


def unseen_nmse(diagnosis: Diagnosis, recording: Path, **options) -> float:
    """Return the part of the torque variance of a recording that a model leaves, mean over joints."""
    data = torchrbd.residual_dataset(diagnosis, [recording], **options)
    error, torque = data.residual.double().numpy(), data.measured.double().numpy()
    return float(np.mean(np.mean(error**2, axis=0) / np.var(torque, axis=0)))


def held_out_nmse(diagnosis: Diagnosis) -> float:
    """Return the same of held-out time, all samples counting alike."""
    series = diagnosis.identification.series
    error, torque = series.residual("extended")[series.held_out], series.measured[series.held_out]
    return float(np.mean(np.mean(error**2, axis=0) / np.var(torque, axis=0)))


def in_turns(urdf: Path, fitted: Sequence[Path], pair: Sequence[Path], **options) -> list[list[str]]:
    """Return rows of a table: each of two recordings, as it judges a model and as it tells one that it has not."""
    models = [torchrbd.diagnose(urdf, fitted, holdout=[judge], **options) for judge in pair]
    names = "/".join((urdf.parent.name, urdf.stem))
    return [
        [names, judge.name, f"{held_out_nmse(own):.4f}", f"{unseen_nmse(other, judge):.4f}"]
        for judge, own, other in zip(pair, models, models[::-1], strict=True)
    ]


def main() -> int:
    """Print the table."""
    folder = real.data_folder()
    if folder is None:
        print("set TORCHRBD_DATA to the folder of recordings", file=sys.stderr)
        return 2
    panda, arm = folder / "panda", folder / "kuka_kr300"
    recording, rows = panda / "exciting_traj.csv", []
    result = torchrbd.diagnose(panda / "robot.urdf", [recording], time=(0.0, PANDA_S))
    end = float(real.table(recording)[1][-1, 0])
    unseen = unseen_nmse(result, recording, time=(PANDA_S, end))
    rows.append(["panda/robot", f"blocks; from {PANDA_S:g} s on", f"{held_out_nmse(result):.4f}", f"{unseen:.4f}"])
    rows += in_turns(arm / "robot.urdf", [arm / "A.csv"], [arm / "B.csv", arm / "C.csv"])
    recordings, cutoff = real.recordings_of(folder, "A"), real.PENDULUM_CUTOFF_HZ
    urdf = folder / "dfki_double_pendulum" / "robot_A.urdf"
    rows += in_turns(urdf, recordings[:-2], recordings[-2:], cutoff_hz=cutoff)
    print_table(["robot", "recording", "nmse where it judges the model", "nmse where it has not"], rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
