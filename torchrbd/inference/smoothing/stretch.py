"""What the smoother keeps of a recording: stretches of some hundred torque samples, encoder data reduced to a spline.

Encoder noise is white and linear in the spline, so that its least squares fit c0 and B'B hold all that the positions
say of the coefficients c:  |q_m - B c|^2 = misfit + (c - c0)' B'B (c - c0).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import torch
from scipy.linalg import solveh_banded
from torch import Tensor

from torchrbd.inference.smoothing.spline import Grid
from torchrbd.recordings import Filtering, Recording, States, Survey, uniform_blocks

_MOST_OUTPUTS = 500
_BANDWIDTH = 3


@dataclass(frozen=True)
class Stretch:
    """A piece of an uninterrupted segment.

    Attributes:
        segment: of the recording.
        grid: the knots.
        tau: (O, n) band-limited torque, [N m] or [N].
        counts: (O, n) independent samples that each stands for; zero where unmeasured or kept back.
        gram: B'B (K, K), of one joint.
        encoder: c0 (K, n), the spline closest to the positions.
        misfit: (n,) squared distance that it leaves, [rad^2] or [m^2].
        samples: number of encoder samples.
    """

    segment: int
    grid: Grid
    tau: Tensor
    counts: Tensor
    gram: Tensor
    encoder: Tensor
    misfit: Tensor
    samples: int


def stretches(
    recording: Recording,
    survey: Survey,
    filtering: Filtering,
    tiles: Iterable[States],
    counted: Callable[[Tensor], Tensor],
) -> Iterator[Stretch]:
    """Cut a recording into stretches.

    Args:
        recording, survey, filtering: the data.
        tiles: its states, of which the band-limited torque is used.
        counted: tells for times (O,) which torques (O, n) count, bool.
    """
    torques: dict[int, list[tuple[Tensor, Tensor]]] = {}
    spacing = 0.0
    for states in tiles:
        spacing = states.dt_out
        tau = states.decimate(torch.nan_to_num(states.tau)).T
        torques.setdefault(states.segment, []).append((states.t_out, tau))
    kernel = filtering.feature_kernel_at(survey.clock.dt, 0.5 * spacing)
    for segment, t, q in _positions(recording, survey):
        if segment not in torques:
            continue
        t_out, tau = (torch.cat(parts) for parts in zip(*torques.pop(segment), strict=True))
        for t_part, tau_part in zip(t_out.split(_MOST_OUTPUTS), tau.split(_MOST_OUTPUTS), strict=True):
            start = float(t_part[0]) - 0.25 * (len(kernel) - 1) * spacing
            grid = Grid(start, spacing, len(t_part), kernel)
            inside = (t >= grid.start - 1e-9) & (t <= grid.end + 1e-9)
            counts = counted(t_part) * filtering.effective_rate * spacing
            yield Stretch(segment, grid, tau_part, counts, *_least_squares(grid, t[inside], q[:, inside]))


def _positions(recording: Recording, survey: Survey) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Yield the segments: number, t (N,), q (n, N)."""
    n = len(recording.joints)
    for number, blocks in groupby(uniform_blocks(recording, survey.clock), lambda block: block.segment):
        parts = [(block.t, block.x[:n]) for block in blocks]
        yield number, np.concatenate([t for t, _ in parts]), np.concatenate([q for _, q in parts], axis=1)


def _least_squares(grid: Grid, t: np.ndarray, q: np.ndarray) -> tuple[Tensor, Tensor, Tensor, int]:
    basis = grid.sample_basis(t)
    gram = (basis.T @ basis).toarray()
    bands = np.stack([np.append(np.zeros(k), gram.diagonal(k)) for k in range(_BANDWIDTH, -1, -1)])
    c = solveh_banded(bands, basis.T @ q.T)
    misfit = np.sum((q.T - basis @ c) ** 2, axis=0)
    return torch.from_numpy(gram).contiguous(), torch.from_numpy(c).contiguous(), torch.from_numpy(misfit), len(t)
