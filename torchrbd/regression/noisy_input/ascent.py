"""Two ways up the evidence lower bound: closed-form coordinate updates, and L-BFGS on its gradient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy import optimize
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from torchrbd.regression.noisy_input.elbo import Evidence, Priors, collapse, elbo
from torchrbd.regression.noisy_input.updates import Bounds, NoiseBounds, sweep
from torchrbd.regression.noisy_input.variational import Variational

_WIDEST = 80.0


@dataclass(frozen=True)
class Ascent:
    """``history``: the bound at the start and after each iteration [nat]; ``converged``: the last rise was small."""

    history: Tensor
    converged: bool


@torch.no_grad()
def climb_by_coordinates(
    evidence: Evidence, priors: Priors, bounds: NoiseBounds, q: Variational, *, iterations: int, tolerance: float
) -> Ascent:
    """Repeat coordinate updates until one raises the bound by less than ``tolerance`` [nat]."""
    s, converged = q(), False
    at = collapse(evidence, s)
    history = [float(elbo(evidence, priors, s, at))]
    for _ in range(iterations):
        s = sweep(evidence, priors, bounds, s, at)
        at = collapse(evidence, s)
        history.append(float(elbo(evidence, priors, s, at)))
        converged = history[-1] - history[-2] < tolerance
        if converged:
            break
    q.store(s)
    return Ascent(torch.tensor(history, dtype=torch.float64), converged)


def climb_by_gradient(
    evidence: Evidence, priors: Priors, q: Variational, *, iterations: int, tolerance: float
) -> Ascent:
    """Run L-BFGS-B on the raw parameters in their natural units; its box keeps learned noise within bounds."""
    learned = q.learned(evidence.n)
    free = [p for p, _, _ in learned]
    unit = torch.cat([u.reshape(-1) for _, u, _ in learned])
    origin = parameters_to_vector(free).detach().clone()
    first = float(elbo(evidence, priors, q()).detach())
    history = [first]

    def descend(steps: np.ndarray) -> tuple[float, np.ndarray]:
        vector_to_parameters(origin + unit * torch.from_numpy(steps), free)
        loss = -elbo(evidence, priors, q())
        slope = torch.autograd.grad(loss, free)
        return float(loss.detach()), (unit * torch.cat([g.reshape(-1) for g in slope])).numpy()

    result = optimize.minimize(
        descend,
        np.zeros(len(origin)),
        jac=True,
        method="L-BFGS-B",
        bounds=_box(learned, origin, unit),
        callback=_recorder(history),
        options={
            "maxiter": iterations,
            "maxfun": 20 * iterations,
            "ftol": tolerance / max(abs(first), 1.0),
            "gtol": 0.0,
            "maxcor": 30,
        },
    )
    descend(result.x)
    return Ascent(torch.tensor(history, dtype=torch.float64), bool(result.success))


def _recorder(history: list[float]) -> Callable[[optimize.OptimizeResult], None]:
    # scipy passes the result only to a parameter of this very name.
    def record(intermediate_result: optimize.OptimizeResult) -> None:
        history.append(-float(intermediate_result.fun))

    return record


def _box(
    learned: list[tuple[torch.nn.Parameter, Tensor, Bounds | None]], origin: Tensor, unit: Tensor
) -> list[tuple[float, float]]:
    """Return the least and largest step of each entry: finite, so that no trial overflows."""
    low, high = [], []
    for p, _, bounds in learned:
        # Just inside: on the bound itself, rounding could cut the gradient off.
        ends = (-torch.inf, torch.inf) if bounds is None else (bounds.low.log() + 1e-9, bounds.high.log() - 1e-9)
        low.append(torch.as_tensor(ends[0], dtype=p.dtype).expand_as(p).reshape(-1))
        high.append(torch.as_tensor(ends[1], dtype=p.dtype).expand_as(p).reshape(-1))
    least = ((torch.cat(low).clamp_min(-_WIDEST) - origin) / unit).clamp_max(0.0)
    most = ((torch.cat(high).clamp_max(_WIDEST) - origin) / unit).clamp_min(0.0)
    return list(zip(least.tolist(), most.tolist(), strict=True))
