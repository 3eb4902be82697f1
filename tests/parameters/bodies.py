"""Random rigid bodies made of point masses, and what makes one physical, in plain numpy."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def random_bodies(seed: int, count: int, *, size: float = 1.0) -> Tensor:
    """Return (count, 10) parameters of bodies of eight random point masses each; ``size`` is their extent in metres."""
    rng = np.random.default_rng(seed)
    mass = rng.uniform(0.1, 1.0, (count, 8)) * size**3
    point = size * (rng.normal(size=(count, 8, 3)) + rng.normal(size=(count, 1, 3)))
    return torch.from_numpy(np.stack([from_points(m, p) for m, p in zip(mass, point, strict=True)]))


def from_points(mass: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the parameters (10,) of point masses (k,) at (k, 3)."""
    inertia = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(mass, point, strict=True))
    return np.concatenate(([mass.sum()], mass @ point, inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]))


def central_moments(pi: np.ndarray) -> np.ndarray:
    """Return the principal moments (3,) of inertia about the centre of mass, ascending."""
    m, h = pi[0], pi[1:4]
    xx, xy, yy, xz, yz, zz = pi[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return np.linalg.eigvalsh(about_origin - (h @ h * np.eye(3) - np.outer(h, h)) / m)


def by_hand(pi: Tensor) -> np.ndarray:
    """Say which bodies (n, 10) have mass, positive principal moments, and fulfil the triangle inequality."""
    found = []
    for body in pi.numpy():
        if body[0] <= 0:
            found.append(False)
            continue
        small, middle, large = central_moments(body)
        found.append(bool(small > 0 and small + middle > large))
    return np.array(found)
