"""What the smoother keeps of a recording: stretches of some hundred torque samples, encoder data reduced to a spline.

Encoder noise is white and linear in the spline, so that its least squares fit c0 and B'B hold all the information of
the positions on the coefficients c:  |q_m - B c|^2 = misfit + (c - c0)' B'B (c - c0).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import torch
from scipy.linalg import solveh_banded
from torch import Tensor

from torchrbd.inference.smoothing.spline import Grid
from torchrbd.recordings import Filtering, Recording, States, Survey, uniform_blocks

_MOST_KNOTS = 300
# Motion of 1 Hz has ten knots a cycle, and harmonics up to 16 Hz are evaluated without aliasing.
_LONGEST_KNOT_S, _LONGEST_STEP_S = 0.1, 0.03
SAMPLES_PER_KNOT = 4
_SURELY = 4.0
_BANDWIDTH = 3


@dataclass(frozen=True)
class Stretch:
    """A piece of an uninterrupted segment.

    Attributes:
        segment: of the recording.
        grid: the knots.
        tau: (O, n) band-limited torque, [N m] or [N].
        counts: (O, n) number of independent samples that each represents; zero where unmeasured or held out.
        bands: (4, K) the diagonals of B'B, of one joint: the main one first.
        encoder: c0 (K, n), the spline closest to the positions.
        misfit: (n,) squared distance that it leaves, [rad^2] or [m^2].
        samples: number of encoder samples.
    """

    segment: int
    grid: Grid
    tau: Tensor
    counts: Tensor
    bands: Tensor
    encoder: Tensor
    misfit: Tensor
    samples: int

    @property
    def gram(self) -> Tensor:
        """B'B (K, K)."""
        upper = torch.stack([torch.diag(band[: len(band) - k], k) for k, band in enumerate(self.bands)]).sum(0)
        return upper + upper.triu(1).T


def knots_per_output(dt_out: float) -> int:
    """Return the knots that a torque sample every dt_out [s] needs at least."""
    return math.ceil(dt_out / _LONGEST_KNOT_S - 1e-6)


def stretches(
    recording: Recording,
    survey: Survey,
    filtering: Filtering,
    tiles: Iterable[States],
    counted: Callable[[Tensor], Tensor],
) -> tuple[Stretch, ...]:
    """Cut a recording into stretches, with as few knots as the motion allows.

    Args:
        recording, survey, filtering: the data.
        tiles: its states, of which the band-limited torque is used.
        counted: returns for times (O,) which torques (O, n) count, bool.
    """
    torques: dict[int, list[tuple[Tensor, Tensor]]] = {}
    step = 0.0
    for states in tiles:
        step = states.dt_out
        tau = states.decimate_torque(torch.nan_to_num(states.tau)).T
        torques.setdefault(states.segment, []).append((states.t_out, tau))
    few = knots_per_output(step)
    # as many evaluations between any two knots, of the finer splines too
    substeps = 2 * few * math.ceil(step / (2 * few * _LONGEST_STEP_S) - 1e-6)
    kernel = filtering.feature_kernel_at(survey.clock.dt, step / substeps, substeps)
    roomy = filtering.stride(survey.clock.dt) >= SAMPLES_PER_KNOT * 2 * few
    coarse, fine = [], []
    for segment, t, q in _positions(recording, survey):
        for t_out, tau in _parts(torques.get(segment, []), max(1, _MOST_KNOTS // few)):
            start = float(t_out[0]) - (len(kernel) // 2) * step / substeps
            counts = counted(t_out) * filtering.effective_rate * step
            for per_output, found in ((few, coarse), (2 * few, fine))[: 1 + roomy]:
                grid = Grid(start, step, per_output, substeps, len(t_out), kernel)
                inside = (t >= grid.start - 1e-9) & (t <= grid.end + 1e-9)
                spline_fit = _least_squares(grid, t[inside], q[:, inside])
                found.append(Stretch(segment, grid, tau, counts, *spline_fit))
    return tuple(fine if roomy and _bends(coarse, fine) else coarse)


def _bends(coarse: list[Stretch], fine: list[Stretch]) -> bool:
    """Say whether a motion has more between the knots of the coarse splines than noise: an F test of each joint."""
    more = sum(s.grid.n_coefficients for s in fine) - sum(s.grid.n_coefficients for s in coarse)
    left = sum(s.samples - s.grid.n_coefficients for s in fine)
    noise = torch.stack([s.misfit for s in fine]).sum(0) / left
    gained = (torch.stack([s.misfit for s in coarse]).sum(0) - noise * left) / more
    return bool((gained > (1 + _SURELY * (2 / more) ** 0.5) * noise).any())


def _parts(tiles: list[tuple[Tensor, Tensor]], outputs: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield times (O,) and torques (O, n) of a segment in parts of equal length."""
    if tiles:
        t, tau = (torch.cat(pieces) for pieces in zip(*tiles, strict=True))
        yield from zip(t.split(outputs), tau.split(outputs), strict=True)


def _positions(recording: Recording, survey: Survey) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Yield the segments: number, t (N,), q (n, N)."""
    n = len(recording.joints)
    for number, blocks in groupby(uniform_blocks(recording, survey.clock), lambda block: block.segment):
        parts = [(block.t, block.x[:n]) for block in blocks]
        yield number, np.concatenate([t for t, _ in parts]), np.concatenate([q for _, q in parts], axis=1)


def _least_squares(grid: Grid, t: np.ndarray, q: np.ndarray) -> tuple[Tensor, Tensor, Tensor, int]:
    basis = grid.sample_basis(t)
    gram = basis.T @ basis
    bands = np.stack([np.append(gram.diagonal(k), np.zeros(k)) for k in range(_BANDWIDTH + 1)])
    c = solveh_banded(bands, basis.T @ q.T, lower=True)
    misfit = np.sum((q.T - basis @ c) ** 2, axis=0)
    return torch.from_numpy(bands), torch.from_numpy(c).contiguous(), torch.from_numpy(misfit), len(t)
