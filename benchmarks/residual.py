"""What a network beside the physics is worth: torque error on other recordings, near its training data and far away.

    TORCHRBD_DATA=/path/to/recordings OMP_NUM_THREADS=1 python benchmarks/residual.py [SET...]

Sets: ``double_pendulum`` (design A of DFKI's, its URDF's masses and centres of mass made wrong; four of its recordings,
one of them of another controller, to judge by), ``panda`` (the first two thirds to learn from, the last third to judge
by) and ``concealed``, a case of the concealed benchmark whose effect is in no catalogue: friction at one joint that
goes with the angle of another. Models learn from a stretch of 2 s, of 20 s, and from all: the physics by
``torchrbd.DynamicsRegressor``, with friction terms or without, then the network on what it leaves, by
``torchrbd.fit_residual``; a fifth of the stretch chooses among the network's epochs.

Printed is nmse, mean over joints: squared error over the variance of that joint's torque in all of the recordings to
judge by, inside and outside the network's training region (which hangs on the features alone, and so is one for all
models). "Not faded" is physics + network without the network's silence outside; "joint", with physics that learns on
beside the network. The last rows say how often an error is below two of the standard deviations that the model gives.
Needs the test extra.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import import_paths  # noqa: F401
import pyarrow.compute as pc
import pyarrow.parquet as pq
import real_recordings as real
import torch
from torch import Tensor

import torchrbd
from benchmarks.concealed.cases import make_case
from torchrbd import RigidBodyDynamics, RobotModel
from torchrbd.learning import ResidualDataset

AMOUNTS = {"2 s": 2.0, "20 s": 20.0, "all": float("inf")}
EPOCHS, BATCH, RATE = 150, 128, 2e-3
JUDGED = ("055903", "060440", "061705", "pendubot")
PANDA_CUT_S, PANDA_CUTOFF_HZ = 14.0, 10.0
CONCEALED_CUT_S = 22.0
CONCEALED = "development", "outside", 3, 0
# Where a stretch begins, in parts of all there is; the length of a round, and what of it is learned from and left out.
BEGIN, ROUND_S, LEARN, GAP = 0.25, 6.0, 0.7, 0.05


@dataclass(frozen=True)
class Task:
    """A robot with recordings to learn from and others to judge by."""

    name: str
    urdf: str
    learn: tuple[Any, dict[str, Any]]
    judge: tuple[Any, dict[str, Any]]

    def read(self, physics: RigidBodyDynamics, *, judge: bool) -> ResidualDataset:
        """Return what a physics leaves."""
        recordings, options = self.judge if judge else self.learn
        return torchrbd.residual_dataset(physics, recordings, **options)


def double_pendulum(folder: Path, into: Path) -> Task:
    """DFKI's double pendulum."""
    own = folder / "dfki_double_pendulum"
    paths = [*real.recordings_of(folder, "A"), own / "A_20220819_174435_pendubot.csv"]
    judged = [p for p in paths if any(word in p.name for word in JUDGED)]
    options = {"cutoff_hz": real.PENDULUM_CUTOFF_HZ}
    urdf = real.spoiled((own / "robot_A.urdf").read_text())
    return Task("double_pendulum", urdf, ([p for p in paths if p not in judged], options), (judged, options))


def panda(folder: Path, into: Path) -> Task:
    """One trajectory of a Panda."""
    file, options = folder / "panda" / "exciting_traj.csv", {"cutoff_hz": PANDA_CUTOFF_HZ}
    learn, judge = ({"time": span, **options} for span in ((0.0, PANDA_CUT_S), (PANDA_CUT_S, 1e3)))
    return Task("panda", (folder / "panda" / "robot.urdf").read_text(), (file, learn), (file, judge))


def concealed(folder: Path, into: Path) -> Task:
    """A simulated arm with friction that goes with the angle of another joint."""
    case = make_case(*CONCEALED)
    print(f"concealed: {case.truth['effects'][0]}")
    for name, table in case.recordings.items():
        pq.write_table(table, into / name)
    fit, cut = case.recordings["fit_1.parquet"], CONCEALED_CUT_S
    pq.write_table(fit.filter(pc.field("t") > cut), into / "rest.parquet")
    options = {"cutoff_hz": 8.0}
    learn = into / "fit_1.parquet", {"time": (0.0, cut), **options}
    return Task("concealed", case.urdf, learn, ([into / "rest.parquet", into / "holdout.parquet"], options))


TASKS: dict[str, Callable[[Path, Path], Task]] = {
    "double_pendulum": double_pendulum,
    "panda": panda,
    "concealed": concealed,
}


@dataclass
class Scores:
    """Per model, nmse inside and outside; seconds of data, part outside, and how often two deviations hold."""

    seconds: float
    outside: float
    nmse: dict[str, tuple[float, float]] = field(default_factory=dict)
    covered: dict[str, tuple[float, float]] = field(default_factory=dict)


def stretch(data: ResidualDataset, seconds: float) -> ResidualDataset:
    """Return a stretch of samples in the middle of all."""
    count = round(min(len(data), seconds / data.dt))
    begin = min(round(BEGIN * len(data)), len(data) - count)
    rows = torch.arange(len(data))
    return data.select((rows >= begin) & (rows < begin + count))


