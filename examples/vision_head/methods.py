"""The methods that are compared: each makes inertial parameters (n_params,) of the same recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

from torch import Tensor

from torchrbd import Recording, RobotModel, identify
from torchrbd.inference.estimators import estimate, estimators
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings

URDF_AS_GIVEN, DEFAULT = "URDF as given", "torchrbd"
CLASSICAL = ("ols", "svd", "ridge", "tls", "lasso", "stepwise", "pls", "pcr", "wls", "irls", "iv")
"""The paper's rivals and those of the robot field; they know of no physical validity, nor of noise in the inputs."""


@dataclass(frozen=True)
class Case:
    """What an engineer has: a URDF whose inertials are off, and a recording."""

    robot: RobotModel
    recording: Recording

    @cached_property
    def prepared(self) -> Prepared:
        """Moments of the filtered recording: one cut-off and one filter for all; its states are not smoothed."""
        return prepare(self.robot, [self.recording], Settings(estimator="physical"), ())


Method = Callable[[Case], Tensor]


def default(case: Case) -> Tensor:
    """Return what ``torchrbd.identify`` finds of the rigid body alone."""
    return identify(case.robot, case.recording, effects=[]).model.pi.detach()


def registered(case: Case, name: str, projected: bool) -> Tensor:
    """Return what an estimator of the registry finds.

    Args:
        case: URDF and recording.
        name: of the estimator.
        projected: take the physical parameters that are nearest, where it finds others.
    """
    found = estimate(case.prepared, name)
    return (found.x if projected else found.raw)[: case.robot.n_params]


def methods(projected: bool = False) -> dict[str, Method]:
    """Return all methods by name.

    Args:
        projected: project what the classical methods find; by default it is used as it is.
    """
    plain = {n: partial(registered, name=n, projected=projected or n not in CLASSICAL) for n in estimators()}
    return {URDF_AS_GIVEN: lambda case: case.robot.pi, **plain, DEFAULT: default}
