"""Fit inertial parameters and terms together: physically valid, with errors that respect correlated noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import BlockStatistics
from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.dataset.resting import without_columns_at_rest
from torchrbd.dataset.shapes import ShapeSlope
from torchrbd.effects import Site, Term
from torchrbd.inference.physical.scatter import Scatter
from torchrbd.inference.physical.uncertain_states import UncertainStates
from torchrbd.inference.torque_error import Fit
from torchrbd.likelihood.equations import Equations, first_noise_variance, scaled_equations, with_noise
from torchrbd.likelihood.gaussian import nonnegative
from torchrbd.likelihood.physical_fit import PhysicalFit, fit_with_signs
from torchrbd.likelihood.urdf_prior import Prior
from torchrbd.model import RigidBodyDynamics, known_terms
from torchrbd.recordings import States

_MOST_ROUNDS, _SETTLED = 6, 0.1
_LEAST_VARIANCE = 1e-12
# A truncation that takes less than 3e-7 of a coefficient's probability changes nothing.
_CERTAIN_SIGN = 5.0


@dataclass(frozen=True)
class FittedModel:
    """A fitted coefficient vector.

    Attributes:
        columns: layout of x.
        terms: what is free besides the rigid body: terms, and slopes of refined ones in their shapes. The coefficient
            of a slope stays zero; it carries the covariance of the shape.
        x: (n,) coefficients.
        free: indices of the fitted ones.
        laplace: (n_free, n_free) covariance from the curvature, counting independent samples.
        covariance: (n_free, n_free) the same, widened where the scatter over blocks says so.
        noise_variance: (n_dof,) of the band-limited torque.
        converged: False if the torques are so far from any rigid body's that the fit stopped early.
        prior_covariance: (n_free, n_free) covariance before the data.
        scatter: how far single blocks move the fit, where that has been computed.
    """

    columns: Columns
    terms: tuple[Candidate, ...]
    x: Tensor
    free: Tensor
    laplace: Tensor
    covariance: Tensor
    noise_variance: Tensor
    converged: bool
    prior_covariance: Tensor
    scatter: Scatter | None = None

    @property
    def pi(self) -> Tensor:
        """Inertial parameters (n_params,)."""
        return self.x[: self.columns.robot.n_params]

    @property
    def proper_terms(self) -> tuple[Candidate, ...]:
        """The terms without slopes."""
        return tuple(c for c in self.terms if not isinstance(c, ShapeSlope))

    def inertial_covariance(self, covariance: Tensor) -> Tensor:
        """Return what a covariance (n_free, n_free) says of all inertial parameters, zero for held ones."""
        n = self.columns.robot.n_params
        whole = torch.zeros(n, n, dtype=torch.float64)
        at = torch.nonzero(self.free < n).flatten()
        own = self.free[at]
        whole[own.unsqueeze(1), own] = covariance[at.unsqueeze(1), at]
        return whole

    def position(self, candidate: Candidate) -> Tensor:
        """Return where the columns (K,) of a fitted term stand among the free ones."""
        return torch.tensor([int((self.free == k).nonzero()) for k in self.columns.of(candidate)])

    def coefficients(self, candidate: Candidate) -> tuple[Tensor, Tensor]:
        """Return coefficients (K,) and covariance (K, K) of a fitted term."""
        at = self.position(candidate)
        return self.x[self.free[at]], self.covariance[at.unsqueeze(1), at]

    def module(self) -> RigidBodyDynamics:
        """Return the model as a module; friction of the URDF stays in it unless a term has re-fitted it.

        Rotors and springs of the robot's description stay: what is fitted is added to them.
        """
        columns = self.columns
        refitted = {k for c in self.terms for k in columns.of(c)}
        kept = [
            Term(c.effect, c.site, self.x[columns.of(c)], c.shape)
            for c in columns.urdf_friction
            if not refitted & set(columns.of(c)) and bool(self.x[columns.of(c)].any())
        ]
        shared: set[int] = set()
        fitted = []
        for c in self.proper_terms:
            index = columns.of(c)
            # Two terms may share a column; its whole coefficient belongs to the first.
            w = torch.stack([self.x[k] * float(k not in shared) for k in index])
            own = not shared.issuperset(index)
            shared.update(index)
            # A coefficient that is fitted as zero has a posterior too.
            if own:
                fitted.append(Term(c.effect, c.site, w, c.shape))
        width = torch.tensor([scale.rest_width for scale in columns.scales], dtype=torch.float64)
        return RigidBodyDynamics(columns.robot, self.pi, [*kept, *known_terms(columns.robot), *fitted], width)


def fit_model(
    statistics: BlockStatistics,
    prior: Prior,
    terms: Sequence[Candidate] = (),
    noise: Tensor | None = None,
    states: UncertainStates | None = None,
) -> FittedModel:
    """Fit the rigid body and terms on blocks.

    Args:
        statistics: blocks to fit.
        prior: prior of the inertial parameters.
        terms: terms that are fitted with them; other columns keep the URDF's value.
        noise: (n_dof,) variances of the torque noise; estimated if not given.
        states: information lost to uncertain states, if they were smoothed.
    """
    columns = statistics.columns
    term_columns = torch.tensor(sorted({k for c in terms for k in columns.of(c)}), dtype=torch.long)
    statistics = without_columns_at_rest(statistics)
    totals, positive = statistics.total(), positive_columns(columns, terms)
    signs, all_signs = not_negative(columns, _may_be_none(terms)), not_negative(columns, terms)
    variance = first_noise_variance(statistics) if noise is None else noise
    if states is not None and noise is None:
        variance = torch.where(torch.isfinite(variance), states.torque_variance, variance)

    # The noise of the physical fit: an impossible robot may explain impossible data without any.
    def fitted(variance: Tensor) -> tuple[tuple[PhysicalFit, Equations], Tensor, Tensor]:
        equations = scaled_equations(prior, totals, columns, 1.0 / variance)
        if states is not None:
            equations = states.discount(prior, equations)
        fit = fit_with_signs(prior, equations, term_columns, signs)
        x, covariance = _estimate(prior, fit)
        bounded = _with_signs(prior, equations, x, covariance, positive)
        if bounded is not equations:
            fit = fit_with_signs(prior, bounded, term_columns, all_signs)
            x, covariance = _estimate(prior, fit)
        return (fit, equations), x, covariance

    rounds, used = _MOST_ROUNDS if noise is None else 0, None if states is None else states.used
    (fit, equations), variance = with_noise(
        statistics, fitted, variance, rounds=rounds, tolerance=_SETTLED, states=used
    )
    S = prior.scale[:, fit.free]
    stiffness, axes = torch.linalg.eigh(fit.precision)
    filling = _sandwich_filling(statistics, prior, fit, equations.H, variance)
    # Widened along the axes of the precision: combinations that are known well are widened for themselves.
    wider = ((axes.T @ filling @ axes).diagonal() / stiffness).clamp_min(1.0)
    axes = S[fit.free] @ axes
    laplace, covariance = (axes / stiffness) @ axes.T, (axes * (wider / stiffness)) @ axes.T
    before = S[fit.free] @ S[fit.free].T
    return FittedModel(columns, tuple(terms), fit.x, fit.free, laplace, covariance, variance, fit.converged, before)


def _estimate(prior: Prior, fit: PhysicalFit) -> tuple[Tensor, Tensor]:
    """Return the coefficients (n,) of a fit and their covariance (n, n)."""
    covariance, at = torch.zeros_like(prior.scale), fit.free
    covariance[at.unsqueeze(1), at] = torch.linalg.inv(fit.precision)
    return fit.x, prior.scaled(prior.scaled(covariance).T)


def positive_columns(columns: Columns, terms: Sequence[Candidate]) -> list[int]:
    """Return the columns of coefficients that physics keeps above zero."""
    own = {c for c in terms if not isinstance(c, ShapeSlope)} - set(_may_be_none(terms))
    return sorted({columns.of(c)[i] for c in own for i in c.effect.prior.positive})


def _may_be_none(terms: Sequence[Candidate]) -> list[Candidate]:
    return [c for c in terms if not isinstance(c, ShapeSlope) and c.effect.prior.may_be_none]


def not_negative(columns: Columns, terms: Sequence[Candidate]) -> Tensor:
    """Return the weights (K, n) of sums of coefficients that physics keeps from being negative."""
    found: dict[tuple[tuple[int, float], ...], None] = {}
    for c in terms:
        if not isinstance(c, ShapeSlope):
            index = columns.of(c)
            for weights in c.effect.prior.not_negative(len(index)):
                found[tuple((k, w) for k, w in zip(index, weights, strict=True) if w)] = None
    signs = torch.zeros(len(found), columns.n, dtype=torch.float64)
    for row, places in zip(signs, found, strict=True):
        for k, weight in places:
            row[k] = weight
    return signs


def _with_signs(
    prior: Prior, equations: Equations, x: Tensor, covariance: Tensor, positive: Sequence[int]
) -> Equations:
    """Return equations whose prior is truncated where coefficients would be negative, see ``nonnegative``."""
    std = covariance.diagonal().clamp_min(0.0).sqrt()
    # What the data say nothing of stays where the prior has it.
    positive = [k for k in positive if float(equations.H[k, k]) > 0.0]
    if all(float(x[k]) >= _CERTAIN_SIGN * float(std[k]) for k in positive):
        return equations
    at = torch.tensor(positive, dtype=torch.long)
    precision, shift, _ = map(
        torch.from_numpy, nonnegative(x[at].numpy(), covariance[at.unsqueeze(1), at].contiguous().numpy())
    )
    size = prior.scale.diagonal()[at]
    H, h = equations.H.clone(), equations.h.clone()
    H[at, at] += size**2 * precision
    h[at] += size * (shift - precision * prior.mean[at])
    return Equations(H, h)


def _sandwich_filling(
    statistics: BlockStatistics, prior: Prior, fit: PhysicalFit, H: Tensor, variance: Tensor
) -> Tensor:
    """Return sum_b s_b s_b' + prior curvature, with s_b the gradient that block b contributes, in prior coordinates.

    Blocks are long against the correlation time, so that their scatter measures what correlated noise does to x.
    """
    n_blocks, scores = len(statistics), statistics.scores(fit.x, 1.0 / variance) @ prior.scale[:, fit.free]
    scores = scores - scores.mean(0)
    prior_curvature = fit.precision - H[fit.free.unsqueeze(1), fit.free]
    return n_blocks / max(n_blocks - 1, 1) * scores.T @ scores + prior_curvature


def judge(statistics: BlockStatistics, x: Tensor) -> Fit:
    """Return how well coefficients predict blocks; joints whose torque there is missing or constant are left out."""
    mse = statistics.squared_error(x).sum(0) / statistics.torque[..., 0].sum(0).clamp_min(1e-300)
    variance, names = statistics.torque_variance(), statistics.columns.robot.joint_names
    seen = _varied(statistics)
    return Fit(
        nmse={names[j]: float(mse[j] / variance[j].clamp_min(1e-300)) for j in seen},
        rmse={names[j]: float(mse[j].sqrt()) for j in seen},
    )


def nmse_of_blocks(statistics: BlockStatistics, x: Tensor) -> Tensor:
    """Return what each block (B,) adds to the sum of all joints' nmse, as of ``judge``."""
    return statistics.squared_error(x) @ nmse_weights(statistics)


