"""Recordings as samples to learn from: features, the torque that the physics leaves, and its weight."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import Dataset

from torchrbd._runtime.threads import single_threaded
from torchrbd.dataset.reading import Reading
from torchrbd.display import brief, few
from torchrbd.errors import OptionError, RecordingError
from torchrbd.inference import Identification, Settings
from torchrbd.inference.preparation import read
from torchrbd.learning.coordinates import physics_columns
from torchrbd.learning.physics_metric import PhysicsMetric
from torchrbd.learning.splits import FRACTIONS, SPLITS, Split, check_fractions, split_rows
from torchrbd.model import RigidBodyDynamics
from torchrbd.options import Names, Payload, given
from torchrbd.recordings import Sources, States, listed_sources

# Samples at which the physics' columns are kept: some hundred times as many torques as parameters.
_SAMPLE = 1024


@dataclass(frozen=True, eq=False)
class ResidualDataset(Dataset[tuple[Tensor, Tensor, Tensor]]):
    """Samples of what a physics leaves; ``data[k]`` is (features, residual torque, weight), and k may be a list.

    Attributes:
        physics: whose residual it is, a copy.
        features: (N, (3 + 2 h) n): q, qd, qdd, then of each of h steps back, the present first, q_ref - q and qd.
        residual: (N, n) measured torque less the physics', 0 where none is measured [N m, N].
        weight: (N, n) one over the noise's variance, 0 where no torque is measured.
        physics_torque: (N, n) [N m, N].
        recordings: names.
        recording: (N,) index into them.
        t: (N,) seconds from that recording's start.
        dt: between two samples, and two steps of history [s].
        cutoff_hz: band limit of torques and states.
        history: h.
        noise_std: (n,) by which joints are weighed [N m, N].
        sample: (S,) rows at which the physics' columns are known.
        columns: (S, n, P) d tau / d (inertial parameters, term coefficients), in the same band.
    """

    physics: RigidBodyDynamics
    features: Tensor
    residual: Tensor
    weight: Tensor
    physics_torque: Tensor
    recordings: tuple[str, ...]
    recording: Tensor
    t: Tensor
    dt: float
    cutoff_hz: float
    history: int
    noise_std: Tensor
    sample: Tensor
    columns: Tensor

    def __repr__(self) -> str:
        return brief(self, samples=len(self), recordings=few(self.recordings), dt=self.dt, history=self.history)

    def __len__(self) -> int:
        return len(self.features)

    def __getitem__(self, k: Any) -> tuple[Tensor, Tensor, Tensor]:
        return self.features[k], self.residual[k], self.weight[k]

    @property
    def measured(self) -> Tensor:
        """Measured torque (N, n) [N m, N]; the physics' where none is measured."""
        return self.physics_torque + self.residual

    @property
    def metric(self) -> PhysicsMetric:
        """The span of what the physics can say, at the sample."""
        return PhysicsMetric.of(self.features[self.sample], self.columns, self.weight[self.sample])

    def select(self, rows: Tensor) -> ResidualDataset:
        """Return the samples that are ``rows``, (N,) bool."""
        kept = rows[self.sample]
        cut = {name: getattr(self, name)[rows] for name in _BY_SAMPLE}
        place = torch.cumsum(rows, 0) - 1
        return replace(self, **cut, sample=place[self.sample[kept]], columns=self.columns[kept])


_BY_SAMPLE = ("features", "residual", "weight", "physics_torque", "recording", "t")


