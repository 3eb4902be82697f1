"""One recording anew: a model rolled forward from its first state under its torque, or its set-points."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import torch
from pyarrow import csv, parquet
from scipy.interpolate import make_interp_spline

from torchrbd._runtime.outputs import write_whole
from torchrbd.dataset.reading import Progress
from torchrbd.display import Remark, brief, few
from torchrbd.errors import OptionError, RecordingError
from torchrbd.model import Condition, RigidBodyDynamics
from torchrbd.recordings import (
    Data,
    Filtering,
    Recording,
    Survey,
    choose_cutoff,
    open_recording,
    read_mapping,
    survey,
    tiles,
)
from torchrbd.simulation.closed_loop import with_commands
from torchrbd.simulation.plant import Plant
from torchrbd.simulation.rollout import Drive, rollout
from torchrbd.simulation.windows import STEP_S, driving, pieces

SUFFIXES = (".parquet", ".csv", ".npz")
"""Of the files that a motion can be written to."""
_STEPS_AT_ONCE, _MOST_RATE_HZ = 200, 1e5
# Longest step under set-points [s]: a stiff drive of a light link is faster than a robot.
_COMMANDED_S = 1e-3


@dataclass(frozen=True)
class SimulatedMotion:
    """A motion that a model makes, and the recorded one.

    Attributes:
        joints: names of the n joints.
        t: (N,) seconds from the recording's first row.
        q, qd: (N, n) simulated [rad, m] and per second; NaN once the motion is lost.
        tau: (N, n) torque that drove it, at the time of the motion [N m, N]; NaN where a joint was moved.
        recorded: (N, n) positions as recorded, low-passed as everywhere.
        q_ref: (N, n) set-points when drives follow them [rad, m], NaN for joints without a drive; None under a torque.
        moved: joints whose torque is not recorded: they move as they did.
        notes: further remarks.
    """

    joints: tuple[str, ...]
    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray
    recorded: np.ndarray
    moved: tuple[str, ...]
    notes: tuple[Remark, ...]
    q_ref: np.ndarray | None = None

    def __repr__(self) -> str:
        errors = [f"{name}: {x:.3g}" for name, x in self.distance.items() if name not in self.moved]
        return brief(self, seconds=float(self.t[-1] - self.t[0]), samples=len(self.t), distance=few(errors))

    @property
    def distance(self) -> dict[str, float]:
        """Root mean square distance from the recorded positions by joint [rad, m]; NaN once the motion is lost."""
        rms = np.sqrt(np.square(self.q - self.recorded).mean(0))
        return dict(zip(self.joints, rms.tolist(), strict=True))

    @property
    def tracking(self) -> dict[str, tuple[float, float]]:
        """Root mean square of set-point minus position, of the robot and simulated, by joint with a drive [rad, m]."""
        if self.q_ref is None:
            return {}
        both = (np.sqrt(np.square(self.q_ref - q).mean(0)).tolist() for q in (self.recorded, self.q))
        found = dict(zip(self.joints, zip(*both, strict=True), strict=True))
        return {name: pair for name, pair in found.items() if not np.isnan(pair[0])}

    def recording(self, name: str = "simulated") -> Recording:
        """Return it as a recording, for ``identify`` and ``diagnose``."""
        return Recording.from_arrays(name, self.joints, self.t, self.q, self.tau, self.qd)

    def write(self, path: str | Path) -> None:
        """Write it as a recording with columns t, q_<joint>, qd_<joint> and tau_<joint>.

        Args:
            path: ends in .parquet, .csv or .npz.

        Raises:
            OptionError: another ending.
        """
        path = Path(path)
        check_suffix(path)
        sink = pa.BufferOutputStream()
        signals = {"q": self.q, "qd": self.qd, "tau": self.tau}
        if path.suffix == ".npz":
            np.savez_compressed(sink, t=self.t, joints=np.array(self.joints), **signals)  # pyright: ignore[reportArgumentType]
        else:
            columns = {f"{key}_{joint}": x[:, k] for key, x in signals.items() for k, joint in enumerate(self.joints)}
            known = {name: x for name, x in columns.items() if not np.isnan(x).all()}
            table = pa.table({"t": self.t, **known})
            (parquet.write_table if path.suffix == ".parquet" else csv.write_csv)(table, sink)
        write_whole(path, sink.getvalue().to_pybytes())


def check_suffix(path: Path) -> None:
    """Refuse a file that no motion can be written to.

    Raises:
        OptionError: its ending is not one of ``SUFFIXES``.
    """
    if path.suffix not in SUFFIXES:
        raise OptionError(f"output '{path}': expected a file that ends in {', '.join(SUFFIXES)}")


def simulate(
    model: RigidBodyDynamics,
    recording: str | Path | Recording | Data,
    *,
    start: float = 0.0,
    seconds: float | None = None,
    rate_hz: float | None = None,
    commands: bool = False,
    mapping: str | Path | None = None,
    cutoff_hz: float | None = None,
    progress: Progress = lambda *_: None,
) -> SimulatedMotion:
    """Roll a model forward from a recorded state under the recorded torque, or under the recorded set-points.

    With ``commands``, joints with a drive follow their recorded set-points, with the gains, limits and delay that the
    mapping has: the closed loop of the robot. Errors do not grow then.

    Without, nothing holds the motion to the recorded one: small errors grow, the faster the less stable the robot is.

    Joint limits and contacts are left out. Joints whose torque is not recorded move as they did. Torques and set-points
    are linear between two samples; steps last 5 ms at most, 1 ms under set-points.

    What the model knows of the recording counts: a torque that is late, early or a command is brought to the motion,
    and the robot carries its known load. One that it does not know has the clock of those that the model was fitted
    to, as in ``replay``.

    Args:
        model: what moves; ``RigidBodyDynamics.from_urdf``, ``load_model``, or ``Identification.model``.
        recording: whose first state and torque are taken.
        start: where it begins, seconds from the recording's first row; the filters need a moment before it.
        seconds: how long it lasts; to the end of the uninterrupted piece by default.
        rate_hz: samples a second; the recording's by default.
        commands: whether drives follow set-points; the mapping then gives their gains.
        mapping: YAML file of other column names and units.
        cutoff_hz: band limit of the recorded motion [Hz]; chosen from the data by default.
        progress: called with the stage and the part of it that is done.

    Raises:
        RecordingError: a recording that cannot be used, or that has no torque (for ``commands``, no drive), or nothing
            at that time.
        OptionError: a start before the first row, a length or rate that is not positive, or a rate beyond 100 kHz.
        PhysicalError: the mass matrix is not positive definite.

    Example:
        >>> model = torchrbd.load_model("out/model.safetensors")
        >>> moved = torchrbd.simulate(model, "wednesday.csv", start=2.0, seconds=1.0)
        >>> moved.distance
        {'joint1': 0.0031, 'joint2': 0.0058}
    """
    if not (math.isfinite(start) and start >= 0):
        raise OptionError(f"start is {start:g} s; expected a number that is not negative")
    for name, value in (("seconds", seconds), ("rate", rate_hz)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise OptionError(f"{name} is {value:g}; expected more than zero")
    if rate_hz is not None and rate_hz > _MOST_RATE_HZ:
        raise OptionError(f"rate is {rate_hz:g}; expected at most {_MOST_RATE_HZ:.0f} samples a second")
    opened = _opened(recording, model, mapping)
    seen = survey(opened)
    measured = torch.from_numpy(opened.measured)
    if not bool(measured.any()):
        raise RecordingError(f"{opened.path or opened.name}: no torque is recorded, so nothing drives the robot")
    condition = model.condition(opened.name)
    if commands and not opened.drives.of:
        raise RecordingError(
            f"{opened.path or opened.name}: no joint has a drive that follows set-points; give --mapping a file with "
            "their gains, such as joints: {'*': {drive: {kp: 20, kd: 0.5}}}"
        )
    plant = Plant(model, condition.load)
    t, signals = _piece(opened, seen, plant, condition, start, seconds, cutoff_hz)
    dt = 1.0 / (rate_hz or seen.rate_hz)
    parts = max(1, math.ceil(dt / (_COMMANDED_S if commands else STEP_S) - 1e-6))
    begin = max(start, float(t[0]))
    until = float(t[-1]) if seconds is None else min(begin + seconds, float(t[-1]))
    count = math.floor((until - begin) / dt + 1e-6)
    if count < 1:
        raise RecordingError(
            f"{opened.path or opened.name}: {until - begin:.3g} s hold no step of {dt:.3g} s; simulate longer, or "
            "give a higher rate"
        )
    at = np.minimum(begin + dt / parts * np.arange(count * parts + 1), t[-1])
    x = {name: one.unsqueeze(0) for name, one in driving(t, signals, at).items()}
    drive = Drive(
        h=dt / parts,
        tau=x["tau"] - x["along"] if "along" in x else x["tau"],
        moved=~measured,
        q=x["q"],
        qd=x["qd"],
        qdd=x["qdd"],
        t=torch.tensor([begin], dtype=torch.float64),
        temperature=x.get("temperature"),
        recording=opened.name,
    )
    if commands:
        drive = with_commands(drive, opened, at[None])
    q, qd = _rolled(plant, drive, progress)
    at = at[::parts]
    tau = np.where(opened.measured, make_interp_spline(t, signals["tau"], k=1)(at), np.nan)
    q_ref = None
    if drive.commands is not None:
        driven, follows = (drive.commands.kp > 0).numpy(), drive.commands
        q_ref = np.where(driven, follows.q_ref[0, ::parts].numpy(), np.nan)
        own = follows.of(follows.q_ref[0, ::parts], q[0, ::parts], qd[0, ::parts]).numpy()
        tau = np.where(driven, own, tau)
    moved = tuple(name for name, known in zip(opened.joints, opened.measured, strict=True) if not known)
    q, qd, recorded = (one[0, ::parts].numpy() for one in (q, qd, drive.q))
    notes = _notes(opened, condition, start, begin)
    return SimulatedMotion(opened.joints, at, q, qd, tau, recorded, moved, notes, q_ref)


def _opened(
    recording: str | Path | Recording | Data, model: RigidBodyDynamics, mapping: str | Path | None
) -> Recording:
    names = model.robot.joint_names
    if isinstance(recording, Recording):
        return recording.of_joints(names)
    return open_recording(recording, names, mapping=None if mapping is None else read_mapping(mapping))


def _notes(opened: Recording, condition: Condition, start: float, begin: float) -> tuple[Remark, ...]:
    notes = list(opened.notes)
    if begin > start + 1e-6:
        notes.append(Remark("later start", {"begin_s": begin, "asked_s": start}))
    if condition.delay_s:
        notes.append(Remark("late torque moved", {"delay_s": condition.delay_s}))
    if condition.lag_s:
        notes.append(Remark("torque is a command", {"lag_s": condition.lag_s}))
    return tuple(notes)


def _piece(
    opened: Recording,
    seen: Survey,
    plant: Plant,
    condition: Condition,
    start: float,
    seconds: float | None,
    cutoff_hz: float | None,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return times (N,) and signals (N, n_dof) of the uninterrupted piece in which a motion begins.

    Raises:
        RecordingError: there is none.
    """
    filtering = Filtering(choose_cutoff([seen]) if cutoff_hz is None else cutoff_hz)
    parts: list[tuple[np.ndarray, dict[str, np.ndarray]]] = []
    first, last = math.inf, -math.inf
    acting = (replace(states, tau=condition.acting(states.tau, states.dt)) for states in tiles(opened, seen, filtering))
    for t, signals in pieces(acting, {"along": plant}, 0.0):
        if parts and t[0] > last:
            break
        first, new = min(first, float(t[0])), (t > last) & (t > start - 2.0 * seen.clock.dt)
        last = float(t[-1])
        if last > start:
            parts.append((t[new], {name: x[new] for name, x in signals.items()}))
        if parts and seconds is not None and last >= max(start, float(parts[0][0][0])) + seconds:
            break
    if not parts:
        raise RecordingError(
            f"{opened.path or opened.name}: nothing at {start:g} s or after it that the filters leave; it has "
            f"{first:.3g} to {last:.3g} s"
        )
    joined = {name: np.concatenate([signals[name] for _, signals in parts]) for name in parts[0][1]}
    return np.concatenate([t for t, _ in parts]), joined


def _rolled(plant: Plant, drive: Drive, progress: Progress) -> tuple[torch.Tensor, torch.Tensor]:
    """Roll one window forward, telling how far it is."""
    q, qd, steps = drive.q[:, :1], drive.qd[:, :1], drive.tau.shape[1]
    parts = [(q, qd)]
    for first in range(0, steps, _STEPS_AT_ONCE):
        progress("simulating", first / steps)
        last = min(first + _STEPS_AT_ONCE, steps)
        q, qd = rollout(plant, q[:, -1], qd[:, -1], drive.steps(first, last))
        parts.append((q[:, 1:], qd[:, 1:]))
    positions, velocities = zip(*parts, strict=True)
    return torch.cat(positions, 1), torch.cat(velocities, 1)
