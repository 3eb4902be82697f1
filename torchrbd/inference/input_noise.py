"""Whether noise of the positions matters: it is propagated through filter, regressor and fit.

    d_b = V Y~_b'W (Y_b - Y~_b) x,   Y~ = Y(s + e),   e the encoder's noise after the state filter

d_b is how far the noise of block b moves a fit of covariance V. Over N blocks its mean mu, from noise times noise, adds
up to a bias, and its scatter S to an error: together |N mu|^2 + N tr S, in the metric V^-1 of the fit. With known
states the error would be tr(V Y'W(1 - share)Y), from torque noise alone. A bias does not shrink as a recording grows,
the others do. V is that of the noisy fit; a large excess is therefore underestimated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchrbd._runtime.filters import convolved
from torchrbd.dataset.block_statistics import BlockStatistics, assemble, filtered_rows
from torchrbd.dataset.columns import Columns
from torchrbd.dataset.reading import Reading
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.recordings import Filtering, States, Survey

_MOST_TILES = 4
_MATTERS = 1.2
# Of the residuals, at least this part is torque noise.
_LEAST_LEFT = 1e-3


@dataclass(frozen=True)
class InputNoise:
    """What position noise does to torques and to a fit on filtered states.

    Attributes:
        encoder_std: (n_dof,) standard deviation of the positions, [rad] or [m].
        torque_std: (n_dof,) of the band-limited torque predicted from filtered states, [N m] or [N].
        share: (n_dof,) of the residual variance that this explains.
        excess: squared error of the fitted parameters over what it would be with known states; errors in units of the
            fit's covariance.
        columns_gram: per joint the noise of its columns, E[dY'dY] summed over all independent samples (p_j, p_j).
    """

    encoder_std: Tensor
    torque_std: Tensor
    share: Tensor
    excess: float
    columns_gram: tuple[Tensor, ...]

    @property
    def matters(self) -> bool:
        """Whether position noise adds more than a fifth to the squared error."""
        return self.excess > _MATTERS


def input_noise(
    reading: Reading, columns: Columns, statistics: BlockStatistics, model: FittedModel, seed: int = 0
) -> InputNoise:
    """Send noise through the chain on some tiles.

    Args:
        reading: the recordings.
        columns: layout of x.
        statistics: the blocks that ``model`` was fitted to.
        model: a fit on filtered states.
        seed: of the noise drawn.
    """
    generator = torch.Generator().manual_seed(seed)
    noise = [torch.zeros(len(own), len(own), dtype=torch.float64) for own in columns.of_joint]
    square, weight = torch.zeros(columns.robot.n_dof, dtype=torch.float64), 0.0
    scores: list[Tensor] = []
    fitted = {block.recording for block in statistics.blocks}
    used = [k for k, recording in enumerate(reading.recordings) if recording.name in fitted]
    for k, states in _some_tiles(reading, used):
        rows, _ = filtered_rows(columns, states)
        shaken, _ = filtered_rows(columns, _shaken(states, reading.surveys[k], reading.filtering, generator))
        independent = reading.filtering.effective_rate * states.dt_out
        weight += independent * len(states.t_out)
        gradient = torch.zeros(columns.n, len(states.t_out), dtype=torch.float64)
        for joint, own in enumerate(columns.of_joint):
            change = shaken[joint][:-1] - rows[joint][:-1]
            missing = -model.x[own] @ change
            noise[joint] += independent * change @ change.T
            square[joint] += independent * missing.square().sum()
            if reading.measured(k)[joint]:
                gradient[own] += independent / model.noise_variance[joint] * shaken[joint][:-1] * missing
        scores += [part.sum(1) for part in gradient.split(max(1, round(reading.block_s / states.dt_out)), 1)]
    counts = statistics.torque[..., 0].sum(0)
    share = (square / weight / model.noise_variance).clamp_max(1.0)
    return InputNoise(
        encoder_std=torch.from_numpy(np.sqrt(np.mean([reading.surveys[k].q_noise_std ** 2 for k in used], axis=0))),
        torque_std=(square / weight).sqrt(),
        share=share,
        excess=_excess(_added(torch.stack(scores), len(statistics), model), _known(statistics, model, share)),
        columns_gram=tuple(s * m for s, m in zip((counts / weight).tolist(), noise, strict=True)),
    )


def _excess(added: float, known: float) -> float:
    """Return (known + added) / known; 1 where no parameter is free."""
    return 1.0 + added / known if known > 0.0 else 1.0


def _added(scores: Tensor, n_blocks: int, model: FittedModel) -> float:
    """Return |N mu|^2 + N tr S for N blocks, from the scores (B, n) Y~'W (Y - Y~) x of some."""
    own = scores[:, model.free]
    mean, some = own.mean(0), len(own)
    away = own - mean
    scatter = float(((away @ model.laplace) * away).sum()) / max(some - 1, 1)
    shift = float(mean @ model.laplace @ mean) - scatter / some
    return n_blocks**2 * max(shift, 0.0) + n_blocks * scatter


def _known(statistics: BlockStatistics, model: FittedModel, share: Tensor) -> float:
    """Return the squared error that torque noise leaves, the part 1 - share of the residuals."""
    weights = (1.0 - share).clamp_min(_LEAST_LEFT) / model.noise_variance
    H, _ = assemble(statistics.columns, statistics.total(), weights)
    return float((model.laplace * H[model.free.unsqueeze(1), model.free]).sum())


def _some_tiles(reading: Reading, used: Sequence[int]) -> Iterator[tuple[int, States]]:
    """Yield up to ``_MOST_TILES`` tiles of the recordings ``used``, spread over them, and the recording's number."""
    most = max(1, _MOST_TILES // len(used))
    for k in used:
        every = max(1, round(reading.surveys[k].rows / (4096 * most)))
        for number, states in enumerate(reading.tiles(k)):
            if number % every == 0:
                yield k, states


def _shaken(states: States, survey: Survey, filtering: Filtering, generator: torch.Generator) -> States:
    """Return the states with encoder noise, as the state filter leaves it, added."""
    kernels = filtering.state_kernels(states.dt)
    n, samples = states.q.shape

    def drawn(std: Tensor) -> Tensor:
        white = torch.randn(n, samples + kernels.shape[1] - 1, generator=generator, dtype=torch.float64)
        return torch.nan_to_num(std)[:, None] * convolved(white, kernels[None])

    q, qd, qdd = drawn(torch.from_numpy(survey.q_noise_std))
    measured = torch.from_numpy(survey.qd_noise_std)
    seen = ~measured.isnan()
    if bool(seen.any()):
        of_velocity = drawn(measured)
        qd = torch.where(seen.unsqueeze(1), of_velocity[0], qd)
        qdd = torch.where(seen.unsqueeze(1), of_velocity[1], qdd)
    return replace(states, q=states.q + q, qd=states.qd + qd, qdd=states.qdd + qdd)
