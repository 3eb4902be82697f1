"""Block statistics: second moments per joint and block of time, sufficient to fit and compare models.

    A_jb = sum over the samples of block b of  a a',   a = [Y_j, phi_j, tau_j]

One pass over the recordings builds them; afterwards nothing costs more than O(P^3), for any length. Blocks add, and
leaving blocks out is subtraction. Weights make ``counts`` the number of *independent* samples: a torque with band limit
f_c has 2 f_c of them per second, for any sampling rate. Samples in which a joint may stick have smaller weights
(``sticking.py``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.columns import Columns
from torchrbd.recordings import States

# Number of blocks per recording for which memory is first allocated.
_FIRST_BLOCKS = 64


@dataclass(frozen=True)
class Block:
    """A window of time in one recording, in seconds from its start."""

    recording: str
    start_s: float
    end_s: float


@dataclass(frozen=True)
class BlockStatistics:
    """Moments of B blocks.

    Attributes:
        columns: which columns of x each joint has.
        blocks: (B,) recording and time of each block.
        moments: per joint (B, p_j + 1, p_j + 1); the last row and column are the torque.
        torque: (B, n_dof, 3): weight (independent samples), sum and sum of squares of the measured torque, without the
            known torque unless it is asked for; zero where not measured.
    """

    columns: Columns
    blocks: tuple[Block, ...]
    moments: tuple[Tensor, ...]
    torque: Tensor

    def __len__(self) -> int:
        return len(self.blocks)

    def __add__(self, other: BlockStatistics) -> BlockStatistics:
        """Join the blocks of two sets of recordings."""
        moments = tuple(torch.cat(pair) for pair in zip(self.moments, other.moments, strict=True))
        return replace(
            self,
            blocks=self.blocks + other.blocks,
            moments=moments,
            torque=torch.cat((self.torque, other.torque)),
        )

    def select(self, keep: Tensor) -> BlockStatistics:
        """Return the blocks that ``keep`` (bool, (B,)) marks."""
        return replace(
            self,
            blocks=tuple(block for block, kept in zip(self.blocks, keep.tolist(), strict=True) if kept),
            moments=tuple(m[keep] for m in self.moments),
            torque=self.torque[keep],
        )

    def together(self, keep: Tensor) -> BlockStatistics:
        """Return the blocks that ``keep`` (bool, (B,)) marks as one, which suffices for a fit without its scatter."""
        first = [block for block, kept in zip(self.blocks, keep.tolist(), strict=True) if kept][:1]
        part = keep.to(self.torque)
        torque, *moments = (torch.tensordot(part, x, 1).unsqueeze(0) for x in (self.torque, *self.moments))
        return replace(self, blocks=tuple(first), moments=tuple(moments), torque=torque)

    def total(self) -> list[Tensor]:
        """Return per joint the sum of the moments of all blocks, (p_j + 1, p_j + 1)."""
        return [m.sum(0) for m in self.moments]

    def coarsened(self, limit: int) -> BlockStatistics:
        """Merge neighbours of the same recording until at most ``limit`` blocks remain (or one per recording)."""
        times = halvings(self.blocks, limit)
        if not times:
            return self
        blocks, (*moments, torque) = halved(self.blocks, (*self.moments, self.torque), times)
        return replace(self, blocks=blocks, moments=tuple(moments), torque=torque)

    def squared_error(self, x: Tensor) -> Tensor:
        """Return the weighted sum of squared torque errors of coefficients x (n,): (B, n_dof), [(N m)^2] or [N^2]."""
        errors = []
        for joint, moments in enumerate(self.moments):
            v = torch.cat((-x[self.columns.of_joint[joint]], x.new_ones(1)))
            errors.append(((moments @ v) * v).sum(-1))
        return torch.stack(errors, -1).clamp_min(0.0)

    def added(self, x: Tensor, without: Tensor) -> tuple[Tensor, Tensor]:
        """Return products of the torque of x (n,) with the residual of ``without`` (n,), and with itself.

        Returns:
            weighted sums, (B, n_dof) each, [(N m)^2] or [N^2].
        """
        left, square = [], []
        for own, moments in zip(self.columns.of_joint, self.moments, strict=True):
            more = moments @ torch.cat(((x - without)[own], x.new_zeros(1)))
            left.append(more @ torch.cat((-without[own], x.new_ones(1))))
            square.append(more[:, :-1] @ (x - without)[own])
        return torch.stack(left, -1), torch.stack(square, -1)

    def scores(self, x: Tensor, weights: Tensor) -> Tensor:
        """Return sum_j w_j A_jb (tau - x), the score of each block at coefficients x (n,), (B, n)."""
        found = torch.zeros(len(self), self.columns.n, dtype=torch.float64)
        for own, moments, weight in zip(self.columns.of_joint, self.moments, weights.tolist(), strict=True):
            found[:, own] += weight * (moments @ torch.cat((-x[own], x.new_ones(1))))[:, :-1]
        return found

    def torque_variance(self) -> Tensor:
        """Return the variance of the measured torque over all blocks, (n_dof,)."""
        weight, first, second = self.torque.sum(0).unbind(-1)
        weight = weight.clamp_min(1e-300)
        return second / weight - (first / weight) ** 2


def nearest_block(blocks: Sequence[Block], recording: str, t: Tensor) -> Tensor:
    """Return the index of the recording's block that is nearest to each time (N,); -1 if it has none.

    Another filter may have outputs between the blocks and beyond them.
    """
    own = sorted((block.start_s, block.end_s, k) for k, block in enumerate(blocks) if block.recording == recording)
    if not own:
        return torch.full((len(t),), -1)
    starts, ends, numbers = zip(*own, strict=True)
    between = [0.5 * (end + start) for end, start in zip(ends[:-1], starts[1:], strict=True)]
    return torch.tensor(numbers)[torch.bucketize(t.contiguous(), torch.tensor(between, dtype=t.dtype))]


def assemble(columns: Columns, totals: Sequence[Tensor], weights: Tensor) -> tuple[Tensor, Tensor]:
    """Return the normal equations H = sum_j w_j A_j (n, n) and h = sum_j w_j a_j' tau_j (n,).

    Args:
        columns: the layout of x.
        totals: per joint, summed moments (p_j + 1, p_j + 1).
        weights: (n_dof,) inverse noise variances.
    """
    H = torch.zeros(columns.n, columns.n, dtype=torch.float64)
    h = torch.zeros(columns.n, dtype=torch.float64)
    for own, moments, weight in zip(columns.of_joint, totals, weights.tolist(), strict=True):
        H[own.unsqueeze(1), own] += weight * moments[:-1, :-1]
        h[own] += weight * moments[:-1, -1]
    return H, h


def halvings(blocks: Sequence[Block], limit: int) -> int:
    """Return how often to merge pairs of neighbours until at most ``limit`` blocks remain, or one per recording."""
    counts = list(Counter(block.recording for block in blocks).values())
    times = 0
    while sum(counts) > limit and max(counts) > 1:
        counts, times = [(count + 1) // 2 for count in counts], times + 1
    return times


def halved(blocks: Sequence[Block], sums: Sequence[Tensor], times: int) -> tuple[tuple[Block, ...], tuple[Tensor, ...]]:
    """Merge pairs of neighbours of the same recording, ``times`` times, and add their sums, (B, ...) each."""
    for _ in range(times):
        blocks, sums = _halved(blocks, sums)
    return tuple(blocks), tuple(sums)


def _halved(blocks: Sequence[Block], sums: Sequence[Tensor]) -> tuple[tuple[Block, ...], tuple[Tensor, ...]]:
    pairs: list[list[Block]] = []
    target = []
    for block in blocks:
        if pairs and len(pairs[-1]) == 1 and pairs[-1][0].recording == block.recording:
            pairs[-1].append(block)
        else:
            pairs.append([block])
        target.append(len(pairs) - 1)
    index = torch.tensor(target, dtype=torch.long)
    merged = tuple(Block(pair[0].recording, pair[0].start_s, pair[-1].end_s) for pair in pairs)
    return merged, tuple(x.new_zeros(len(pairs), *x.shape[1:]).index_add_(0, index, x) for x in sums)


def block_statistics(
    columns: Columns,
    recording: str,
    tiles: Iterable[States],
    measured: Tensor,
    *,
    block_s: float,
    independent_rate_hz: float,
    known_too: bool = False,
) -> BlockStatistics:
    """Stream one recording into block statistics.

    Args:
        columns: the layout of x.
        recording: its name.
        tiles: states, tile by tile.
        measured: (n_dof,) bool, the joints whose torque counts.
        block_s: length of a block, [s].
        independent_rate_hz: independent samples per second, 2 f_c.
        known_too: whether ``torque`` includes the known torque, which is subtracted before a fit.
    """
    # Blocks in order of appearance, with memory for more: large moments are written once, in place.
    found, places = list[Block](), dict[tuple[int, int], int]()
    sizes = [len(own) + 1 for own in columns.of_joint]
    # Numpy's zeros take no memory until they are written.
    moments = [torch.from_numpy(np.zeros((_FIRST_BLOCKS, p, p))) for p in sizes]
    sums = torch.zeros(_FIRST_BLOCKS, len(sizes), 3, dtype=torch.float64)
    for states in tiles:
        rows, torque = filtered_rows(columns, states)
        if known_too:
            torque = torque + states.decimate(states.taken_off(columns.robot))
        weights = independent_rate_hz * states.dt_out * columns.weight(states) * measured.unsqueeze(1)
        number = (states.t_out / block_s).floor().long()
        for b in number.unique().tolist():
            here = number == b
            w, tau = weights[:, here], torque[:, here]
            start, end = float(states.t_out[here][0]), float(states.t_out[here][-1])
            k = places.setdefault((states.segment, b), len(found))
            if k == len(sums):
                sums, *moments = (torch.cat((x, torch.zeros_like(x))) for x in (sums, *moments))
            for own, row, w_j in zip(moments, rows, w, strict=True):
                inside = row[:, here]
                own[k].addmm_(inside * w_j, inside.T)
            sums[k] += torch.stack((w.sum(1), (w * tau).sum(1), (w * tau.square()).sum(1)), -1)
            if k == len(found):
                found.append(Block(recording, start, end))
            else:
                found[k] = replace(found[k], end_s=end)
    n = len(found)
    return BlockStatistics(columns, tuple(found), tuple(m[:n] for m in moments), sums[:n])


def filtered_rows(columns: Columns, states: States) -> tuple[list[Tensor], Tensor]:
    """Return the band-limited rows [Y_j, phi_j, tau_j] of each joint, (p_j + 1, M), and the torque (n_dof, M)."""
    Y, more = columns.bodies(states)
    tau = states.decimate_torque(torch.nan_to_num(states.tau))
    explained = tau if more is None else tau + states.decimate(more)
    features, rows = columns.features(states), []
    for joint in range(columns.robot.n_dof):
        own = torch.cat((Y[joint, columns.inertial[joint]], features[joint]))
        rows.append(torch.cat((states.decimate(own), explained[joint : joint + 1])))
    return rows, tau
