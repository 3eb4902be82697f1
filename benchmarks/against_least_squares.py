"""How well real robots are predicted: the URDF, plain least squares, the re-fitted rigid body and the extended model.

    TORCHRBD_DATA=/path/to/recordings python benchmarks/against_least_squares.py emps panda ur10 kuka_kr300

Writes ``benchmarks/results/real_robots.json``; the sets that are not named keep their figures. Every part is
held out once: each recording in turn, or each of several parts of equal length. All four models are judged on the same
rows, and every row counts alike (rows near rest too): a figure is the squared error of all parts over their variance.

*Baseline* is ordinary least squares with Pinocchio's regressor and numpy: inertial parameters of all links in the
minimum-norm sense (which predicts as base parameters do), viscous friction, Coulomb friction and an offset at each
joint. It shares no code with torchrbd. Torque and all its columns pass one zero-phase low-pass. Where torchrbd finds
that torques had been filtered, its own least squares, whose columns pass that filter, is the *filtered baseline*.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
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
    """One robot and its recordings.

    Attributes:
        robot, torque: what they are.
        recordings: files.
        together: how many files are held out at once.
        parts: of equal length into which the files, one after the other in time, are cut, and that are held out in
            turn; 0 if files are held out.
        cutoff_hz: chosen from the data if None.
        urdf: file.
    """

    robot: str
    torque: str
    recordings: tuple[str, ...]
    together: int = 1
    parts: int = 0
    cutoff_hz: float | None = None
    urdf: str = "robot.urdf"


PENDULUM = (
    "A_20220812_055032.csv A_20220812_055640.csv A_20220812_055903.csv A_20220812_060143.csv A_20220812_060245.csv "
    "A_20220812_060329.csv A_20220812_060440.csv A_20220812_061157.csv A_20220812_061705.csv"
)
SETS = {
    "emps": RealSet("EMPS, one slide", "drive voltage × gain", ("train.csv", "pulses.csv"), cutoff_hz=20.0),
    "panda": RealSet("Franka Panda, 7 joints", "link-side torque sensors", ("exciting_traj.csv",), parts=4),
    "ur10": RealSet("UR10, 6 joints", "motor currents", ("fit.csv", "holdout.csv"), parts=4),
    "kuka_kr300": RealSet("KUKA KR300, 6 joints", "motor torque × gear ratio", ("A.csv", "B.csv", "C.csv")),
    "dfki_double_pendulum": RealSet(
        "Double pendulum, 2 joints",
        "reported by the motor",
        tuple(PENDULUM.split()),
        together=3,
        cutoff_hz=8.0,
        urdf="robot_A.urdf",
    ),
}


def folds(chosen: RealSet, folder: Path, scratch: Path) -> Iterator[tuple[list[Path], list[Path]]]:
    """Yield the recordings that are fitted and those that are held out, the last ones first."""
    if chosen.parts:
        yield from hold_out_parts([folder / name for name in chosen.recordings], chosen.parts, scratch)
        return
    files = [folder / name for name in chosen.recordings]
    for last in range(len(files), 0, -chosen.together):
        held_out = files[max(last - chosen.together, 0) : last]
        yield [f for f in files if f not in held_out], held_out


def hold_out_parts(files: Sequence[Path], parts: int, scratch: Path) -> Iterator[tuple[list[Path], list[Path]]]:
    """Yield what lies before and behind a part of a recording, and the part; files follow each other in time."""
    head, rows = "", list[str]()
    for file in files:
        head, *more = file.read_text(encoding="utf-8").splitlines(keepends=True)
        rows += [row if row.endswith("\n") else row + "\n" for row in more]
    edges = np.linspace(0, len(rows), parts + 1).astype(int)
    for k in reversed(range(parts)):
        pieces = {
            f"before-{k + 1}of{parts}.csv": rows[: edges[k]],
            f"behind-{k + 1}of{parts}.csv": rows[edges[k + 1] :],
            f"part-{k + 1}of{parts}.csv": rows[edges[k] : edges[k + 1]],
        }
        for name, some in pieces.items():
            (scratch / name).write_text(head + "".join(some), encoding="utf-8")
        *fitted, held_out = [scratch / name for name, some in pieces.items() if some]
        yield fitted, [held_out]


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


def error_of_baseline(diagnosis: Diagnosis, urdf: Path, paths: Sequence[Path]) -> np.ndarray:
    """Return the error of least squares on the held-out rows of a diagnosis, (M, n), fitted to its other rows."""
    series = diagnosis.identification.series
    parts = []
    for k, name in enumerate(series.recordings):
        (path,) = (p for p in paths if p.name == name)
        recorded = Recorded(path, urdf, series.joints, diagnosis.identification.cutoff_hz)
        rows = series.recording == k
        parts.append((*recorded.at(series.t[rows]), series.held_out[rows]))
    tau, W, held_out = (np.concatenate(x) for x in zip(*parts, strict=True))
    x = weighted(W[~held_out], tau[~held_out])
    return tau[held_out] - W[held_out] @ x


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


@dataclass
class Fold:
    """What one fold gave: torque (M, n) and the error (M, n) of each model on the held-out rows, and the diagnosis."""

    tau: np.ndarray
    error: dict[str, np.ndarray]
    diagnosis: Diagnosis
    seconds: float


def run(chosen: RealSet, urdf: Path, fitted: Sequence[Path], held_out: Sequence[Path]) -> Fold:
    """Diagnose the fitted recordings; return the errors on the held-out ones."""
    options = {"cutoff_hz": chosen.cutoff_hz} if chosen.cutoff_hz else {}
    start = time.process_time()
    diagnosis = torchrbd.diagnose(urdf, fitted, holdout=held_out, **options)
    seconds = time.process_time() - start
    series = diagnosis.identification.series
    rows = series.held_out
    error = {model: series.residual(model)[rows] for model in ("urdf", "rigid_body", "extended")}
    error["baseline"] = error_of_baseline(diagnosis, urdf, [*fitted, *held_out])
    if diagnosis.identification.model.reported.low_pass is not None:
        error["filtered_baseline"] = series.residual("baseline")[rows]
    return Fold(series.measured[rows], error, diagnosis, seconds)


def nmse(error: Sequence[np.ndarray], tau: Sequence[np.ndarray]) -> np.ndarray:
    """Return the squared error over the squared deviation from the mean, summed over folds, per joint."""
    deviation = sum(np.sum((x - x.mean(axis=0)) ** 2, axis=0) for x in tau)
    return sum(np.sum(e**2, axis=0) for e in error) / deviation


def measure(name: str, data: Path) -> dict:
    """Diagnose each fold of one set; return the figures, and the findings of the first fold."""
    chosen, folder = SETS[name], data / name
    urdf = folder / chosen.urdf
    done = []
    with tempfile.TemporaryDirectory() as scratch:
        for fitted, held_out in folds(chosen, folder, Path(scratch)):
            done.append(run(chosen, urdf, fitted, held_out))
            print(f"{name}: {', '.join(p.name for p in held_out)} done", flush=True)
    joints = done[0].diagnosis.identification.series.joints
    tau = [fold.tau for fold in done]
    judged = {model: nmse([fold.error[model] for fold in done], tau) for model in done[0].error}
    found = Counter(key for fold in done for key in {name_of(f) for f in fold.diagnosis.findings})
    return {
        "robot": chosen.robot,
        "torque": chosen.torque,
        "folds": len(done),
        "cutoff_hz": [round(fold.diagnosis.identification.cutoff_hz, 2) for fold in done],
        "rows_held_out": sum(len(x) for x in tau),
        "nmse": {m: {j: float(f"{v:.4g}") for j, v in zip(joints, x, strict=True)} for m, x in judged.items()},
        "verdict": done[0].diagnosis.verdict,
        "findings": [
            {
                "effect": f.effect,
                "joints": list(f.joints),
                "links": list(f.links),
                "probability": round(float(f.probability), 3),
                "found_in_folds": found[name_of(f)],
            }
            for f in done[0].diagnosis.findings
        ],
        "processor_seconds": round(sum(fold.seconds for fold in done) / len(done), 1),
    }


def name_of(finding: torchrbd.Finding) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Return what a finding names: the effect and its place."""
    return finding.effect, tuple(finding.joints), tuple(finding.links)


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
    return 0


if __name__ == "__main__":
    sys.exit(main())
