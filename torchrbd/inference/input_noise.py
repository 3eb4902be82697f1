"""Does the noise of the positions matter here? It is sent through filter, regressor and fit to see what comes out.

    Y~ = Y(s + e),  e the encoder's noise after the state filter:   bias = (Y~'WY~ + prior)^-1 Y~'W (Y - Y~) x

A bias does not shrink as a recording grows, the standard error does; their ratio says which regime a recording is in.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchrbd.inference.data.block_statistics import BlockStatistics, assemble, filtered_rows
from torchrbd.inference.data.columns import Columns
from torchrbd.inference.data.reading import Reading
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.physical.prior import Prior
from torchrbd.recordings import Filtering, States, Survey

_MOST_TILES = 4
_MATTERS = 2.5


@dataclass(frozen=True)
class InputNoise:
    """What position noise does to torques and to a fit on filtered states.

    Attributes:
        encoder_std: (n_dof,) standard deviation of the positions, [rad] or [m].
        torque_std: (n_dof,) of the band-limited torque predicted from filtered states, [N m] or [N].
        share: (n_dof,) of the residual variance that this explains.
        bias: squared bias of x in units of its variance, mean over the parameters that the data tell.
        columns_gram: per joint the noise of its columns, E[dY'dY] summed over all independent samples (p_j, p_j).
    """

    encoder_std: Tensor
    torque_std: Tensor
    share: Tensor
    bias: float
    columns_gram: tuple[Tensor, ...]

    @property
    def excess(self) -> float:
        """Squared error of a fit on filtered states over that with known states: (1 + bias) / (1 - share)."""
        return (1.0 + self.bias) / max(1.0 - float(self.share.mean()), 1e-3)

    @property
    def matters(self) -> bool:
        """Whether position noise makes standard errors more than half as large again."""
        return self.excess > _MATTERS


def input_noise(
    reading: Reading, columns: Columns, statistics: BlockStatistics, prior: Prior, model: FittedModel, seed: int = 0
) -> InputNoise:
    """Send noise through the chain on some tiles.

    Args:
        reading: the recordings.
        columns: layout of x.
        statistics: the blocks that ``model`` was fitted to.
        prior: of the fit.
        model: a fit on filtered states.
        seed: of the noise drawn.
    """
    generator = torch.Generator().manual_seed(seed)
    n = columns.robot.n_dof
    clean = [torch.zeros(len(own), len(own), dtype=torch.float64) for own in columns.of_joint]
    noisy = [torch.zeros(len(own) + 1, len(own) + 1, dtype=torch.float64) for own in columns.of_joint]
    square, weight = torch.zeros(n, dtype=torch.float64), 0.0
    fitted = {block.recording for block in statistics.blocks}
    used = [k for k, recording in enumerate(reading.recordings) if recording.name in fitted]
    for k, states in _some_tiles(reading, used):
        rows, _ = filtered_rows(columns, states)
        shaken, _ = filtered_rows(columns, _shaken(states, reading.surveys[k], reading.filtering, generator))
        independent = reading.filtering.effective_rate * states.dt_out
        weight += independent * len(states.t_out)
        for joint, own in enumerate(columns.of_joint):
            change = shaken[joint][:-1] - rows[joint][:-1]
            missing = -model.x[own] @ change
            a = torch.cat((shaken[joint][:-1], missing.unsqueeze(0)))
            clean[joint] += independent * change @ change.T
            noisy[joint] += independent * a @ a.T
            square[joint] += independent * missing.square().sum()
    counts = statistics.torque[..., 0].sum(0)
    scale = (counts / weight).tolist()
    torque_variance = square / weight
    H, h = assemble(columns, [s * m for s, m in zip(scale, noisy, strict=True)], 1.0 / model.noise_variance)
    S = prior.scale[:, model.free]
    information = S.T @ H @ S
    precision = information + torch.eye(len(information), dtype=torch.float64)
    bias = torch.linalg.solve(precision, S.T @ h)
    told = float(torch.linalg.solve(precision, information).diagonal().sum())
    return InputNoise(
        encoder_std=torch.from_numpy(np.sqrt(np.mean([reading.surveys[k].q_noise_std ** 2 for k in used], axis=0))),
        torque_std=torque_variance.sqrt(),
        share=(torque_variance / model.noise_variance).clamp_max(1.0),
        bias=float(bias @ precision @ bias) / max(told, 1.0),
        columns_gram=tuple(s * m for s, m in zip(scale, clean, strict=True)),
    )


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
    n, taps = len(states.q), kernels.shape[1]

    def drawn(std: Tensor) -> Tensor:
        white = torch.randn(n, 1, states.q.shape[1] + taps - 1, generator=generator, dtype=torch.float64)
        coloured = torch.nn.functional.conv1d(white, kernels.flip(1).unsqueeze(1))
        return torch.nan_to_num(std)[:, None, None] * coloured

    q, qd, qdd = drawn(torch.from_numpy(survey.q_noise_std)).unbind(1)
    measured = torch.from_numpy(survey.qd_noise_std)
    seen = ~measured.isnan()
    if bool(seen.any()):
        of_velocity = drawn(measured)
        qd = torch.where(seen.unsqueeze(1), of_velocity[:, 0], qd)
        qdd = torch.where(seen.unsqueeze(1), of_velocity[:, 1], qdd)
    return replace(states, q=states.q + q, qd=states.qd + qd, qdd=states.qdd + qdd)