@single_threaded()
def residual_dataset(
    diagnosis: Any,
    recordings: Sources,
    *,
    split: Split | None = None,
    fractions: Sequence[float] = FRACTIONS,
    history: int = 0,
    dtype: torch.dtype = torch.float32,
    time: str | tuple[float, float] | None = None,
    joints: Names | None = None,
    payload: Sequence[Payload | str] | Payload | str = (),
    mapping: str | Path | None = None,
    cutoff_hz: float | None = None,
) -> ResidualDataset:
    """Return the residual of recorded torques, as samples for a ``torch.utils.data.DataLoader``.

    Torque and the model's torque, computed from states at the recording's full rate, go through one low-pass filter and
    are thinned together; features are states in the same band. The model's residual on the recordings that it was
    fitted to is smaller than on new ones: hold some recordings, or time, out of the fit.

    Splits are windows of time with gaps as long as the filters reach: "train", "validation" and "test" of the same
    recordings and ``fractions`` never share a sample of the raw recording. Cut-off and weights are those of all parts.

    Args:
        diagnosis: a ``Diagnosis``, an ``Identification`` or a ``RigidBodyDynamics``; of the first two, the band limit
            and the noise are taken too. States are filtered ones, even where the fit has smoothed them.
        recordings: as in ``identify``.
        split: the part to return; all of the recordings if None.
        fractions: of the time for training, validation and test.
        history: steps of velocity and position error among the features, the present one among them; the recordings
            need set-points q_ref.
        dtype: of the samples.
        time: use only this part of each recording, FROM:TO [s] from its start, e.g. 2:30. In Python, text or a pair of
            numbers. Default: all.
        joints: joints whose torque counts, by name. Default: all.
        payload: known loads, FILE=kg,x,y,z[@LINK]: mass [kg] and centre of mass [m] in the frame of a link. In Python,
            text or ``torchrbd.inference.Payload``. Default: none; of a chain, the link is the last one.
        mapping: YAML file with other column names, units, signs, gear ratios or torque constants. Default: columns t,
            q_<joint>, tau_<joint> in SI units.
        cutoff_hz: band limit of torque and features [Hz]. Default: chosen from the data.

    Raises:
        InputError: something that has no model, or recordings or options that cannot be used.

    Example:
        >>> import torch, torchrbd
        >>> found = torchrbd.identify("robot.urdf", ["monday.csv"])
        >>> data = torchrbd.residual_dataset(found, ["tuesday.csv"], split="train")
        >>> loader = torch.utils.data.DataLoader(data, batch_size=256, shuffle=True)
        >>> features, residual, weight = next(iter(loader))
    """
    physics, settings, noise = _arguments(diagnosis, given(locals()))
    if split is not None and split not in SPLITS:
        raise OptionError(f"split is '{split}'; expected one of {', '.join(SPLITS)}, or None for all")
    check_fractions(fractions)
    if history < 0:
        raise OptionError(f"history is {history}; expected 0 or more steps")
    reading, _ = read(physics.robot, listed_sources(recordings), settings)
    reading = _taking_loads(physics, reading)
    rows = _read_rows(physics, reading, history)
    label = torch.zeros(len(rows.t), dtype=torch.long)
    if split is not None:
        reach = 2.0 * max(reading.filtering.reach(s.clock.dt) * s.clock.dt for s in reading.surveys)
        label = split_rows(rows.t, rows.recording, fractions, reach + max(0, history - 1) * rows.dt)
    seen = rows.seen
    training = seen & (label == 0).unsqueeze(1)
    left = (rows.residual.square() * training).sum(0) / training.sum(0)
    std = left.sqrt() if noise is None else torch.where(torch.isnan(noise), left.sqrt(), noise)
    weight = torch.where(seen, std.clamp_min(1e-9) ** -2.0, 0.0)
    data = ResidualDataset(
        physics=physics,
        features=rows.features.to(dtype),
        residual=rows.residual.to(dtype),
        weight=torch.nan_to_num(weight).to(dtype),
        physics_torque=rows.physics.to(dtype),
        recordings=tuple(r.name for r in reading.recordings),
        recording=rows.recording,
        t=rows.t,
        dt=rows.dt,
        cutoff_hz=reading.filtering.cutoff_hz,
        history=history,
        noise_std=std,
        sample=rows.sample,
        columns=rows.columns.to(dtype),
    )
    return data if split is None else data.select(label == SPLITS.index(split))


def _arguments(diagnosis: Any, options: dict[str, Any]) -> tuple[RigidBodyDynamics, Settings, Tensor | None]:
    """Return a copy of the model, settings, and the joints' noise (n,) if a fit has estimated it.

    Raises:
        InputError: there is no model.
    """
    if isinstance(diagnosis, RigidBodyDynamics):
        model, found = diagnosis, None
    else:
        model, found = RigidBodyDynamics.from_diagnosis(diagnosis), getattr(diagnosis, "identification", diagnosis)
    noise = None
    if isinstance(found, Identification):
        options = {"cutoff_hz": found.cutoff_hz} | {k: v for k, v in options.items() if v is not None}
        known = {joint: one.torque for joint, one in found.noise.items()}
        noise = torch.tensor([known.get(joint, math.nan) for joint in model.robot.joint_names], dtype=torch.float64)
    physics = copy.deepcopy(model).requires_grad_(False)
    return physics, Settings.from_mapping(options, "residual_dataset"), noise


def _taking_loads(physics: RigidBodyDynamics, reading: Reading) -> Reading:
    """Have known loads taken off the recorded torque, those that the model knows too, and no longer predicted by it."""
    known = {name: one.load for name, one in physics.conditions.items() if one.load is not None}
    names = [r.name for r in reading.recordings]
    loads = {name: load for name, load in known.items() if name in names} | reading.payload
    physics.conditions = {name: replace(one, load=None) for name, one in physics.conditions.items()}
    return replace(reading, payload=loads)


@dataclass(frozen=True)
class _Rows:
    """Samples of all recordings before they are split; as in ``ResidualDataset``, in float64."""

    features: Tensor
    residual: Tensor
    seen: Tensor
    physics: Tensor
    recording: Tensor
    t: Tensor
    dt: float
    sample: Tensor
    columns: Tensor


