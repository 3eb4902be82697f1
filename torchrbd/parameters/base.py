"""Base parameters: the combinations of inertial parameters that motion of this robot can identify.

The columns of the regressor are linearly dependent: Y = Y_b K with Y_b the independent ones, so torque depends on beta
= K pi only. Columns are taken from the base outwards; one in the span of earlier ones is expressed by them.

Source: Gautier, "Numerical calculation of the base inertial parameters of robots", ICRA 1990 (there by QR).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.display import Remark
from torchrbd.robot import RobotModel


@dataclass(frozen=True)
class BaseParameters:
    """The structural identifiability of a robot.

    Attributes:
        names: (n_params,) names of the inertial parameters.
        independent: indices of the columns that span all others, ascending.
        combination: K (n_base, n_params): beta = K pi; the identity on ``independent``.
        invisible: indices of the parameters that change no torque in any motion.
    """

    names: tuple[str, ...]
    independent: tuple[int, ...]
    combination: Tensor
    invisible: tuple[int, ...]

    @property
    def alone(self) -> tuple[int, ...]:
        """Indices of the parameters that are identifiable on their own."""
        return tuple(k for row, k in enumerate(self.independent) if torch.count_nonzero(self.combination[row]) == 1)

    @property
    def expressions(self) -> tuple[str, ...]:
        """The base parameters in terms of the inertial ones, such as "Iyy_link2 - 0.3 mcx_link3"."""
        return tuple(map(self._expression, range(len(self.independent))))

    def combinations(self) -> tuple[Remark, ...]:
        """Return each combination that is identifiable although its parts are not, and what no motion identifies."""
        found = [self._remark(row) for row in range(len(self.independent)) if self._partners(row)]
        never = [self.names[k] for k in self.invisible]
        return (*found, *([Remark("never identified", {"parameters": never})] if never else ()))

    def combinations_with(self, k: int) -> tuple[Remark, ...]:
        """Return the combinations that contain parameter k."""
        rows = torch.nonzero(self.combination[:, k]).flatten().tolist()
        return tuple(self._remark(row) for row in rows if self._partners(row))

    def _partners(self, row: int) -> list[int]:
        return [c for c in torch.nonzero(self.combination[row]).flatten().tolist() if c != self.independent[row]]

    def _expression(self, row: int) -> str:
        terms = (_term(float(self.combination[row, c]), self.names[c]) for c in self._partners(row))
        return "".join((self.names[self.independent[row]], *terms))

    def _remark(self, row: int) -> Remark:
        return Remark("only combination", {"expression": self._expression(row)})


def _term(factor: float, name: str) -> str:
    sign, size = ("-" if factor < 0 else "+"), abs(factor)
    return f" {sign} {name}" if abs(size - 1.0) < 1e-9 else f" {sign} {size:.4g} {name}"


def base_parameters(
    robot: RobotModel, *, held: Mapping[int, float] | None = None, seed: int = 0, tolerance: float = 1e-8
) -> BaseParameters:
    """Find a robot's base parameters from its regressor at random states.

    Args:
        robot: the robot, with its gravity.
        held: positions of joints that do not move, by index [rad or m]; only torques of the other joints count.
        seed: of the random states.
        tolerance: a column is dependent if its part outside the span of the earlier ones is below this fraction of its
            norm.
    """
    held, generator = held or {}, torch.Generator().manual_seed(seed)
    moving = [j for j in range(robot.n_dof) if j not in held]
    n_samples = 4 * robot.n_params // len(moving) + 20
    q, qd, qdd = (3.0 * torch.randn(n_samples, robot.n_dof, generator=generator, dtype=torch.float64) for _ in range(3))
    for joint, position in held.items():
        q[:, joint], qd[:, joint], qdd[:, joint] = position, 0.0, 0.0
    Y = robot.to(dtype=torch.float64, device="cpu").regressor(q, qd, qdd)[:, moving].reshape(-1, robot.n_params)
    norms = Y.norm(dim=0)
    visible = norms > tolerance * norms.max()
    scale = torch.where(visible, norms, torch.ones_like(norms))
    independent = _independent_columns(Y / scale, visible, tolerance)
    solution = torch.linalg.lstsq(Y[:, independent] / scale[independent], Y / scale).solution
    combination = solution * scale / scale[independent].unsqueeze(-1)
    relative = solution.abs() > 1e-7
    return BaseParameters(
        names=tuple(robot.parameter_names),
        independent=tuple(independent),
        combination=torch.where(relative, combination, torch.zeros_like(combination)),
        invisible=tuple(torch.nonzero(~visible).flatten().tolist()),
    )


def _independent_columns(X: Tensor, visible: Tensor, tolerance: float) -> list[int]:
    """Pick, first to last, every column whose part outside the span of those picked before exceeds ``tolerance``."""
    basis = torch.empty(X.shape[0], 0, dtype=X.dtype)
    picked: list[int] = []
    for k in torch.nonzero(visible).flatten().tolist():
        rest = X[:, k]
        for _ in range(2):
            rest = rest - basis @ (basis.T @ rest)
        if rest.norm() > tolerance:
            basis = torch.cat((basis, (rest / rest.norm()).unsqueeze(1)), 1)
            picked.append(k)
    return picked
