"""Where the noisy-input model's iterations begin, and which inputs are relevant to begin with.

For columns of mean square 1 every (rho, c) gives an equally likely model of x, with

    rho_m = u_m^2 / (u_m^2 + psi_xm),   u = sqrt(rho),   psi_x = 1 - rho,   v = c / sqrt(rho)

The likelihood of y depends on c and S = psi_y + sum_m c_m^2 psi_xm / rho_m alone. The start is the stationary point of
the bound with the variances of q(w) at leading order, U = psi_x / N and V = psi_y / N: c is least squares, shrunk
only as far as psi_y calls for a part of S; rho is what the priors like best.

Where the input noise is free up to the column's whole mean square, an input can also be dead: w_x = w_z = 0, psi_x = 1.
No sweep passes from alive to dead, since the bound is lower in between. Backward elimination (drop the input of least
t-statistic, refit) therefore lists one start per number of inputs, and the one of highest bound is taken.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from scipy import optimize
from torch import Tensor

from torchrbd.regression.noisy_input.elbo import Evidence, NoisePrior, Posterior, Priors, elbo
from torchrbd.regression.noisy_input.updates import Bounds, NoiseBounds

# Collinear columns share what they explain; far below any noise.
_RIDGE = 1e-6
_LEAST_SHARE, _LEAST_NOISE = 0.05, 1e-10
# An input that its own noise explains for the larger part is on the way to being dead.
_MOST_NOISE, _GRID = 0.5, 2000
_ROUNDS = 3


def start(evidence: Evidence, priors: Priors, bounds: NoiseBounds) -> Posterior:
    """Return the posterior that the iterations start from.

    Args:
        evidence: moments of the rows.
        priors: prior distributions.
        bounds: of the noise variances.
    """
    psi_x = _first_noise(priors.input, bounds.input, torch.zeros_like(evidence.xy), 0.0)
    best, alive = -torch.inf, torch.zeros_like(psi_x, dtype=torch.bool)
    for c, candidate in _elimination(evidence, bounds.input):
        residual = _residual(evidence, c)
        psi_y = (residual - _spread(c, psi_x)).clamp_min(_LEAST_SHARE * residual)
        height = float(elbo(evidence, priors, _state(evidence, priors, bounds, candidate, c, psi_x, psi_y)))
        if height > best:
            best, alive = height, candidate
    for _ in range(_ROUNDS):
        c, psi_y, price = _balance(evidence, priors.output, bounds.output, psi_x, alive)
        psi_x = _first_noise(priors.input, bounds.input, c, price)
    return _state(evidence, priors, bounds, alive, c, psi_x, psi_y)


def _elimination(evidence: Evidence, bounds: Bounds) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield least-squares c (d,) and alive (d,) after dropping 0, 1, 2, ... of the inputs that can be dead."""
    # An input without room below its own mean square is noise alone.
    alive = (bounds.low < 1.0) & (evidence.xx.diagonal() > 0.0)
    mortal = alive & (bounds.high >= 1.0)
    inverse = torch.linalg.inv(_selected(evidence.xx, alive))
    c = torch.where(alive, inverse @ evidence.xy, 0.0)
    yield c, alive
    for _ in range(int(mortal.sum())):
        m = int(torch.where(mortal, c.square() / inverse.diagonal(), torch.inf).argmin())
        column = inverse[:, m] / inverse[m, m]
        c = c - column * c[m]
        inverse = inverse - torch.outer(column, inverse[m])
        alive, mortal = alive.clone(), mortal.clone()
        alive[m] = mortal[m] = False
        c = torch.where(alive, c, 0.0)
        yield c, alive


def _selected(xx: Tensor, alive: Tensor) -> Tensor:
    """Return X'X / N of the alive inputs, slightly regular, and 1 on the diagonal of the others."""
    both = alive.unsqueeze(1) & alive
    return torch.where(both, xx, 0.0) + torch.diag(torch.where(alive, _RIDGE, 1.0).to(xx))


def _residual(evidence: Evidence, c: Tensor) -> Tensor:
    return (evidence.yy - 2.0 * (c @ evidence.xy) + c @ evidence.xx @ c).clamp_min(_LEAST_NOISE)


def _spread(c: Tensor, psi_x: Tensor) -> Tensor:
    """Return the part of y's variance, given x, that the input noise causes: sum c^2 psi_x / rho."""
    return (c.square() * psi_x / (1.0 - psi_x).clamp_min(_LEAST_NOISE)).sum()


