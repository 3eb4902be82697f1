"""The physically valid fit as a scikit-learn regressor: states in, torques out."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, validate_data
from torch import Tensor
from typing_extensions import Self

from torchrbd._runtime.threads import single_threaded
from torchrbd.dataset.columns import Columns
from torchrbd.dataset.given_states import given_statistics
from torchrbd.dataset.scales import joint_scales
from torchrbd.effects import effect
from torchrbd.errors import InputError
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.physical.fitting import fit_model, term_candidates
from torchrbd.likelihood.urdf_prior import KAPPA, data_prior
from torchrbd.nuisance.joint_friction import FRICTION_EFFECTS
from torchrbd.robot import RobotModel

SIGNALS = ("q", "qd", "qdd")
"""Of each sample, in the order of X's columns; each of all joints."""


class DynamicsRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):
    """Learn a robot's inverse dynamics from states and torques: inertial parameters that a rigid body can have.

        minimise  sum_i sum_j w_i (tau_ij - Y_j(x_i) pi - friction_j(qd_ij))^2 / (2 sigma_j^2)  +  kappa D(pi | pi_URDF)

    Joints are weighed by the noise sigma, the standard deviation of the residual. D is the entropic divergence from the
    URDF; it is infinite for inertias that no body can have. Where the data has no information, the URDF's inertia
    stays, so that few samples suffice.

    States are taken as exact and samples as independent. Noise in positions, amplified by differentiation, biases this
    fit like any regression. Densely sampled torques look more certain than they are: a larger ``kappa``, thinning or
    ``sample_weight`` helps. ``torchrbd.identify`` handles both where there are recordings.

    Args:
        urdf: the robot, or its URDF.
        friction: fit viscous and Coulomb friction, by direction, at every joint; else that of the URDF's <dynamics>
            tags stays.
        kappa: weight of the URDF's inertia against the data, above 0 [-].
        gravity: (3,) in the base's axes [m/s^2]; (0, 0, -9.81), or that of a ``RobotModel``, if None.
        trust: links whose inertia is not fitted, by name.

    Attributes:
        model_: the fitted ``torchrbd.RigidBodyDynamics``, for gradients, simulation and export.
        robot_: the robot as its URDF has it; ``robot_.joint_names`` has the order of the joints in X and y.
        noise_std_: (n,) standard deviation of the residual torque [N m, N]; NaN where none was used.
        n_features_in_: 3 n.
        feature_names_in_: of X's columns, if they have names.

    Example:
        >>> import numpy as np, torchrbd
        >>> from sklearn.model_selection import GridSearchCV, GroupKFold
        >>> X = np.hstack((q, qd, qdd))  # (N, 3 n), joints in the robot's order
        >>> search = GridSearchCV(
        ...     torchrbd.DynamicsRegressor("robot.urdf"), {"kappa": [1.0, 10.0, 100.0]}, cv=GroupKFold(5)
        ... )
        >>> search.fit(X, tau, groups=seconds)  # neighbours in time belong into one fold
        >>> search.best_estimator_.predict(X)  # (N, n) [N m, N]
    """

    def __init__(
        self,
        urdf: RobotModel | str | Path | bytes,
        *,
        friction: bool = True,
        kappa: float = KAPPA,
        gravity: Sequence[float] | None = None,
        trust: Sequence[str] = (),
    ) -> None:
        self.urdf = urdf
        self.friction = friction
        self.kappa = kappa
        self.gravity = gravity
        self.trust = trust

    @single_threaded()
    def fit(self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> Self:
        """Fit to samples.

        Args:
            X: (N, 3 n) all joints' positions, then velocities, then accelerations, [rad, m] and per second, per second
                squared, joints in the robot's order.
            y: (N, n) torques [N m, N]; (N,) will do for one joint.
            sample_weight: (N,) how many independent samples each counts for; 1 if None.

        Raises:
            InputError: a robot or option that cannot be used, or data that are not of this robot.
            ValueError: data that are no finite numbers, or fewer than two samples.
        """
        options = {"kappa": self.kappa, "gravity": self.gravity, "trust": self.trust}
        robot, _, settings = read_arguments(self.urdf, [], options, type(self).__name__)
        states, tau, weight = self._samples(robot, X, y, sample_weight)
        used, tau = _varying(robot, tau), tau - robot.known_torque(states[0].T, states[2].T).T
        low, high = states[0].amin(1), states[0].amax(1)
        scales = joint_scales(states[1].abs().amax(1), torch.zeros(robot.n_dof), low, high)
        columns = Columns(robot, [effect(name) for name in FRICTION_EFFECTS] if self.friction else [], scales)
        statistics = given_statistics(columns, states, tau, weight * used.unsqueeze(1))
        prior = data_prior(statistics, settings.held_bodies(robot), settings.kappa)
        found = fit_model(statistics, prior, term_candidates(columns, FRICTION_EFFECTS))
        if not found.converged:
            far = "the fit stopped early: the torques are far from those of any rigid body; check units and signs"
            warnings.warn(far, ConvergenceWarning, stacklevel=3)
        self.robot_, self.model_, self._flat = robot, found.module(), np.ndim(cast(Any, y)) == 1
        self.noise_std_ = torch.where(used, found.noise_variance.sqrt(), torch.nan).numpy()
        return self

    def predict(self, X: ArrayLike) -> np.ndarray:
        """Return the torques (N, n) [N m, N] of states X (N, 3 n); (N,) if y was.

        Raises:
            sklearn.exceptions.NotFittedError: before a fit.
            ValueError: X has other columns than in the fit, or no finite numbers.
        """
        check_is_fitted(self)
        inputs = np.asarray(validate_data(self, cast(Any, X), dtype=np.float64, reset=False))
        with torch.no_grad():
            tau = self.model_(*_states(inputs, self.robot_.n_dof).mT).numpy()
        return tau[:, 0] if self._flat else tau

    def _samples(
        self, robot: RobotModel, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return states (3, n, N), torques (n, N) and weights (N,) of the samples that count, checked."""
        checks: Any = {"dtype": np.float64, "multi_output": True, "y_numeric": True, "ensure_min_samples": 2}
        inputs, outputs = map(np.asarray, validate_data(self, cast(Any, X), cast(Any, y), **checks))
        n, joints = robot.n_dof, ", ".join(robot.joint_names)
        if inputs.shape[1] != 3 * n:
            raise InputError(
                f"X has {inputs.shape[1]} feature(s), but robot '{robot.name}' has {n} joints ({joints}); expected "
                f"{3 * n}: all q, then all qd, then all qdd"
            )
        if outputs.shape[1:] != (n,) and not (outputs.ndim == n == 1):
            raise InputError(f"y has shape {outputs.shape}; expected ({len(inputs)}, {n}), the torques of {joints}")
        expected = [f"{signal}_{joint}" for signal in SIGNALS for joint in robot.joint_names]
        names = list(getattr(self, "feature_names_in_", expected))
        if sorted(names) == sorted(expected) and names != expected:
            raise InputError(f"X has its columns in another order than the robot; expected {', '.join(expected)}")
        weight = np.ones(len(inputs))
        if sample_weight is not None:
            weight = np.asarray(_check_sample_weight(sample_weight, inputs, dtype=np.float64))
        if (weight < 0).any() or not weight.any():
            raise InputError("sample_weight: none may be below zero, nor all be zero")
        there = weight > 0
        tau = np.array(outputs.reshape(-1, n).T[:, there], dtype=np.float64, order="C")
        return _states(inputs[there], n), torch.from_numpy(tau), torch.from_numpy(weight[there])


def _states(X: np.ndarray, n_dof: int) -> Tensor:
    """Return q, qd and qdd (3, n_dof, N) of samples (N, 3 n_dof)."""
    # A copy, since the samples may be read-only, which tensors cannot be.
    return torch.from_numpy(np.array(X.reshape(len(X), 3, n_dof).transpose(1, 2, 0), order="C"))


def _varying(robot: RobotModel, tau: Tensor) -> Tensor:
    """Return (n_dof,) bool, the joints whose torque (n_dof, N) changes; warn of the others.

    Raises:
        InputError: there is none.
    """
    used = tau.amax(1) > tau.amin(1)
    silent: Any = [name for name, varies in zip(robot.joint_names, used.tolist(), strict=True) if not varies]
    if not used.any():
        raise InputError(f"y: the torque of {', '.join(silent)} never changes; nothing can be fitted")
    if silent:
        warnings.warn(f"y: the torque of {', '.join(silent)} never changes and is not used", UserWarning, stacklevel=4)
    return used
