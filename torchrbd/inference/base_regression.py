"""Base parameters by weighted least squares, streamed: of the samples only second moments per joint are kept.

    A_j = sum a_j a_j',   a_j = [Y_b,j, tau_j];     sum_j A_j / s_j^2 are the moments of the whitened rows

Y_b are the independent columns of the regressor (``BaseParameters``) that joint j has, and s_j is its torque's noise.
As joints are kept apart, the noise may be learnt afterwards. Memory does not grow with the number of samples.

Samples count as independent, states as exact, and torques as those of the rigid body alone: subtract those of rotors
and springs (``RobotModel.known_torque``). For recordings, which also need filters, correlated noise and physical
validity, use ``torchrbd.identify``.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.display import brief
from torchrbd.errors import InputError
from torchrbd.parameters import BaseParameters, base_parameters
from torchrbd.regression.square_root import SquareRoot
from torchrbd.robot import RobotModel
from torchrbd.robot.identity import kinematics_sha256

# Samples at a time, and numbers of their regressor: few enough for the processor's cache.
_TILE, _MOST_NUMBERS = 1024, 2_000_000
_MOST_ROUNDS, _SETTLED = 20, 1e-6


@dataclass(frozen=True)
class BaseEstimate:
    """Base parameters and their covariance.

    Attributes:
        base: what they are combinations of, beta = K pi.
        value: beta (n_base,).
        covariance: (n_base, n_base), of independent samples.
        noise_std: (n_dof,) of the torques [N m or N].
        samples: how many there were.
    """

    base: BaseParameters
    value: Tensor
    covariance: Tensor
    noise_std: Tensor
    samples: int


class BaseRegression:
    """Take in samples, add what others have taken in of the same robot, and solve when asked.

    Example:
        >>> regression = torchrbd.BaseRegression(robot)
        >>> for q, qd, qdd, tau in pieces:  # (N, n) each
        ...     regression.take(q, qd, qdd, tau)
        >>> found = regression.solve()
        >>> dict(zip(found.base.expressions, found.value.tolist()))

    Args:
        robot: the robot; its gravity counts, its inertial parameters do not.
        square_root: keep square roots of the moments: somewhat slower, but as accurate as a QR decomposition of all
            rows, where some combinations are hardly excited.
    """

    def __init__(self, robot: RobotModel, *, square_root: bool = False) -> None:
        self.robot, self.base, self.square_root, self.samples = robot, base_parameters(robot), square_root, 0
        chosen = torch.tensor(self.base.independent)
        self._columns = [chosen[torch.isin(chosen, robot.columns(j))] for j in range(robot.n_dof)]
        self._places = [
            torch.cat((torch.searchsorted(chosen, own), chosen.new_tensor([len(chosen)]))) for own in self._columns
        ]
        self._kept: list[Tensor] = [torch.zeros(len(p), len(p), dtype=torch.float64) for p in self._places]

    def take(self, q: Tensor, qd: Tensor, qdd: Tensor, tau: Tensor) -> None:
        """Take in samples.

        Args:
            q, qd, qdd: (N, n_dof) states [rad, m, per s, per s^2], on any device: what is kept of them lies on the CPU.
            tau: (N, n_dof) torques [N m, N].

        Raises:
            InputError: shapes that do not fit, or values that are not finite; none of the samples is taken in then.
        """
        given = {"q": q, "qd": qd, "qdd": qdd, "tau": tau}
        for name, x in given.items():
            if x.shape != (len(q), self.robot.n_dof):
                raise InputError(
                    f"{name} has shape {tuple(x.shape)}; expected ({len(q)}, {self.robot.n_dof}), a column for each of "
                    f"{', '.join(self.robot.joint_names)}"
                )
            if not bool(torch.isfinite(x).all()):
                row, joint = (~torch.isfinite(x)).nonzero()[0].tolist()
                raise InputError(
                    f"{name} of {self.robot.joint_names[joint]}, sample {row}, is {float(x[row, joint])}; leave such "
                    "samples out"
                )
        tile = max(64, min(_TILE, _MOST_NUMBERS // (self.robot.n_dof * self.robot.n_params)))
        for part in zip(*(x.split(tile) for x in given.values()), strict=True):
            self._take(*(x.T.to(torch.float64).contiguous() for x in part))
        self.samples += len(q)

    def _take(self, q: Tensor, qd: Tensor, qdd: Tensor, tau: Tensor) -> None:
        Y = self.robot.regressor_batch_last(q, qd, qdd)
        for j, own in enumerate(self._columns):
            rows = tau.new_empty(len(own) + 1, tau.shape[1])
            torch.index_select(Y[j], 0, own.to(Y.device), out=rows[:-1])
            rows[-1] = tau[j]
            if self.square_root:
                self._kept[j] = SquareRoot(self._kept[j]).with_rows(rows.T.cpu()).factor
            else:
                self._kept[j] += (rows @ rows.T).cpu()

    def __repr__(self) -> str:
        return brief(self, robot=self.robot.name, samples=self.samples, base_parameters=len(self.base.independent))

    def __add__(self, other: BaseRegression) -> BaseRegression:
        """Return what has taken in the samples of both.

        Raises:
            InputError: they are of other robots, of other gravity, or of other kinds.
        """
        if self.square_root != other.square_root:
            raise InputError("regressions with square_root and without cannot be added; make all with the same")
        robots = self.robot, other.robot
        if len({kinematics_sha256(robot) for robot in robots}) > 1:
            names = " and ".join(f"'{robot.name}'" for robot in robots)
            raise InputError(
                f"regressions of {names} cannot be added: their joints, axes, placements, rotors or springs differ; "
                "make all with one URDF"
            )
        if not torch.equal(self.robot.gravity, other.robot.gravity):
            one, two = (robot.gravity.tolist() for robot in robots)
            raise InputError(f"regressions of gravity {one} and {two} cannot be added; make all with one")
        joined = BaseRegression(self.robot, square_root=self.square_root)
        joined.samples = self.samples + other.samples
        joined._kept = [
            (SquareRoot(a) + SquareRoot(b)).factor if self.square_root else a + b
            for a, b in zip(self._kept, other._kept, strict=True)
        ]
        return joined

    def solve(self, noise_std: Tensor | None = None) -> BaseEstimate:
        """Return the weighted least squares estimate.

        Args:
            noise_std: (n_dof,) of the torques [N m or N]; learnt in turns with the parameters if not given.

        Raises:
            InputError: fewer samples than there are base parameters, or as many where noise is to be learnt.
        """
        least = len(self.base.independent) + (noise_std is None)
        if self.samples < least:
            why = "" if noise_std is not None else " and their noise"
            raise InputError(
                f"{self.samples} samples for {len(self.base.independent)} base parameters of robot "
                f"'{self.robot.name}'{why}; take in {least} or more"
            )
        std = torch.ones(self.robot.n_dof, dtype=torch.float64) if noise_std is None else noise_std.double()
        value, root = self._solved(std)
        for _ in range(_MOST_ROUNDS if noise_std is None else 0):
            before, std = std, self._left(value)
            value, root = self._solved(std)
            if bool(((std / before - 1.0).abs() < _SETTLED).all()):
                break
        return BaseEstimate(self.base, value, root @ root.T, std, self.samples)

    def _solved(self, std: Tensor) -> tuple[Tensor, Tensor]:
        """Return beta and a root of its covariance, the rows of joint j divided by ``std`` (n_dof,)."""
        size = len(self.base.independent) + 1
        if self.square_root:
            rows = [
                K.new_zeros(len(K), size).index_copy(1, p, K / s)
                for K, p, s in zip(self._kept, self._places, std, strict=True)
            ]
            return SquareRoot.empty(size).with_rows(torch.cat(rows)).solve()
        total = torch.zeros(size, size, dtype=torch.float64)
        for K, p, s in zip(self._kept, self._places, std, strict=True):
            total[p.unsqueeze(1), p] += K / s**2
        return _normal_equations(total)

    def _left(self, value: Tensor) -> Tensor:
        """Return the standard deviation (n_dof,) of the residual torques of beta, none of them exactly zero."""
        v = torch.cat((-value, value.new_ones(1)))
        free = self.samples - len(value) / self.robot.n_dof
        squares = [
            (K @ v[p]).square().sum() if self.square_root else v[p] @ K @ v[p]
            for K, p in zip(self._kept, self._places, strict=True)
        ]
        torque = [K[:, -1].square().sum() if self.square_root else K[-1, -1] for K in self._kept]
        least = torch.finfo(torch.float64).eps * torch.stack(torque)
        return (torch.maximum(torch.stack(squares), least).clamp_min(1e-300) / free).sqrt()


def _normal_equations(total: Tensor) -> tuple[Tensor, Tensor]:
    """Solve by moments (d + 1, d + 1), as ``SquareRoot.solve`` does by their root; half the digits."""
    H, h = total[:-1, :-1], total[:-1, -1]
    length = H.diagonal().sqrt()
    length = torch.where(length > 0, length, torch.ones_like(length))
    size, axes = torch.linalg.eigh(H / (length.unsqueeze(1) * length))
    positive = size > size[-1] * len(H) * torch.finfo(H.dtype).eps
    root = axes * torch.where(positive, size.clamp_min(1e-300).rsqrt(), torch.zeros_like(size)) / length.unsqueeze(1)
    return root @ (root.T @ h), root