def _read_rows(physics: RigidBodyDynamics, reading: Reading, history: int) -> _Rows:
    """Stream the recordings.

    Raises:
        RecordingError: history without set-points, or recordings of different rates.
    """
    found: dict[str, list[Tensor]] = {key: [] for key in (*_BY_TILE, "recording", "sample", "columns")}
    step, count, steps = _thinning(reading), 0, set()
    for k, recording in enumerate(reading.recordings):
        if history and not recording.has_reference:
            raise RecordingError(f"{recording.path or recording.name}: history needs set-points, columns q_ref_<joint>")
        carried: tuple[int, Tensor] | None = None
        for states in reading.tiles(k):
            steps.add(round(states.dt_out, 9))
            part = _tile(physics, states, reading.measured(k), recording.name)
            at = torch.arange(-count % step, len(states.t_out), step)
            found["sample"].append(at + count)
            found["columns"].append(_columns_at(physics, states, recording.name, at))
            if history:
                before = carried[1] if carried is not None and carried[0] == states.segment else None
                part["features"], kept = _with_history(part["features"], _errors(states), before, history)
                carried = states.segment, kept
            for key in _BY_TILE:
                found[key].append(part[key])
            found["recording"].append(torch.full((len(states.t_out),), k))
            count += len(states.t_out)
    if len(steps) > 1 and history:
        raise RecordingError(f"steps of history would last {sorted(steps)} s in different recordings; use one rate")
    joined = {key: torch.cat(values) for key, values in found.items()}
    return _complete(_Rows(dt=steps.pop(), **joined))


_BY_TILE = ("features", "residual", "seen", "physics", "t")


def _tile(physics: RigidBodyDynamics, states: States, measured: Tensor, recording: str) -> dict[str, Tensor]:
    """Return the samples of one tile."""
    q, qd, qdd = states.q.T, states.qd.T, states.qdd.T
    with torch.no_grad():
        torque = physics(q, qd, qdd, **_conditions(states, recording)).T
    said = states.decimate(torque).T
    seen = measured & ~torch.isnan(states.tau).any(1)
    whole = states.tau if states.known is None else states.tau + states.as_recorded(states.known)
    tau = states.decimate_torque(torch.nan_to_num(whole)).T
    return {
        "features": torch.cat([states.decimate(x) for x in (states.q, states.qd, states.qdd)]).T,
        "residual": torch.where(seen, tau - said, 0.0),
        "seen": seen.expand_as(tau),
        "physics": said,
        "t": states.t_out,
    }


def _conditions(states: States, recording: str) -> dict[str, Any]:
    warm = None if states.temperature is None else states.temperature.T
    return {"t": states.t, "temperature": warm, "recording": recording}


def _columns_at(physics: RigidBodyDynamics, states: States, recording: str, at: Tensor) -> Tensor:
    """Return the physics' columns (S, n, P), filtered as the torque is, at some of a tile's outputs."""
    columns = physics_columns(physics, states.q.T, states.qd.T, states.qdd.T, **_conditions(states, recording))
    return states.decimate(columns.detach().permute(1, 2, 0))[..., at].permute(2, 0, 1)


def _errors(states: States) -> Tensor:
    """Return position errors q_ref - q (M, n)."""
    assert states.reference is not None
    return states.decimate(states.reference[0] - states.q).T


def _with_history(features: Tensor, errors: Tensor, before: Tensor | None, history: int) -> tuple[Tensor, Tensor]:
    """Return features (M, (3 + 2 h) n) with history, NaN where it reaches before the segment, and the steps
    (h - 1, 2 n) that the next tile needs."""
    n = errors.shape[1]
    now = torch.cat((errors, features[:, n : 2 * n]), 1)
    if before is None:
        before = now.new_full((history - 1, 2 * n), torch.nan)
    path = torch.cat((before, now))
    back = [path[history - 1 - k : len(path) - k] for k in range(history)]
    return torch.cat((features, *back), 1), path[len(path) - history + 1 :]


def _thinning(reading: Reading) -> int:
    """Return of how many samples one has its columns kept."""
    outputs = sum(s.duration_s / (reading.filtering.stride(s.clock.dt) * s.clock.dt) for s in reading.surveys)
    return max(1, math.ceil(outputs / _SAMPLE))


def _complete(rows: _Rows) -> _Rows:
    """Return the samples whose features are all there."""
    there = ~torch.isnan(rows.features).any(1)
    place, kept = torch.cumsum(there, 0) - 1, there[rows.sample]
    cut = {key: getattr(rows, key)[there] for key in (*_BY_TILE, "recording")}
    return replace(rows, **cut, sample=place[rows.sample[kept]], columns=rows.columns[kept])