def parts(data: ResidualDataset) -> tuple[ResidualDataset, ResidualDataset]:
    """Return what is learned from and what is chosen by: every fifth of a stretch in turns, with gaps."""
    rows = torch.arange(len(data))
    rounds = max(1, round(len(data) * data.dt / ROUND_S))
    phase = rows * rounds / len(data) % 1.0
    return data.select(phase < LEARN), data.select((phase >= LEARN + GAP) & (phase < 1.0 - GAP))


def fitted(task: Task, data: ResidualDataset, *, friction: bool) -> RigidBodyDynamics:
    """Return the physics fitted to samples."""
    n = data.residual.shape[1]
    regressor = torchrbd.DynamicsRegressor(task.urdf.encode(), friction=friction)
    return regressor.fit(data.features[:, : 3 * n].double().numpy(), data.measured.double().numpy()).model_


def with_network(
    task: Task, physics: RigidBodyDynamics, seconds: float, **options: Any
) -> tuple[torchrbd.ResidualDynamics, ResidualDataset]:
    """Train a network beside a physics; return both, and what is to be judged."""
    torch.manual_seed(0)
    data = stretch(task.read(physics, judge=False), seconds)
    model = torchrbd.ResidualDynamics(physics, fade=options.pop("fade", True), mode=options.pop("mode", "frozen"))
    learn, choose = parts(data)
    torchrbd.fit_residual(
        model, learn, validation=choose, epochs=EPOCHS, batch_size=BATCH, lr=RATE, progress=False, **options
    )
    return model, task.read(physics, judge=True)


def nmse(left: Tensor, data: ResidualDataset, rows: Tensor) -> float:
    """Return squared error (N, n) over variance of torque, mean over joints; NaN of no rows."""
    return float((left[rows].double().square().mean(0) / data.measured.double().var(0)).mean())


def score(task: Task, seconds: float) -> Scores:
    """Train all models on a stretch and judge them."""
    robot = RobotModel.from_urdf(task.urdf.encode())
    nothing = RigidBodyDynamics(robot, torch.zeros(robot.n_params, dtype=torch.float64))
    measured = stretch(task.read(nothing, judge=False), seconds)
    plain, terms = (fitted(task, measured, friction=friction) for friction in (False, True))
    tries: dict[str, tuple[RigidBodyDynamics, dict[str, Any]]] = {
        "network only": (nothing, {"fade": False, "orthogonality": 0.0}),
        "physics + network": (plain, {}),
        "physics + network, not faded": (plain, {"fade": False}),
        "physics + terms + network": (terms, {}),
        "physics + terms + network, joint": (terms, {"mode": "joint"}),
    }
    found = Scores(len(measured) * measured.dt, 0.0)
    for name, (physics, options) in tries.items():
        model, judged = with_network(task, physics, seconds, **options)
        inside = model.inside(judged.features)
        found.outside = float((~inside).double().mean())
        both = inside, ~inside
        if name.endswith("network") and physics is not nothing:
            alone = name.removesuffix(" + network")
            found.nmse[alone] = tuple(nmse(judged.residual, judged, rows) for rows in both)  # pyright: ignore
        left = model.left(judged)
        found.nmse[name] = tuple(nmse(left, judged, rows) for rows in both)  # pyright: ignore
        held = (left.abs() < 2.0 * model.std(judged.features)).double()
        found.covered[name] = tuple(float(held[rows].mean()) for rows in both)  # pyright: ignore
    return found


def print_table(task: str, scores: dict[str, Scores]) -> None:
    """Print a set's errors in Markdown."""
    heads = [f"{name}, {where}" for name in scores for where in ("inside", "outside")]
    print(f"\n| {task}: nmse | {' | '.join(heads)} |\n| --- |{' --- |' * len(heads)}")
    share = [text for s in scores.values() for text in (f"{1 - s.outside:.0%}", f"{s.outside:.0%}")]
    print(f"| part of the samples | {' | '.join(share)} |")
    for model in next(iter(scores.values())).nmse:
        print(f"| {model} | {_cells([s.nmse[model] for s in scores.values()], '.4f')} |")
    for model in ("physics + network", "physics + terms + network"):
        print(f"| {model}: within 2 std | {_cells([s.covered[model] for s in scores.values()], '.0%')} |")


def _cells(pairs: Sequence[tuple[float, float]], form: str) -> str:
    return " | ".join("-" if x != x else format(x, form) for pair in pairs for x in pair)


def main() -> None:
    """Score the sets that are named, or all."""
    torch.set_num_threads(1)
    folder, begin = real.data_folder(), time.monotonic()
    if folder is None:
        sys.exit("set TORCHRBD_DATA to the folder of real recordings")
    for name in sys.argv[1:] or TASKS:
        with TemporaryDirectory() as into:
            task, scores = TASKS[name](folder, Path(into)), {}
            for label, seconds in AMOUNTS.items():
                scores[label] = score(task, seconds)
                if scores[label].seconds < 0.95 * seconds < math.inf:
                    # There is not as much.
                    del scores[label]
                    continue
                print(
                    f"{name}, {label}: {scores[label].seconds:.3g} s, at {time.monotonic() - begin:.0f} s", flush=True
                )
            print_table(name, scores)


if __name__ == "__main__":
    main()
