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

_MOST_OUTPUTS = 300
_SAMPLES_PER_KNOT = 2
_SURELY = 4.0
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
) -> tuple[Stretch, ...]:
    """Cut a recording into stretches, with one knot to a torque sample, or two if the motion needs them.

    Args:
        recording, survey, filtering: the data.
        tiles: its states, of which the band-limited torque is used.
        counted: tells for times (O,) which torques (O, n) count, bool.
    """
    torques: dict[int, list[tuple[Tensor, Tensor]]] = {}
    step = 0.0
    for states in tiles:
        step = states.dt_out
        tau = states.decimate(torch.nan_to_num(states.tau)).T
        torques.setdefault(states.segment, []).append((states.t_out, tau))
    kernel = filtering.feature_kernel_at(survey.clock.dt, 0.5 * step)
    roomy = filtering.stride(survey.clock.dt) >= 2 * _SAMPLES_PER_KNOT
    coarse, fine = [], []
    for segment, t, q in _positions(recording, survey):
        for t_out, tau in _parts(torques.get(segment, [])):
            start = float(t_out[0]) - 0.25 * (len(kernel) - 1) * step
            counts = counted(t_out) * filtering.effective_rate * step
            for per_output, found in ((1, coarse), (2, fine))[: 1 + roomy]:
                grid = Grid(start, step, per_output, len(t_out), kernel)
                inside = (t >= grid.start - 1e-9) & (t <= grid.end + 1e-9)
                told = _least_squares(grid, t[inside], q[:, inside])
                found.append(Stretch(segment, grid, tau, counts, *told))
    return tuple(fine if roomy and _bends(coarse, fine) else coarse)


def _bends(coarse: list[Stretch], fine: list[Stretch]) -> bool:
    """Say whether a motion has more between the knots of the coarse splines than noise: an F test of each joint."""
    more = sum(s.grid.n_coefficients for s in fine) - sum(s.grid.n_coefficients for s in coarse)
    left = sum(s.samples - s.grid.n_coefficients for s in fine)
    noise = torch.stack([s.misfit for s in fine]).sum(0) / left
    gained = (torch.stack([s.misfit for s in coarse]).sum(0) - noise * left) / more
    return bool((gained > (1 + _SURELY * (2 / more) ** 0.5) * noise).any())


def _parts(tiles: list[tuple[Tensor, Tensor]]) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield times (O,) and torques (O, n) of a segment in parts of equal length."""
    if tiles:
        t, tau = (torch.cat(pieces) for pieces in zip(*tiles, strict=True))
        yield from zip(t.split(_MOST_OUTPUTS), tau.split(_MOST_OUTPUTS), strict=True)


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
