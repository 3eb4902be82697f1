"""Everything that locating looks at, on the decimated clock: torques, states, and what a model is free to explain.

Blocks of a second are too coarse for what starts and ends within tenths, so here the rows themselves are kept: per
joint the columns of the regressor that span all others, friction, an offset, and the terms already found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from torchrbd.inference.data.columns import Candidate, Columns
from torchrbd.inference.preparation import Prepared
from torchrbd.parameters import base_parameters
from torchrbd.recordings import States
from torchrbd.robot import RobotModel


@dataclass(frozen=True)
class Rows:
    """M samples of a robot with n joints; held-out ones are not among them.

    Attributes:
        robot: the robot.
        recordings: names.
        recording: (M,) index into ``recordings``.
        t: (M,) seconds from that recording's start.
        run: (M,) number of the uninterrupted run that a sample belongs to.
        q, qd, qdd: (M, n) band-limited states.
        direction: (M, n) sign(qd), band-limited as the torque is.
        load: (M, n) torque of the rigid body with fitted parameters.
        tau: (M, n) measured torque, 0 where ``measured`` is not.
        measured: (M, n) bool.
        rigid: (n, M, B) independent columns of the regressor, zero where a body is not moved by the joint.
        own: per joint (M, K_j): offset, friction and the joint's terms.
        shared: (n, M, K) features of terms that act on the whole robot.
        rise: how a step at time zero looks behind the filter that all torques passed: times (R,) [s] and heights (R,).
    """

    robot: RobotModel
    recordings: tuple[str, ...]
    recording: np.ndarray
    t: np.ndarray
    run: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    direction: np.ndarray
    load: np.ndarray
    tau: np.ndarray
    measured: np.ndarray
    rigid: np.ndarray
    own: tuple[np.ndarray, ...]
    shared: np.ndarray
    rise: tuple[np.ndarray, np.ndarray]

    @cached_property
    def dt(self) -> float:
        """Time between two samples [s]."""
        steps = np.diff(self.t)[np.diff(self.run) == 0]
        return float(np.median(steps)) if len(steps) else 1.0

    def since(self, t: np.ndarray) -> np.ndarray:
        """Return a step at time zero as the filter leaves it."""
        return np.interp(t, *self.rise)

    @cached_property
    def load_rate(self) -> np.ndarray:
        """Change of the load in time, (M, n) [N m/s] or [N/s]: what a late torque leaves."""
        rate = np.zeros_like(self.load)
        for one in np.unique(self.run):
            here = self.run == one
            if here.sum() > 2:
                rate[here] = np.gradient(self.load[here], self.dt, axis=0)
        return rate

    def last_body(self, joint: int) -> int:
        """Return the last of the bodies that a joint moves."""
        return int(self.robot.columns(joint)[-1]) // 10

    @cached_property
    def carried(self) -> np.ndarray:
        """Torque that a unit mass at each body's origin takes, and unit first moments, (n, M, n_bodies, 4)."""
        q, qd, qdd = (torch.from_numpy(x) for x in (self.q, self.qd, self.qdd))
        return self.robot.regressor(q, qd, qdd).unflatten(2, (-1, 10))[:, :, :, :4].movedim(1, 0).numpy()

    @cached_property
    def held(self) -> np.ndarray:
        """Torque that holds a unit mass at each body's origin, and that a first moment adds, per axis of a force.

        (n, M, n_bodies, 4, 3): entry [..., 0, k] is J' e_k, the torque against a force of -1 N along the base's axis k
        at the body's origin; [..., 1 + i, k] what it grows by for each metre of the point of attack along the body's
        axis i.
        """
        q = torch.from_numpy(self.q)
        still = torch.zeros_like(q)
        columns = [self.robot.regressor(q, still, still, -axis) for axis in torch.eye(3, dtype=torch.float64)]
        Y = torch.stack(columns, -1).unflatten(2, (-1, 10))[:, :, :, :4]
        return Y.movedim(1, 0).numpy()


