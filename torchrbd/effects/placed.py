"""Places on a robot where the coefficients of a whole-robot effect change some torque."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache

import torch
from torch import Tensor

from torchrbd.effects.base import Effect
from torchrbd.effects.signals import Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel

_STATES, _RANK_TOLERANCE = 32, 1e-6


@lru_cache(maxsize=64)
def moved(effect: Effect, robot: RobotModel, sites: tuple[Site, ...]) -> tuple[Site, ...]:
    """Return the sites at which at least one coefficient changes some torque."""
    return tuple(site for site in sites if any(phi.any() for phi in _features(effect, robot, site)))


@lru_cache(maxsize=64)
def telling(effect: Effect, robot: RobotModel, sites: tuple[Site, ...]) -> tuple[Site, ...]:
    """Return the sites at which all coefficients are identifiable from some motion.

    Counter-examples are a mass on the axis of the first joint, a moment that no joint takes, and the zero of a joint
    without gravity load. The test is the rank of the features at random states.
    """
    return tuple(site for site in sites if _has_full_rank(_features(effect, robot, site)))


def _features(effect: Effect, robot: RobotModel, site: Site) -> list[Tensor]:
    states = torch.randn(3, robot.n_dof, _STATES, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    signals = Signals(robot, *states, rest_width=torch.full((robot.n_dof,), 1e-3, dtype=torch.float64))
    return list(effect.features(signals, site, {}).values())


def in_windows(sites: Iterable[Site], windows: Iterable[Window]) -> tuple[Site, ...]:
    """Return every site in every window."""
    places = tuple(sites)
    return tuple(Site(s.joint, s.other, s.body, window) for window in windows for s in places)


def _has_full_rank(features: Sequence[Tensor]) -> bool:
    columns = torch.stack([phi.flatten() for phi in features], -1)
    size = columns.norm(dim=0)
    if bool((size <= _RANK_TOLERANCE * size.max().clamp_min(1.0)).any()):
        return False
    return int(torch.linalg.matrix_rank(columns / size, rtol=_RANK_TOLERANCE)) == columns.shape[1]
