"""Small regression problems with known truth, for the tests of this folder."""

from __future__ import annotations

import torch
from torch import Tensor


def normal(seed: int, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def problem(seed: int, n: int = 80, d: int = 6, noise: float = 0.5) -> tuple[Tensor, Tensor]:
    """Return correlated inputs of unequal scale and an output."""
    X = normal(seed, n, d) @ normal(seed + 1, d, d) * torch.logspace(-1.0, 1.0, d, dtype=torch.float64)
    return X, X @ normal(seed + 2, d) + noise * normal(seed + 3, n)


def rank_deficient(seed: int, n: int = 80) -> tuple[Tensor, Tensor]:
    """Return six inputs that span three dimensions, and an output."""
    X = normal(seed, n, 3) @ normal(seed + 1, 3, 6)
    return X, X @ normal(seed + 2, 6) + 0.1 * normal(seed + 3, n)


def with_factors(
    seed: int, n: int, factors: int, shared: int, single: int, snr: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return noisy inputs, output, noise variances and b: inputs that share factors, then independent ones."""
    L = normal(seed, factors, shared)
    clean = torch.cat((normal(seed + 1, n, factors) @ L, normal(seed + 2, n, single)), 1)
    b = torch.cat((normal(seed + 3, shared), normal(seed + 4, single)))
    noise = torch.cat((L.square().sum(0), torch.ones(single, dtype=torch.float64))) / snr
    y = clean @ b
    X = clean + normal(seed + 5, *clean.shape) * noise.sqrt()
    return X, y + 0.3 * y.std() * normal(seed + 6, n), noise, b


def noisy_inputs(seed: int, n: int = 60, d: int = 3) -> tuple[Tensor, Tensor]:
    """Return independent inputs with noise of variance .16, and an output."""
    T = normal(seed, n, d)
    y = T @ normal(seed + 1, d) + 0.5 * normal(seed + 2, n)
    return T + 0.4 * normal(seed + 3, n, d), y
