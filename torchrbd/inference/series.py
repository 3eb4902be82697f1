"""Torques against time: as they were recorded, and as models predict that they were recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.reading import Progress, Reading
from torchrbd.inference.results import TorqueSeries
from torchrbd.model import RigidBodyDynamics
from torchrbd.recordings import States


def torque_series(
    reading: Reading,
    models: Mapping[str, RigidBodyDynamics],
    held_out: Callable[[str, Tensor], Tensor],
    progress: Progress = lambda *_: None,
) -> TorqueSeries:
    """Stream the recordings once more and predict every torque, as it was recorded, with every model.

    Args:
        reading: the recordings.
        models: by name; they know how the recordings were made.
        held_out: from a recording's name and times (M,) to which of these no fit has seen, bool.
        progress: called with the stage and the part of it that is done (0 to 1).
    """
    # Of no recordings, where only their moments are at hand, there is nothing to show.
    none, raw = np.empty((0, reading.robot.n_dof)), replace(reading, raw=True)
    parts = {"recording": [np.empty(0, dtype=int)], "t": [np.empty(0)], "held_out": [np.empty(0, dtype=bool)]}
    parts |= {key: [none] for key in ("q", "qd", "qdd", "measured")}
    predicted = {name: [none] for name in models}
    for k, recording in enumerate(raw.recordings):
        progress("predicting torques", k / len(raw.recordings))
        for states in raw.tiles(k):
            parts["recording"].append(np.full(len(states.t_out), k))
            parts["t"].append(states.t_out.numpy())
            parts["held_out"].append(held_out(recording.name, states.t_out).numpy())
            parts["measured"].append(_measured(states, raw.measured(k)))
            for key in ("q", "qd", "qdd"):
                parts[key].append(states.decimate(getattr(states, key)).T.numpy())
            for name, model in models.items():
                with torch.no_grad():
                    predicted[name].append(states.decimate(model.along(states)).T.numpy())
    joined = {key: np.concatenate(values) for key, values in parts.items()}
    return TorqueSeries(
        joints=tuple(reading.robot.joint_names),
        recordings=tuple(r.name for r in raw.recordings),
        predicted={name: np.concatenate(values) for name, values in predicted.items()},
        **joined,
    )


def held_out_spans(series: TorqueSeries) -> dict[str, tuple[tuple[float, float], ...]]:
    """Return by recording the spans (from, to) of time [s] whose rows are held out."""
    found = {}
    for k, name in enumerate(series.recordings):
        here = series.recording == k
        t, held = series.t[here], np.concatenate(([False], series.held_out[here], [False]))
        edges = np.flatnonzero(np.diff(held))
        half = 0.5 * float(np.median(np.diff(t))) if len(t) > 1 else 0.0
        found[name] = tuple(
            (float(t[a]) - half, float(t[b - 1]) + half) for a, b in zip(edges[::2], edges[1::2], strict=True)
        )
    return found


def _measured(states: States, measured: Tensor) -> np.ndarray:
    """Return the torque of a tile's outputs (M, n_dof), NaN where none is ``measured`` (n_dof,)."""
    tau = torch.nan_to_num(states.tau)
    torque = states.decimate_torque(tau if states.known is None else tau + states.as_recorded(states.known))
    return torch.where(measured.unsqueeze(1), torque, torch.nan).T.numpy()
