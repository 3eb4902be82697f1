"""How well a motion separates inertial parameters and friction: condition numbers of its regressor.

    W = [Y_b  qd  sign(qd)]                                 a row for each sample and joint that moves
    kappa(W D) = sigma_max / sigma_min,   D = diag(1 / RMS of each column)

With columns of unit size the number describes the motion, not the units: within a factor of sqrt(columns) no other
scaling has a smaller one (van der Sluis, "Condition numbers and equilibration of matrices", Numerische Mathematik
1969). It shows how well columns are separated, but not how large they are; without scaling, small columns count against
a motion. The cost of a motion is therefore the mean of log kappa(W D), friction included, and log kappa(Y_b), less a
small part of the mean logarithm of all columns' RMS: of motions that separate equally well, the larger one is better.
The optimiser uses smooth upper bounds, with lambda the eigenvalues of the normal matrix:

    log kappa <= (1 / 2p) [log sum lambda^p + log sum lambda^-p]

Source: Gautier and Khalil, "Exciting trajectories for the identification of base inertial parameters of robots", IJRR
    1992, for the condition number as a criterion.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.excitation.limits import Limits
from torchrbd.parameters import base_parameters
from torchrbd.robot import RobotModel

_P = 6.0
# What columns e times as large are worth, in logarithms of the condition number.
_LARGER = 0.2
# Friction changes its direction over so large a part of the greatest speed: sharp, but not for the optimiser.
REST_PART = 0.02
_LEAST = 1e-14


@dataclass(frozen=True)
class ConditionNumbers:
    """Of the regressor of a motion.

    Attributes:
        scaled: of the base parameters' columns, each divided by its RMS.
        unscaled: of the same in SI units.
        with_friction: scaled, with viscous and Coulomb friction of every joint that moves.
        base_parameters: how many there are.
    """

    scaled: float
    unscaled: float
    with_friction: float
    base_parameters: int


class Conditioning:
    """The regressor that a motion makes.

    Args:
        robot: the robot.
        limits: say which joints move.
    """

    def __init__(self, robot: RobotModel, limits: Limits) -> None:
        self.robot, self.moving = robot, limits.moving
        self.independent = list(base_parameters(robot, held=limits.held()).independent)
        self._rest_width = (REST_PART * limits.fastest)[self.moving]

    def columns(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return W (N, joints that move, base parameters + two for each of these joints)."""
        Y = self.robot.regressor(q, qd, qdd)[:, self.moving][..., self.independent]
        speed = qd[:, self.moving]
        return torch.cat((Y, torch.diag_embed(speed), torch.diag_embed(torch.tanh(speed / self._rest_width))), -1)

    def objective(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return the cost of a motion, smooth: small where columns are well separated and large."""
        W, n = self.columns(q, qd, qdd).flatten(0, 1), len(self.independent)
        G = W.T @ W / len(W)
        size = G.diagonal().clamp_min(_LEAST).sqrt()
        both = [G / size / size[:, None], *([G[:n, :n] / G[:n, :n].trace().clamp_min(_LEAST)] if n else [])]
        return torch.stack([_bound(A) for A in both]).mean() - _LARGER * size.log().mean()

    def numbers(self, q: Tensor, qd: Tensor, qdd: Tensor) -> ConditionNumbers:
        """Return the condition numbers of a motion's samples (N, n)."""
        W = self.columns(q, qd, qdd).flatten(0, 1)
        n = len(self.independent)
        scaled = W / W.square().mean(0).sqrt().clamp_min(_LEAST)
        each = (float(torch.linalg.cond(A)) if A.shape[1] else 1.0 for A in (scaled[:, :n], W[:, :n], scaled))
        return ConditionNumbers(*each, base_parameters=n)


def _bound(G: Tensor) -> Tensor:
    """Return a smooth upper bound of half the logarithm of the condition number of a normal matrix."""
    logs = torch.linalg.eigvalsh(G).clamp_min(_LEAST).log()
    return (torch.logsumexp(_P * logs, 0) + torch.logsumexp(-_P * logs, 0)) / (2.0 * _P)
