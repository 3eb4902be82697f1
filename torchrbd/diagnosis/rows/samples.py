"""Torques, regressor, states and the features of any candidate, band-limited alike and kept in memory.

Block statistics serve what is known beforehand. A shape that is refined, or an interval of tenths of a second, needs
rows: features are computed when they are needed. Long recordings are thinned: parts that are spread over all of them
are read here; the fit that follows reads everything.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch

from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.dataset.rows import Tile
from torchrbd.dataset.spreading import Density
from torchrbd.inference.preparation import Prepared

_DENSITY = Density(most_states=100_000, least_rate_hz=100.0, rate_cycles=12.0)


@dataclass(frozen=True)
class Samples:
    """M band-limited samples of a robot with n joints; those in held-out blocks are not among them.

    Attributes:
        columns: of the robot; their ``pi`` makes the load, to which their ``friction`` is added.
        tiles: where features come from.
        recordings: names.
        rigid: (n, M, n_params) regressor.
        tau: (n, M) measured torque less the URDF's friction; 0 where ``measured`` (n, M) is not.
        q, qd, qdd, direction: (n, M) band-limited states, and sign(qd).
        weight: (n, M) root of a sample's weight, 0 to 1: less where a joint may stick.
        run: (M,) number of the uninterrupted run that a sample belongs to.
        block: (M,) number of the block of statistics that it belongs to.
        recording: (M,) index into ``recordings``.
        t: (M,) seconds since that recording's start.
        rise: a step at time zero as it looks behind the filter of all torques: times (R,) [s] and heights (R,).
        whole_folds: whether whole recordings may be left out together. If not, parts of each are: of what acts in one
            only, the others say nothing.
    """

    columns: Columns
    tiles: tuple[Tile, ...]
    recordings: tuple[str, ...]
    rigid: np.ndarray
    tau: np.ndarray
    measured: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    direction: np.ndarray
    weight: np.ndarray
    run: np.ndarray
    block: np.ndarray
    recording: np.ndarray
    t: np.ndarray
    rise: tuple[np.ndarray, np.ndarray]
    whole_folds: bool = True
    _known: dict[tuple[Any, ...], np.ndarray] = field(default_factory=dict)

    def features(self, candidate: Candidate) -> np.ndarray:
        """Return the features of a candidate, (K, M) at its joint, or (K, n, M) if it acts on the whole robot."""
        key = candidate.effect, candidate.site, *candidate.shape.items()
        if key not in self._known:
            self._known[key] = self.evaluated(candidate)
        return self._known[key]

    def evaluated(self, candidate: Candidate) -> np.ndarray:
        """Return the same without remembering it."""
        parts = []
        for tile in self.tiles:
            found = torch.stack(list(candidate.features(tile.signals).values()))
            parts.append(tile.states.decimate(found)[..., tile.kept].numpy())
        return np.concatenate(parts, axis=-1)

    @property
    def seen(self) -> list[bool]:
        """Which joints have a torque, (n,)."""
        return [bool(m.any()) for m in self.measured]

    def supplied(self, pi: torch.Tensor, friction: torch.Tensor | None) -> np.ndarray:
        """Return the torque (n, M) of a rigid body with pi (n_params,) and of friction (n, 3)."""
        load = self.rigid @ pi.numpy()
        if friction is None:
            return load
        viscous, coulomb, offset = friction.T.numpy()[..., None]
        return load + viscous * self.qd + coulomb * self.direction + offset

    def sticking(self, levels: torch.Tensor) -> Samples:
        """Return the same samples weighed for joints whose dry friction has these levels (n,), see ``Columns``."""
        return self._counted(self.columns.sticking(levels))

    def _counted(self, columns: Columns) -> Samples:
        parts = [columns.weight(tile.states).sqrt()[:, tile.kept].numpy() for tile in self.tiles]
        return replace(self, columns=columns, weight=np.concatenate(parts, axis=1))

    def around(self, pi: torch.Tensor, friction: torch.Tensor | None = None) -> Samples:
        """Return the same samples with the torque of pi (n_params,) as load, and friction (n, 3)."""
        columns = self.columns.of_candidates((), pi, friction)
        most = np.abs(self.supplied(pi, friction)).max(1)
        columns = columns.at_scales([replace(s, load_max=float(v)) for s, v in zip(columns.scales, most, strict=True)])
        tiles = tuple(replace(tile, signals=columns.signals(tile.states)) for tile in self.tiles)
        known = {key: f for key, f in self._known.items() if not key[0].uses_load}
        return replace(self, columns=columns, tiles=tiles, _known=known)


def read_samples(prepared: Prepared, pi: torch.Tensor) -> Samples:
    """Stream the recordings once and keep what searching and locating need.

    Args:
        prepared: the data.
        pi: (n_params,) inertial parameters whose torque is the load.
    """
    columns = prepared.columns.of_candidates((), pi)
    friction = columns.reference()
    friction[: prepared.robot.n_params] = 0.0
    tiles: list[Tile] = []
    parts: list[dict[str, np.ndarray]] = []
    for k, states in _DENSITY.tiles(prepared.reading):
        kept = ~prepared.kept_back(states.recording, states.t_out)
        if not kept.any():
            continue
        measured = prepared.measured(k).unsqueeze(1)
        known = columns.term_torque(columns.signals(states), friction)
        tau = states.decimate(torch.where(measured, torch.nan_to_num(states.tau) - known, 0.0))
        states = _DENSITY.thinned(states, prepared.filtering.cutoff_hz)
        tile = Tile(states, columns.signals(states), kept)
        tiles.append(tile)
        outputs = {"tau": tau, "measured": measured.expand_as(tau), **_signals(columns, tile)}
        outputs["weight"] = columns.weight(states).sqrt()
        part = {name: x[:, kept].numpy() for name, x in outputs.items()}
        of = torch.tensor([k, states.segment, states.dt_out], dtype=torch.float64)
        part["place"] = torch.cat((states.t_out[kept, None], of.expand(int(kept.sum()), 3)), 1).numpy()
        parts.append(part)
    joined = {name: np.concatenate([p[name] for p in parts], axis=int(name != "place")) for name in parts[0]}
    t, recording, segment, dt = joined.pop("place").T
    begins = (np.diff(t, prepend=-np.inf) > 1.5 * dt) | (np.diff(recording, prepend=-1) != 0)
    begins |= (np.diff(segment, prepend=-1) != 0) | (np.diff(t, prepend=0.0) < 0)
    places = np.stack((recording, np.floor(t / prepared.reading.block_s)), axis=1)
    load = np.abs(joined["rigid"] @ pi.numpy()).max(1)
    scales = [replace(s, load_max=float(most)) for s, most in zip(columns.scales, load, strict=True)]
    return Samples(
        columns=columns.at_scales(scales),
        tiles=tuple(tiles),
        recordings=tuple(r.name for r in prepared.recordings),
        run=np.cumsum(begins),
        block=np.unique(places, axis=0, return_inverse=True)[1].ravel(),
        recording=recording.astype(int),
        t=t,
        rise=_rise(prepared),
        **joined,  # type: ignore[arg-type]
    )


def _signals(columns: Columns, tile: Tile) -> dict[str, torch.Tensor]:
    """Return what rows show of a tile, (n, M, ...)."""
    states = tile.states
    direction = torch.stack([tile.signals.joint(j).direction() for j in range(columns.robot.n_dof)])
    Y = columns.robot.regressor_batch_last(states.q, states.qd, states.qdd)
    plain = {"q": states.q, "qd": states.qd, "qdd": states.qdd, "direction": direction}
    return {"rigid": states.decimate(Y).movedim(1, 2), **{name: states.decimate(x) for name, x in plain.items()}}


def _rise(prepared: Prepared) -> tuple[np.ndarray, np.ndarray]:
    step = 0.02 / prepared.filtering.cutoff_hz
    kernel = prepared.filtering.feature_kernel(step).numpy()
    half = len(kernel) // 2
    return step * (np.arange(-half, half + 2) - 0.5), np.concatenate(([0.0], np.cumsum(kernel)))
