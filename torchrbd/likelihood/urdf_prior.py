"""The prior: the URDF's inertial parameters, with the entropic divergence between pseudo-inertias.

    D(J | J0) = tr(J0^-1 J) - logdet(J0^-1 J) - 4,   Hessian at J0:  M_kl = tr(J0^-1 E_k J0^-1 E_l)

kappa D is added to the negative log-likelihood. D is invariant to the frame and the units, so one kappa suits a finger
and a crane. It is infinite for every unphysical body. Linear (ridge) fits use its quadratic form instead.

Source: Lee, Wensing, Park, "Geometric Robot Dynamic Identification: A Convex Programming Approach", IEEE T-RO 2020, eq.
(25), (31).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics
from torchrbd.dataset.columns import Columns
from torchrbd.dataset.resting import without_columns_at_rest
from torchrbd.parameters import BASIS, ORTHONORMAL, PARAMETERS_PER_BODY, is_extended, nearest_physical
from torchrbd.robot import from_pseudo_inertia, pseudo_inertia

KAPPA = 3.0
# Prior standard deviation of the torque of columns that belong to no effect, in units of the joint's torque RMS. It is
# wide: it only bounds directions that the data do not determine.
TERM_WIDTH = 10.0


@dataclass(frozen=True)
class Prior:
    """The prior distribution of x.

    Attributes:
        mean: x0 (n,): the URDF, with bodies that no mass distribution can have replaced by the nearest physical ones.
        reference: x of the URDF, unchanged.
        bodies: indices of the bodies that are fitted; the others are held.
        inverse_inertia: J0^-1 (n_fitted, 4, 4) of those.
        kappa: weight of the divergence.
        scale: S (n, n), columns of prior standard deviations: x = x0 + S z with z ~ N(0, 1).
    """

    mean: Tensor
    reference: Tensor
    bodies: tuple[int, ...]
    inverse_inertia: Tensor
    kappa: float
    scale: Tensor

    @property
    def inertial(self) -> Tensor:
        """Indices in x of the fitted inertial parameters."""
        first = PARAMETERS_PER_BODY * torch.tensor(self.bodies, dtype=torch.long).unsqueeze(1)
        return (first + torch.arange(PARAMETERS_PER_BODY)).flatten()

    @property
    def blocks(self) -> Tensor:
        """The blocks of S of single bodies, (n_fitted, 10, 10)."""
        at = self.inertial.reshape(-1, PARAMETERS_PER_BODY)
        return self.scale[at.unsqueeze(2), at.unsqueeze(1)]

    def scaled(self, X: Tensor, *, back: bool = False) -> Tensor:
        """Return S X for X (n, k), or S'X if ``back``: S is diagonal apart from the blocks of bodies."""
        found, at, blocks = self.scale.diagonal().unsqueeze(1) * X, self.inertial, self.blocks
        own = X[at].reshape(len(blocks), PARAMETERS_PER_BODY, X.shape[1])
        found[at] = ((blocks.mT if back else blocks) @ own).flatten(0, 1)
        return found


