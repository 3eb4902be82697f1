"""How well real robots are predicted: the URDF, plain least squares, the re-fitted rigid body and the extended model.

    TORCHRBD_DATA=/path/to/recordings python benchmarks/against_least_squares.py emps panda ur10 kuka_kr300

Writes ``benchmarks/results/real_robots.json``; the sets that are not named keep their figures. All four models are
judged on the same held-out rows, and every row counts alike (rows near rest too).

*Baseline* is ordinary least squares with Pinocchio's regressor and numpy: inertial parameters of all links in the
minimum-norm sense (which predicts as base parameters do), viscous friction, Coulomb friction and an offset at each
joint. It shares no code with torchrbd. Torque and all its columns pass one zero-phase low-pass.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import results_file
from scipy import signal

import torchrbd
from torchrbd import Diagnosis

# Columns whose singular value is below this share of the largest are combinations that no motion of the robot shows.
RANK_TOLERANCE = 1e-8
# States are differentiated in a band this many times as wide as the band of the torque.
STATE_BAND = 4.0


@dataclass(frozen=True)
class RealSet:
    """One robot: what it is, which recordings are fitted, which are held out (none: blocks of time are)."""

    robot: str
    torque: str
    fitted: tuple[str, ...]
    held_out: tuple[str, ...] = ()
    cutoff_hz: float | None = None
    urdf: str = "robot.urdf"


SETS = {
    "emps": RealSet("EMPS, one slide", "drive voltage × gain", ("train.csv",), ("pulses.csv",), 20.0),
    "panda": RealSet("Franka Panda, 7 joints", "link-side torque sensors", ("exciting_traj.csv",)),
    "ur10": RealSet("UR10, 6 joints", "motor currents", ("fit.csv",), ("holdout.csv",)),
    "kuka_kr300": RealSet("KUKA KR300, 6 joints", "motor torque × gear ratio", ("A.csv", "B.csv"), ("C.csv",)),
    "dfki_double_pendulum": RealSet("Double pendulum, 2 joints", "reported by the motor", (), (), 8.0, "robot_A.urdf"),
}


def recordings_of(name: str, folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the recordings that are fitted and those that are held out."""
    chosen = SETS[name]
    if name == "dfki_double_pendulum":  # nine recordings, the last two held out; one more has friction compensation
        found = sorted(p for p in folder.glob("A_20220812_*.csv") if "compensated" not in p.name)
        return found[:-2], found[-2:]
    return [folder / f for f in chosen.fitted], [folder / f for f in chosen.held_out]


