"""The region of the data: the distance to the nearest of some points that cover it.

The unit of distance is the median distance of one window of the data from all others: how far a new motion of the same
kind may be. The region ends at twice that.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

EDGE = 2.0
"""Distance at which the region ends."""

_POINTS, _LOOKED_AT, _STRETCHES, _COVERED = 512, 8192, 8, 0.95


class Region(nn.Module):
    """A region in the space of network inputs.

        s(z) = min_k |z - c_k| / reach,    inside: s < EDGE
        fade(z) = 1 for s <= 1, 0 for s >= EDGE, smooth between

    Attributes:
        centres: (K, n_inputs) points c_k of the data, each as far from the others as can be; none before ``calibrate``,
            and everything is inside.
        reach: () unit of distance.
    """

    centres: Tensor
    reach: Tensor

    def __init__(self, n_inputs: int) -> None:
        super().__init__()
        self.register_buffer("centres", torch.zeros(0, n_inputs))
        self.register_buffer("reach", torch.ones(()))

    def forward(self, z: Tensor) -> Tensor:
        """Return how far inputs (*batch, n_inputs) are from the data, (*batch)."""
        # A root has no slope at zero.
        return (self._squared(z) + torch.finfo(z.dtype).eps ** 2).sqrt()

    def fade(self, z: Tensor) -> Tensor:
        """Return 1 in the middle of the region, 0 beyond it, (*batch)."""
        part = ((EDGE**2 - self._squared(z)) / (EDGE**2 - 1.0)).clamp(0.0, 1.0)
        return part * part * (3.0 - 2.0 * part)

    def calibrate(self, z: Tensor) -> None:
        """Cover the data: inputs z (N, n_inputs) in the order of time."""
        z = z.detach()[:: -(-len(z) // _LOOKED_AT)].to(torch.float64)
        chosen = _farthest(z, min(_POINTS, len(z)))
        stretch = torch.arange(len(z), device=z.device) * _STRETCHES // len(z)
        apart = torch.cdist(z, z[chosen])
        covered = apart.amin(1)
        others = apart.masked_fill(stretch.unsqueeze(1) == stretch[chosen], torch.inf).amin(1)
        others = torch.where(torch.isfinite(others), others, covered)
        reach = torch.maximum(covered.quantile(_COVERED), others.median())
        self.centres, self.reach = z[chosen].to(self.centres), reach.clamp_min(1e-6).to(self.reach)

    def _squared(self, z: Tensor) -> Tensor:
        if not len(self.centres):
            return z.new_zeros(z.shape[:-1])
        # In full precision: small differences of large numbers.
        with torch.autocast(z.device.type, enabled=False):
            centres = self.centres.to(z)
            between = z.square().sum(-1, keepdim=True) + centres.square().sum(-1) - 2.0 * z @ centres.mT
            return between.amin(-1).clamp_min(0.0) / self.reach.to(z).square()

    def _load_from_state_dict(self, state_dict, prefix, *args, **kwargs) -> None:
        # The number of centres is that of the data.
        given = state_dict.get(f"{prefix}centres")
        if given is not None and given.shape[1:] == self.centres.shape[1:]:
            self.centres = self.centres.new_zeros(given.shape)
        super()._load_from_state_dict(state_dict, prefix, *args, **kwargs)


def _farthest(z: Tensor, count: int) -> Tensor:
    """Return indices (count,) of points, each the farthest from those before it."""
    found = [int((z - z.mean(0)).square().sum(1).argmin())]
    left = (z - z[found[0]]).square().sum(1)
    for _ in range(count - 1):
        found.append(int(left.argmax()))
        left = torch.minimum(left, (z - z[found[-1]]).square().sum(1))
    return torch.tensor(found, device=z.device)