def _balance(
    evidence: Evidence, prior: NoisePrior | None, bounds: Bounds, psi_x: Tensor, alive: Tensor
) -> tuple[Tensor, Tensor, float]:
    """Return c (d,), psi_y () and the price of spread at the stationary point for this psi_x (d,).

        (X'X/N + lambda diag(psi_x/rho)) c = X'y/N,   lambda = 1 - R/S,   R = mean (y - c'x)^2
        price = N lambda / (2 S) = (d/2 - shape - 1)/psi_y + scale/psi_y^2

    where d/2 log psi_y is the entropy of the d alive q(w_z).
    """
    xx, n = _selected(evidence.xx, alive), evidence.n
    xy = torch.where(alive, evidence.xy, 0.0)
    weight = torch.where(alive, psi_x / (1.0 - psi_x).clamp_min(_LEAST_NOISE), 0.0)
    push = 0.0 if prior is None else 0.5 * float(alive.sum()) - prior.shape - 1.0
    scale = 0.0 if prior is None else prior.scale

    def solve(shrinkage: float) -> tuple[Tensor, Tensor, Tensor, float]:
        """Return c, the psi_y that S leaves, the psi_y that is wanted, and the price."""
        c = torch.linalg.solve(xx + shrinkage * torch.diag(weight), xy)
        S = _residual(evidence, c) / (1.0 - shrinkage)
        price = 0.5 * n * shrinkage / float(S)
        wanted = (push + (push**2 + 4.0 * price * scale) ** 0.5) / (2.0 * price) if price > 0.0 else torch.inf
        return c, S - _spread(c, psi_x), bounds.clamp(S.new_tensor(wanted)), price

    def excess(shrinkage: float) -> float:
        _, left, wanted, _ = solve(shrinkage)
        return float(left - wanted)

    low, high = 1e-9, 1.0 - 1e-9
    if excess(low) >= 0.0:
        shrinkage = low
    elif excess(high) <= 0.0:
        shrinkage = high
    else:
        shrinkage = optimize.root_scalar(excess, bracket=(low, high), xtol=1e-9).root
    c, left, _, price = solve(shrinkage)
    return c, left, price


def _first_noise(prior: NoisePrior | None, bounds: Bounds, c: Tensor, price: float) -> Tensor:
    """Return psi_x (d,) that the priors like best among the equally likely ones.

    They weigh the inverse-gamma density, the entropy of q(w_x), the price of spread in y, and the marginal prior of
    the two weights, of which only u^2 + v^2 = rho + c^2/rho matters.
    """
    if prior is None:
        return bounds.low
    low, high = bounds.low.clamp(1e-6, _MOST_NOISE), bounds.high.clamp(1e-6, _MOST_NOISE)
    psi = low * (high / low) ** torch.linspace(0.0, 1.0, _GRID, dtype=c.dtype).unsqueeze(1)
    rho, square = 1.0 - psi, c.square()
    height = -(prior.shape + 0.5) * psi.log() - prior.scale / psi - (rho + square / rho).log()
    height = height - price * square * psi / rho
    return bounds.clamp(psi.gather(0, height.argmax(0, keepdim=True)).squeeze(0))


def _state(
    evidence: Evidence, priors: Priors, bounds: NoiseBounds, alive: Tensor, c: Tensor, psi_x: Tensor, psi_y: Tensor
) -> Posterior:
    """Return the posterior of the alive inputs with c (d,), psi_x (d,), psi_y (); the others dead."""
    psi_x = torch.where(alive, psi_x, bounds.input.clamp(torch.ones_like(psi_x)))
    u = torch.where(alive, (1.0 - psi_x).clamp_min(_LEAST_NOISE).sqrt(), 0.0)
    v = torch.where(alive, c / torch.where(alive, u, 1.0), 0.0)
    psi_y, psi_z = psi_y.clamp_min(_LEAST_NOISE), None
    if bounds.hidden is not None:
        # Half of the noise each way: neither is far from where the updates take it.
        psi_z = bounds.hidden.clamp((0.5 * psi_y / len(c)).expand_as(c))
        psi_y = (psi_y - psi_z.sum()).clamp_min(_LEAST_SHARE * psi_y)
    psi_y = bounds.output.clamp(psi_y)
    # A dead weight has the variance of its prior.
    x_var = torch.where(alive, psi_x / evidence.n, priors.rate)
    z_var = torch.where(alive, (psi_y if psi_z is None else psi_z) / evidence.n, priors.rate)
    rate = priors.rate + 0.5 * (u.square() + x_var + v.square() + z_var)
    return Posterior(u, x_var, v, z_var, rate, psi_x, psi_z, psi_y)