def table(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a CSV file."""
    with path.open(encoding="utf-8") as stream:
        columns = stream.readline().strip().split(",")
    return dict(zip(columns, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


class Recorded:
    """One recording on an even clock, with band-limited torque and regressor.

    Attributes:
        t: (N,) seconds from the start of the recording.
        tau: (N, n) torque; W: (N, n, p) its columns; both passed the same low-pass.
    """

    def __init__(self, path: Path, urdf: Path, joints: Sequence[str], cutoff_hz: float):
        import pinocchio as pin

        of = table(path)
        t = of["t"] - of["t"][0]
        dt = float(np.median(np.diff(t)))
        self.t = np.arange(0.0, t[-1], dt)
        even = {k: np.interp(self.t, t, v) for k, v in of.items()}
        q = np.stack([even[f"q_{j}"] for j in joints], axis=1)
        tau = np.stack([even[f"tau_{j}"] for j in joints], axis=1)
        wide = min(STATE_BAND * cutoff_hz, 0.45 / dt)
        q = lowpass(q, wide, dt)
        qd = np.gradient(q, dt, axis=0)
        qdd = np.gradient(qd, dt, axis=0)
        model = pin.buildModelFromUrdf(str(urdf))
        order = [model.joints[model.getJointId(j)].idx_v for j in joints]
        data = model.createData()
        body = np.empty((len(q), len(joints), 10 * (model.njoints - 1)))
        state = np.zeros((3, model.nv))
        for k in range(len(q)):
            state[:, order] = q[k], qd[k], qdd[k]
            turned = pin.integrate(model, pin.neutral(model), state[0])  # cosine and sine of continuous joints
            body[k] = pin.computeJointTorqueRegressor(model, data, turned, *state[1:])[order]
        self.tau = lowpass(tau, cutoff_hz, dt)
        self.W = lowpass(np.concatenate((body, friction(qd)), axis=2), cutoff_hz, dt)

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return torque (M, n) and its columns (M, n, p) at the samples nearest to some times [s]."""
        k = np.clip(np.rint(t / (self.t[1] - self.t[0])).astype(int), 0, len(self.t) - 1)
        return self.tau[k], self.W[k]


def lowpass(x: np.ndarray, cutoff_hz: float, dt: float) -> np.ndarray:
    """Return x (N, ...), passed forwards and backwards through a Butterworth filter."""
    sos = signal.butter(4, cutoff_hz * 2 * dt, output="sos")
    return signal.sosfiltfilt(sos, x, axis=0)


def friction(qd: np.ndarray) -> np.ndarray:
    """Return columns of viscous friction, Coulomb friction and an offset for each joint, (N, n, 3 n)."""
    N, n = qd.shape
    columns = np.zeros((N, n, 3 * n))
    for j in range(n):
        columns[:, j, 3 * j : 3 * j + 3] = np.stack((qd[:, j], np.sign(qd[:, j]), np.ones(N)), axis=1)
    return columns


def baseline(diagnosis: Diagnosis, urdf: Path, paths: Sequence[Path]) -> np.ndarray:
    """Return the nmse per joint of least squares, fitted and judged on the rows of a diagnosis."""
    series = diagnosis.identification.series
    parts = []
    for k, name in enumerate(series.recordings):
        (path,) = (p for p in paths if p.name == name)
        recorded = Recorded(path, urdf, series.joints, diagnosis.identification.cutoff_hz)
        rows = series.recording == k
        parts.append((*recorded.at(series.t[rows]), series.held_out[rows]))
    tau, W, held_out = (np.concatenate(x) for x in zip(*parts, strict=True))
    x = weighted(W[~held_out], tau[~held_out])
    error = tau[held_out] - W[held_out] @ x
    return nmse(error, tau[held_out])


def weighted(W: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Return least squares of W (M, n, p) and tau (M, n) with each joint weighted by its own residual, (p,)."""
    noise = np.ones(tau.shape[1])
    for _ in range(3):
        x = least_squares(W / noise[:, None], tau / noise)
        noise = np.std(tau - W @ x, axis=0)
    return x


def least_squares(W: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Return the minimum-norm solution of W x = tau, columns scaled to unit length, (p,)."""
    A = W.reshape(-1, W.shape[-1])
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0.0] = 1.0
    return np.linalg.lstsq(A / scale, tau.reshape(-1), rcond=RANK_TOLERANCE)[0] / scale


def nmse(error: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Return the mean squared error over the variance of the torque, per joint; (M, n) each."""
    return np.mean(error**2, axis=0) / np.var(tau, axis=0)


def measure(name: str, data: Path) -> dict:
    """Diagnose one set and return its figures."""
    chosen, folder = SETS[name], data / name
    fitted, held_out = recordings_of(name, folder)
    urdf = folder / chosen.urdf
    options = {"cutoff_hz": chosen.cutoff_hz} if chosen.cutoff_hz else {}
    if held_out:
        options["holdout"] = held_out
    start = time.process_time()
    diagnosis = torchrbd.diagnose(urdf, fitted, **options)
    seconds = time.process_time() - start
    series = diagnosis.identification.series
    rows = series.held_out
    judged = {
        model: nmse(series.residual(model)[rows], series.measured[rows]) for model in ("urdf", "rigid_body", "extended")
    }
    judged["baseline"] = baseline(diagnosis, urdf, [*fitted, *held_out])
    return {
        "robot": chosen.robot,
        "torque": chosen.torque,
        "fitted": [p.name for p in fitted],
        "held_out": [p.name for p in held_out] or "blocks of time",
        "cutoff_hz": round(diagnosis.identification.cutoff_hz, 2),
        "rows_held_out": int(rows.sum()),
        "nmse": {m: {j: float(f"{v:.4g}") for j, v in zip(series.joints, x, strict=True)} for m, x in judged.items()},
        "verdict": diagnosis.verdict,
        "findings": [
            {
                "effect": f.effect,
                "joints": list(f.joints),
                "links": list(f.links),
                "probability": round(float(f.probability), 3),
            }
            for f in diagnosis.findings
        ],
        "processor_seconds": round(seconds, 1),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the sets named; exit code 2 where there are no recordings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="+", choices=SETS)
    chosen = parser.parse_args(arguments).sets
    folder = os.environ.get("TORCHRBD_DATA")
    if folder is None or not Path(folder).is_dir():
        print("set TORCHRBD_DATA to the folder of recordings", file=sys.stderr)
        return 2
    for name in chosen:
        results_file.update(
            "real_robots", f"python benchmarks/against_least_squares.py {name}", {name: measure(name, Path(folder))}
        )
        print(f"{name}: done")
    return 0


if __name__ == "__main__":
    sys.exit(main())
