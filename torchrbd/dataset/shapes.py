"""The derivative of a term's torque with respect to its shape parameters, as columns of the linear model.

    tau(theta + d) = sum_k w_k phi_k(theta) + d sum_k w_k dphi_k / dtheta

A fit with such a column gives the Gauss-Newton step d of the profile loss. Its covariance is that of theta with all
coefficients free: with B the other columns and g this one, the curvature of the profile loss is g'g - g'B (B'B)^-1 B'g.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.effects import Shape, Signals

# Step of the central difference, as a fraction of the distance between grid points.
_STEP = 0.01
# Tolerance, as a fraction of the largest, between parameters that follow from the coefficients and their values.
_AGREED_PART = 0.01


@dataclass(frozen=True)
class ShapeSlope(Candidate):
    """The slope of a term in one shape parameter: a candidate with one column.

    ``parameter`` theta; ``step`` of the central difference; ``weights`` w (K,) of the term.
    """

    parameter: str
    step: float
    weights: tuple[float, ...]

    def features(self, signals: Signals) -> dict[str, Tensor]:
        """Return sum_k w_k (phi_k(theta + h) - phi_k(theta - h)) / 2h under its label."""
        up, down = (
            self.effect.features_at(signals, self.site, _moved(self.shape, self.parameter, h))
            for h in (self.step, -self.step)
        )
        pairs = zip(self.weights, up.values(), down.values(), strict=True)
        (label,) = self.labels
        return {label: sum(w * (a - b) for w, a, b in pairs) / (2.0 * self.step)}  # type: ignore[dict-item]

    def belongs_to(self, term: Candidate) -> bool:
        """Return whether it is a slope of this term."""
        return (self.effect.id, self.site, self.shape) == (term.effect.id, term.site, term.shape)


@dataclass(frozen=True)
class Axis:
    """Values of one shape parameter on the grid of an effect, ascending."""

    values: tuple[float, ...]

    @property
    def reach(self) -> float:
        """Distance between the first and the last value."""
        return self.values[-1] - self.values[0]

    @property
    def std(self) -> float:
        """Standard deviation of a uniform distribution between these."""
        return self.reach / 12**0.5

    def spacing(self, value: float) -> float:
        """Return the distance to the neighbours of a value, 0 if there is one value only."""
        low, high = self._around(value)
        return (self.values[high] - self.values[low]) / max(1, high - low)

    def neighbours(self, value: float) -> tuple[float, float]:
        """Return the next values below and above; at an end, the end itself."""
        low, high = self._around(value)
        return self.values[low], self.values[high]

    def limits(self, value: float) -> tuple[float, float]:
        """Return the limits of one step: the neighbours, at an end half a spacing beyond, never across zero."""
        low, high = self.neighbours(value)
        first, last = self.values[0], self.values[-1]
        if low == first:
            low -= 0.5 * min(self.spacing(first), first if first > 0 else math.inf)
        if high == last:
            high += 0.5 * min(self.spacing(last), -last if last < 0 else math.inf)
        return low, high

    def _around(self, value: float) -> tuple[int, int]:
        at = min(range(len(self.values)), key=lambda k: abs(self.values[k] - value))
        return max(at - 1, 0), min(at + 1, len(self.values) - 1)


def axes(columns: Columns, term: Candidate) -> dict[str, Axis]:
    """Return the values that the grid has for each shape parameter of a term but those that choose between kinds or
    follow from the coefficients.

    Of n shapes of its kind in d parameters, n^(1/d) values of each: a grid need not be a product, and points that
    differ in another parameter only say nothing of how finely to look at this one. Where recordings tell of no shape,
    such as of a joint that hardly moves, the term has the one that it has.
    """
    kinds, fixed = term.effect.kinds, (*term.effect.kinds, *term.effect.follows)
    grid: Sequence[Shape] = term.effect.shapes(columns.scale(term.site)) or (term.shape,)
    own = min(grid, key=lambda shape: sum(abs(shape[name] - term.shape[name]) for name in kinds))
    grid = [shape for shape in grid if all(shape[name] == own[name] for name in kinds)]
    values = {name: sorted({shape[name] for shape in grid}) for name in term.shape if name not in fixed}
    varied = sum(len(own) > 1 for own in values.values())
    most = math.ceil(len(grid) ** (1.0 / max(1, varied)) - 1e-9)
    return {name: Axis(_thinned(own, most)) for name, own in values.items()}


def varied(columns: Columns, term: Candidate) -> dict[str, Axis]:
    """Return the same without parameters that have one value in the grid: those keep it."""
    return {name: axis for name, axis in axes(columns, term).items() if axis.reach > 0}


def agrees(term: Candidate, weights: Tensor) -> bool:
    """Return whether a term's shape parameters that follow from its coefficients (K,) agree with them."""
    follows, asked = term.effect.follows, term.effect.agreeing(weights, term.shape)
    change = max((abs(asked[name] - term.shape[name]) for name in follows), default=0.0)
    return change <= _AGREED_PART * max((abs(asked[name]) for name in follows), default=0.0)


def _thinned(values: Sequence[float], most: int) -> tuple[float, ...]:
    """Return at most ``most`` of ascending values, including the ends."""
    n = min(most, len(values))
    return tuple(values[round(k * (len(values) - 1) / max(1, n - 1))] for k in range(n))


def slopes(columns: Columns, term: Candidate, weights: Tensor) -> list[ShapeSlope]:
    """Return the slopes of a term with coefficients ``weights`` (K,) with respect to its shape parameters."""
    found, given = [], tuple(weights.tolist())
    for name, axis in varied(columns, term).items():
        label, step = (
            f"slope of {given} {term.effect.id} at {term.site} in {name}",
            _STEP * axis.spacing(term.shape[name]),
        )
        found.append(ShapeSlope(term.effect, term.site, term.shape, (label,), name, step, given))
    return found


def feature_slopes(columns: Columns, term: Candidate) -> dict[str, list[ShapeSlope]]:
    """Return, by shape parameter, the slopes of a term's features, each alone with coefficient one."""
    found: dict[str, list[ShapeSlope]] = {}
    for one in torch.eye(len(term.labels), dtype=torch.float64):
        for slope in slopes(columns, term, one):
            found.setdefault(slope.parameter, []).append(slope)
    return found


def _moved(shape: Shape, name: str, step: float) -> Shape:
    return {**shape, name: shape[name] + step}