def in_proportion(widths: np.ndarray, std: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the largest multiple of ``std`` (K,) that is nowhere above ``widths`` (K,), zero where those are zero."""
    free = widths > 0
    return np.where(free, np.asarray(std) * np.min(widths / std, where=free, initial=np.inf), 0.0)


def divergence_hessian(inverse: Tensor) -> Tensor:
    """Return the Hessian of -logdet J in pi, M_kl = tr(W E_k W E_l) with W = J^-1 (*batch, 4, 4): (*batch, 10, 10)."""
    WE = torch.einsum("...ab,kbc->...kac", inverse, BASIS.to(inverse))
    return torch.einsum("...kac,...lca->...kl", WE, WE)


def urdf_prior(
    columns: Columns, torque_rms: Tensor, feature_rms: Tensor, *, held: Collection[str] = (), kappa: float = KAPPA
) -> Prior:
    """Build the prior around the URDF.

    Args:
        columns: the layout of x.
        torque_rms: (n_dof,) of the measured torque, [N m] or [N].
        feature_rms: (n_dof, n) root mean square of the columns at each joint; only entries of features are used.
        held: bodies that keep the URDF's inertia. Bodies without mass are always held: they have no distribution to
            start from.
        kappa: weight of the divergence; 1 is the weight of one observation in each direction of a relative change of
            order one.
    """
    robot = columns.robot
    reference = columns.reference()
    pi = reference[: robot.n_params].reshape(-1, PARAMETERS_PER_BODY)
    bodies = tuple(b for b, name in enumerate(robot.body_names) if float(pi[b, 0]) > 0 and name not in held)
    fitted = torch.tensor(bodies, dtype=torch.long)
    mean, scale = reference.clone(), torch.zeros(columns.n, columns.n, dtype=torch.float64)
    pi0 = nearest_physical(pi[fitted])
    inverse = torch.linalg.inv(pseudo_inertia(pi0))
    for b, own, metric in zip(bodies, pi0, divergence_hessian(inverse), strict=True):
        here = slice(PARAMETERS_PER_BODY * b, PARAMETERS_PER_BODY * (b + 1))
        mean[here] = own
        scale[here, here] = inverse_root(kappa * metric)
    parts = _torque_parts(columns)
    for joint in range(robot.n_dof):
        for k in columns.of_joint[joint].tolist():
            if k >= robot.n_params:
                rms = float(feature_rms[joint, k])
                if rms > 0:
                    width, known = parts[k] * float(torque_rms[joint]) / rms, float(scale[k, k])
                    scale[k, k] = min(width, known) if known > 0 else width
    for term in columns.candidates:
        if std := term.effect.prior.proportions:
            at = torch.tensor(columns.of(term))
            scale[at, at] = torch.from_numpy(in_proportion(scale[at, at].numpy(), std))
    return Prior(mean, reference, bodies, inverse, kappa, scale)


def _torque_parts(columns: Columns) -> dict[int, float]:
    """Return the prior share of its joint's torque for each column of a term, by its index in x."""
    found: dict[int, float] = {}
    for c in (*columns.urdf_friction, *columns.candidates):
        part = c.effect.prior.torque_part if c.site.always else 1.0
        found |= {k: max(part, found.get(k, 0.0)) for k in columns.of(c)}
    return found


def data_prior(statistics: BlockStatistics, held: Collection[str], kappa: float) -> Prior:
    """Return the prior around the URDF; the size of torques and features sets the width of the terms' prior.

    The features of a joint's own motion count where it moves. For a joint that never moves, they are those of unit
    motion.
    """
    statistics = without_columns_at_rest(statistics)
    weight, _, square = statistics.torque.sum(0).unbind(-1)
    torque_rms = (square / weight.clamp_min(1e-300)).sqrt()
    return urdf_prior(statistics.columns, torque_rms, _feature_rms(statistics), held=held, kappa=kappa)


def _feature_rms(statistics: BlockStatistics) -> Tensor:
    columns = statistics.columns
    power = torch.zeros(columns.robot.n_dof, columns.n, dtype=torch.float64)
    weight = statistics.torque[..., 0].sum(0)
    for joint, total in enumerate(statistics.total()):
        if weight[joint] > 0:
            own = total.diagonal()[:-1] / weight[joint]
            still = own == 0.0
            if bool(still.any()):
                own = torch.where(still, columns.in_unit_motion(joint).square(), own)
            power[joint, columns.of_joint[joint]] = own
    return power.sqrt()


def inverse_root(A: Tensor) -> Tensor:
    """Return S with S S' = A^-1. The matrix is balanced first: its entries differ by the square of the body's size."""
    d = A.diagonal().rsqrt()
    return d.unsqueeze(1) * torch.linalg.inv(torch.linalg.cholesky(d.unsqueeze(1) * A * d)).mT


def orthonormal_steps(F: Tensor) -> Tensor:
    """Return the blocks (b, 10, 10) of T, pi = pi_F + T y for J = F (1 + sum_k y_k B_k) F' with factors F (b, 4, 4).

    B is orthonormal, so that -logdet J has curvature 1 in y at y = 0.
    """
    F = F.unsqueeze(1)
    return from_pseudo_inertia(F @ ORTHONORMAL @ F.mT).mT


def local_coordinates(prior: Prior, x: Tensor) -> Tensor:
    """Return T (10 b, 10 b) of coordinates y at x, with inertial parameters x + T y: kappa D has curvature 1 in y."""
    F = torch.linalg.cholesky(pseudo_inertia(x[prior.inertial].reshape(-1, PARAMETERS_PER_BODY)))
    return torch.block_diag(*orthonormal_steps(F), F.new_zeros(0, 0)) / prior.kappa**0.5


def local_covariance(prior: Prior, x: Tensor) -> Tensor:
    """Return the inverse curvature of kappa D at x, for the inertial parameters that are fitted (10 b, 10 b).

    It scales with the body: for a body that is ten times heavier in the fit, its relative width is the same as at J0.
    """
    T = local_coordinates(prior, x)
    return T @ T.T


def unphysical_bodies(columns: Columns) -> tuple[str, ...]:
    """Return the names of bodies whose URDF inertia no extended body can have; massless ones are not counted."""
    pi = columns.robot.pi.reshape(-1, PARAMETERS_PER_BODY)
    return tuple(
        n for n, m, ok in zip(columns.robot.body_names, pi[:, 0], is_extended(pi), strict=True) if m > 0 and not ok
    )