def read_rows(prepared: Prepared, pi: torch.Tensor, terms: Sequence[Candidate] = ()) -> Rows:
    """Stream the recordings once and keep what locating needs.

    Args:
        prepared: the data; samples in held-out blocks are left out.
        pi: (n_params,) inertial parameters that make the load.
        terms: those of the model whose leftover is looked at.
    """
    robot, columns = prepared.robot, prepared.columns
    base = list(base_parameters(robot).independent)
    fitted = (*columns.urdf_friction, *terms)
    parts: list[dict[str, np.ndarray]] = []
    run = 0
    for k, recording in enumerate(prepared.recordings):
        measured, segment, end, last = prepared.measured(k), -1, -np.inf, True
        for states in prepared.tiles(k):
            kept = ~prepared.kept_back(recording.name, states.t_out).numpy()
            t = states.t_out.numpy()
            before = np.concatenate(([end if states.segment == segment else -np.inf], t[:-1]))
            begins = (t - before > 1.5 * states.dt_out) | (kept & ~np.concatenate(([last], kept[:-1])))
            number = run + np.cumsum(begins)
            run, segment, end, last = int(number[-1]), states.segment, float(t[-1]), bool(kept[-1])
            tile = _signals(columns, states, measured, fitted, pi, base)
            tile |= {"recording": np.full(len(t), k), "t": t, "run": number}
            tile["measured"] = np.tile(measured.numpy(), (len(t), 1))
            parts.append({name: values[kept] for name, values in tile.items()})
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    features = np.moveaxis(joined.pop("features"), 0, 1)
    rigid = np.ascontiguousarray(np.moveaxis(joined.pop("rigid"), 0, 1))
    place = {k: c.place for c in fitted for k in columns.of(c)}
    mine = [[i for i, at in enumerate(place.values()) if at == j] for j in range(robot.n_dof)]
    one = np.ones((features.shape[1], 1))
    return Rows(
        robot=robot,
        recordings=tuple(r.name for r in prepared.recordings),
        rigid=rigid,
        own=tuple(np.concatenate((one, features[j][:, i]), axis=1) for j, i in enumerate(mine)),
        shared=features[:, :, [i for i, at in enumerate(place.values()) if at is None]],
        rise=_rise(prepared),
        **joined,
    )


def _signals(
    columns: Columns,
    states: States,
    measured: torch.Tensor,
    fitted: Sequence[Candidate],
    pi: torch.Tensor,
    base: Sequence[int],
) -> dict[str, np.ndarray]:
    """Return the signals of a tile, band-limited, samples first; the features of terms in the order of x."""
    robot, signals = columns.robot, columns.signals(states)
    found = columns.evaluated(signals, fitted)
    Y = robot.regressor_batch_last(states.q, states.qd, states.qdd)
    features = torch.stack([v if v.ndim > 1 else v.expand(robot.n_dof, -1) for v in found.values()])
    out = {
        "q": states.q,
        "qd": states.qd,
        "qdd": states.qdd,
        "direction": torch.stack([signals.joint(j).direction() for j in range(robot.n_dof)]),
        "load": torch.einsum("jpn,p->jn", Y, pi),
        "tau": torch.nan_to_num(states.tau) * measured.unsqueeze(1),
        "rigid": Y[:, base],
        "features": features.transpose(0, 1),
    }
    return {name: states.decimate(x).movedim(-1, 0).numpy() for name, x in out.items()}


def _rise(prepared: Prepared) -> tuple[np.ndarray, np.ndarray]:
    step = 0.02 / prepared.filtering.cutoff_hz
    kernel = prepared.filtering.feature_kernel(step).numpy()
    half = len(kernel) // 2
    return step * (np.arange(-half, half + 2) - 0.5), np.concatenate(([0.0], np.cumsum(kernel)))