def nmse_weights(statistics: BlockStatistics, joints: Sequence[int] | None = None) -> Tensor:
    """Return what makes parts of nmse of squared errors, (n_dof,) [1 / (N m)^2] or [1 / N^2].

    Args:
        statistics: all blocks that are judged.
        joints: which count, of those whose torque there is, and which is not constant; all if not given.
    """
    counted = [j for j in _varied(statistics) if joints is None or j in joints]
    weights, samples = torch.zeros(len(statistics.moments), dtype=torch.float64), statistics.torque[..., 0].sum(0)
    weights[counted] = 1.0 / (samples * statistics.torque_variance())[counted]
    return weights


def _varied(statistics: BlockStatistics) -> list[int]:
    """Return the joints whose torque there is, and which is not constant."""
    square = statistics.torque[..., 2].sum(0) / statistics.torque[..., 0].sum(0).clamp_min(1e-300)
    return torch.nonzero(statistics.torque_variance() > _LEAST_VARIANCE * square).flatten().tolist()


def relative_to_constant(fitted: BlockStatistics, judged: BlockStatistics, x: Tensor) -> Tensor:
    """Return squared errors on blocks over those of a constant, the mean of other blocks' torque, (n_dof,).

    Unlike nmse it does not expect a model to know the mean of a short block. NaN where either has no torque.

    Args:
        fitted: blocks that have the mean.
        judged: blocks to predict.
        x: coefficients (n,).
    """
    squares, constant = squares_relative_to_constant(fitted, judged, x)
    return torch.where(constant > 0, squares / constant.clamp_min(1e-300), torch.nan)


