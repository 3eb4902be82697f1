"""The registry: every estimator of a robot's parameters by its name, with one result."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.dataset.columns import Candidate
from torchrbd.display import Remark
from torchrbd.errors import OptionError
from torchrbd.estimators import check_estimators
from torchrbd.inference.estimators.instrumental import instrumental_variables
from torchrbd.inference.estimators.plain import regress, regress_on_noisy_inputs
from torchrbd.inference.estimators.problem import LinearProblem, linear_problem
from torchrbd.inference.estimators.reweighted import iteratively_reweighted
from torchrbd.inference.physical.fitting import not_negative
from torchrbd.inference.physical.projection import project
from torchrbd.inference.preparation import Prepared
from torchrbd.parameters import PARAMETERS_PER_BODY, is_physical
from torchrbd.regression.base import Regression
from torchrbd.regression.choice import BestRegression
from torchrbd.regression.classical import Stepwise, TotalLeastSquares, TruncatedSVD
from torchrbd.regression.cross_validated import Lasso, PartialLeastSquares, PrincipalComponents, Ridge
from torchrbd.regression.errors_in_variables import EIVARD
from torchrbd.regression.noisy_input import NoisyInputRegression

Estimator = Callable[[LinearProblem], tuple[Tensor, Remark | None]]
"""Finds x (n,), and says what a user should know of it."""


@dataclass(frozen=True)
class Estimate:
    """What one estimator says of a robot.

    Attributes:
        name: of the estimator.
        raw: (n,) coefficients in the layout of ``Columns``, as estimated.
        was_physical: whether every body of ``raw`` has a positive definite pseudo-inertia, and no friction drives.
        x: (n,) physical ones: ``raw``, or where it is not physical its projection in the metric of the data, whose
            torque on the fitted blocks is nearest.
        seconds: of the estimate, without reading and filtering.
        remark: what a user should know, or None.
    """

    name: str
    raw: Tensor
    was_physical: bool
    x: Tensor
    seconds: float
    remark: Remark | None


def estimate(prepared: Prepared, name: str, terms: Sequence[Candidate] = ()) -> Estimate:
    """Estimate a robot's parameters from the blocks that are not held out.

    Args:
        prepared: the data, with filtered states.
        name: one of ``estimators()``.
        terms: effects that are fitted with the inertial parameters.

    Raises:
        OptionError: an unknown name, or an estimator that cannot be used on these recordings.
    """
    check_estimators([name], estimators())
    start = time.perf_counter()
    problem = linear_problem(prepared, terms)
    raw, remark = _ESTIMATORS[name](problem)
    if not bool(torch.isfinite(raw).all()):
        raise OptionError(f"estimator '{name}' finds no finite parameters on these recordings; use another")
    bodies = raw[prepared.prior.inertial].reshape(-1, PARAMETERS_PER_BODY)
    signs = not_negative(prepared.columns, terms)
    physical = bool(is_physical(bodies).all()) and bool((signs @ raw >= 0.0).all())
    x = raw if physical else project(prepared.prior, raw, problem.information(), problem.free_terms, signs)
    return Estimate(name, raw, physical, x, time.perf_counter() - start, remark)


def estimators() -> tuple[str, ...]:
    """Return the names of all estimators."""
    return tuple(_ESTIMATORS)


def _ordinary(problem: LinearProblem) -> tuple[Tensor, Remark | None]:
    """Least squares on base parameters; all joints count alike, a newton metre of one as much as of another."""
    seen = problem.training.torque[..., 0].sum(0) > 0
    return problem.least_squares(seen.double())[0], None


def _weighted(problem: LinearProblem) -> tuple[Tensor, Remark | None]:
    """Least squares on base parameters, joints weighted by their residual variance."""
    return problem.weighted()[0], None


def _physical(problem: LinearProblem) -> tuple[Tensor, Remark | None]:
    """The physically valid fit with the entropic prior."""
    return problem.prepared.fit(problem.terms).x, None


def _plain(regression: Callable[[], Regression]) -> Estimator:
    return lambda problem: regress(problem, regression)


def _noise_aware(regression: Callable[[Tensor], Regression]) -> Estimator:
    return lambda problem: regress_on_noisy_inputs(problem, regression)


_ESTIMATORS: dict[str, Estimator] = {
    "physical": _physical,
    "ols": _ordinary,
    "wls": _weighted,
    "irls": iteratively_reweighted,
    "iv": instrumental_variables,
    "svd": _plain(TruncatedSVD),
    "ridge": _plain(Ridge),
    "tls": _plain(TotalLeastSquares),
    "lasso": _plain(Lasso),
    "stepwise": _plain(Stepwise),
    "pls": _plain(PartialLeastSquares),
    "pcr": _plain(PrincipalComponents),
    "eiv-ard": _noise_aware(EIVARD),
    "noisy-input": _noise_aware(lambda noise: NoisyInputRegression(noise.diagonal())),
    "best": _noise_aware(BestRegression),
}
