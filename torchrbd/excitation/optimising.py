"""Optimise a Fourier motion within limits: sequential quadratic programming from several starts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from torchrbd.errors import OptionError
from torchrbd.excitation.constraints import Constraints
from torchrbd.excitation.fourier import Basis, FourierMotion

Objective = Callable[[Tensor, Tensor, Tensor], Tensor]
"""What a motion with states q, qd, qdd (N, n) costs, a number."""

# Samples of a period for each harmonic: for the optimiser, and for the last word on limits.
SAMPLES, FINE_SAMPLES = 20, 200
# Postures that are tried; motions that are drawn for each start, and how large they are in the range and in speed.
_POSTURES, _DRAWS, _CENTRES, _STROKES = 512, 64, 0.8, 0.3
# Samples for which a posture is held.
_RESTING = 16
# Above this multiple of a limit, the excess is printed as a multiple, not in per cent.
_FAR = 1e3
_ITERATIONS, _TOLERANCE = 200, 1e-4
# No coordinate of a motion within its limits is larger than sqrt(8): sines of the greatest speed.
_FURTHEST = 3.0
_HALVINGS = 30
# Between two of the fine samples a sine rises by 1 - cos(pi / 200) at most.
_BETWEEN = 2e-4


def sampled(basis: Basis, samples: int) -> Tensor:
    """Return the times of one period (N,) [s], without its end."""
    return torch.arange(samples, dtype=torch.float64) * (basis.period_s / samples)


@dataclass(frozen=True)
class Problem:
    """Least cost within limits, in coordinates x in which all that moves is of the order of one.

    Attributes:
        basis: of the motion.
        objective: its cost.
        constraints: what it keeps.
        t: (N,) times of one period at which both are evaluated [s].
    """

    basis: Basis
    objective: Objective
    constraints: Constraints
    t: Tensor

    def motion(self, x: np.ndarray) -> FourierMotion:
        """Return the motion of coordinates x (n (2 H - 1),)."""
        return FourierMotion(self.basis, self.free(torch.from_numpy(x)))

    def free(self, x: Tensor) -> Tensor:
        """Return the free coefficients (*batch, n, 2 H - 1) of coordinates x (*batch, n (2 H - 1))."""
        limits, n = self.constraints.limits, self.constraints.robot.n_dof
        # In a short range the fastest harmonic has not the room for the speed.
        room = limits.half * (2.0 * math.pi * self.basis.harmonics / self.basis.period_s)
        speed = torch.minimum(torch.where(limits.moves, 0.5 * limits.fastest, 0.0), room).unsqueeze(1)
        scale = torch.cat((limits.half.unsqueeze(1), speed.expand(n, self.basis.n - 1)), 1)
        free = scale * x.unflatten(-1, (n, self.basis.n))
        return free + torch.nn.functional.pad(limits.middle.unsqueeze(1), (0, self.basis.n - 1))

    def postures(self) -> np.ndarray:
        """Return coordinates (postures, n) of the centres, of many, at which the robot can rest within its limits.

        Raises:
            OptionError: at none of them; says what the best of them breaks.
        """
        n = self.constraints.robot.n_dof
        sobol = torch.quasirandom.SobolEngine(n, scramble=True, seed=0)
        drawn = 2.0 * sobol.draw(_POSTURES, dtype=torch.float64) - 1.0
        limits = self.constraints.limits
        q = limits.middle + limits.half * drawn
        # A sequence, as effects with memory need one.
        held = q.unsqueeze(1).repeat(1, _RESTING, 1)
        still = torch.zeros_like(held)
        used = self.constraints.greatest(self.t[:_RESTING], held, still, still)
        best = used.amax(1).argmin()
        if float(used[best].max()) > 1.0:
            label, most = self.constraints.labels[int(used[best].argmax())], float(used[best].max()) - 1.0
            words = f"{most:.0%} of it or more" if most < _FAR else f"more than {_FAR:g} times it"
            raise OptionError(
                f"the robot cannot even rest within its limits: of {_POSTURES} postures the best breaks {label}, by "
                f"{words}; give that more room"
            )
        return drawn[used.amax(1) <= 1.0].numpy()

    def start(self, rng: np.random.Generator, postures: np.ndarray) -> np.ndarray:
        """Return random coordinates around one of some postures; of several draws those furthest inside the limits."""
        n, K = self.constraints.robot.n_dof, self.basis.n
        draws = _STROKES * rng.standard_normal((_DRAWS, n, K))
        draws[:, :, 0] = _CENTRES * rng.choice(postures, _DRAWS)
        free = self.free(torch.from_numpy(draws).flatten(1))
        q, qd, qdd = (part @ free.mT for part in self.basis.at(self.t))
        return draws[int(self.constraints.greatest(self.t, q, qd, qdd).amax(1).argmin())].ravel()

    def solved(self, start: np.ndarray, report: Callable[[float], None]) -> FourierMotion:
        """Return where the optimiser ends from a start; whether it keeps the limits is not said."""
        at, steps = self.basis.at(self.t), 0

        def states(x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            free = self.free(x)
            q, qd, qdd = (part @ free.mT for part in at)
            return q, qd, qdd

        def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
            z = torch.from_numpy(x.copy()).requires_grad_()
            value = self.objective(*states(z))
            return float(value.detach()), torch.autograd.grad(value, z)[0].numpy()

        def room(x: np.ndarray) -> np.ndarray:
            return 1.0 - self.constraints.smooth(self.t, *states(torch.from_numpy(x))).numpy()

        def room_slopes(x: np.ndarray) -> np.ndarray:
            # A copy of the motion for each limit: one pass backwards gives the slopes of all of them.
            z = torch.from_numpy(x).expand(len(self.constraints.labels), -1).clone().requires_grad_()
            used = self.constraints.smooth(self.t, *states(z))
            return -torch.autograd.grad(used.diagonal().sum(), z)[0].numpy()

        def step(_: np.ndarray) -> None:
            nonlocal steps
            steps += 1
            report(min(steps / _ITERATIONS, 1.0))

        found = minimize(
            cost,
            start,
            jac=True,
            method="SLSQP",
            bounds=[(-_FURTHEST, _FURTHEST)] * len(start),
            constraints={"type": "ineq", "fun": room, "jac": room_slopes},
            callback=step,
            options={"maxiter": _ITERATIONS, "ftol": _TOLERANCE},
        )
        return self.motion(found.x)


def optimised(problem: Problem, starts: int, seed: int, report: Callable[[float], None]) -> FourierMotion:
    """Return the motion of least cost of those found from several starts that keep every limit.

    Args:
        problem: what to solve.
        starts: how many.
        seed: of the starts.
        report: called with the part of the work that is done.

    Raises:
        OptionError: no motion was found that keeps the limits; says which one was hardest.
    """
    rng, postures = np.random.default_rng(seed), problem.postures()
    fine = sampled(problem.basis, FINE_SAMPLES * problem.basis.harmonics)
    best: tuple[float, FourierMotion] | None = None
    nearest, hardest = np.inf, ""
    for k in range(starts):
        motion = problem.solved(problem.start(rng, postures), lambda part, k=k: report((k + part) / starts))
        used = problem.constraints.greatest(fine, *motion.states(fine))
        if float(used.max()) < nearest:
            nearest, hardest = float(used.max()), problem.constraints.labels[int(used.argmax())]
        kept = _kept(problem.constraints, motion, fine)
        if kept is not None:
            cost = float(problem.objective(*kept.states(problem.t)))
            best = min(best or (np.inf, kept), (cost, kept), key=lambda one: one[0])
    if best is None:
        much = f"{nearest - 1.0:.0%} too much" if nearest < _FAR else f"more than {_FAR:g} times it"
        raise OptionError(
            f"no motion was found that keeps every limit; the hardest was {hardest}, by {much}. "
            "Give that more room, a smaller margin, another range of joints, or more starts"
        )
    return best[1]


def _kept(constraints: Constraints, motion: FourierMotion, t: Tensor) -> FourierMotion | None:
    """Return a motion with strokes as much smaller as its limits need; None if its centre does not keep them."""

    def keeps(part: float) -> bool:
        return bool((constraints.greatest(t, *motion.shrunk(part).states(t)) <= 1.0 - _BETWEEN).all())

    if keeps(1.0):
        return motion
    low, high = 0.0, 1.0
    if not keeps(low):
        return None
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return motion.shrunk(low) if low > 0.5 else None