def squares_relative_to_constant(fitted: BlockStatistics, judged: BlockStatistics, x: Tensor) -> tuple[Tensor, Tensor]:
    """Return the squared errors of coefficients x and of a constant, (n_dof,) each, as of ``relative_to_constant``.

    Both are zero where it is not a number.
    """
    count, total, _ = fitted.torque.sum(0).unbind(-1)
    mean = total / count.clamp_min(1e-300)
    n, first, second = judged.torque.sum(0).unbind(-1)
    constant = second - 2.0 * mean * first + mean.square() * n
    measured = (count > 0) & (constant > _LEAST_VARIANCE * second)
    return measured * judged.squared_error(x).sum(0), measured * constant


def predict(columns: Columns, x: Tensor, states: States) -> Tensor:
    """Return the torque (n_dof, N) that coefficients x predict for a tile, at its full rate."""
    rigid = columns.robot.inverse_dynamics(states.q.T, states.qd.T, states.qdd.T, x[: columns.robot.n_params]).T
    return rigid + columns.term_torque(columns.signals(states), x)


def term_candidates(columns: Columns, identifiers: Sequence[str]) -> tuple[Candidate, ...]:
    """Return the named effects at all their sites, with the middle one of their shapes."""
    by_site: dict[tuple[str, Site], list[Candidate]] = {}
    for c in columns.candidates:
        by_site.setdefault((c.effect.id, c.site), []).append(c)
    return tuple(own[len(own) // 2] for (name, _), own in by_site.items() if name in identifiers)
