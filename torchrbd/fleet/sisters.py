"""Which robot differs from the others of a fleet: its parameters against the fleet's median.

Robots with the same base parameters (same names, same K) are sisters. Parameter k of robot i has the value x_ik with
the standard deviation s_ik of its posterior; base parameters, and coefficients of friction and other terms:

    m_k = median_i x_ik,   u_ik^2 = s_ik^2 + pi/2 median_i s_ik^2 / n,   z_ik = (x_ik - m_k) / sqrt(u_ik^2 + t_k^2)
    t_k^2 = (1.4826 b median_i |x_ik - m_k|)^2 - median_i u_ik^2, or 0,   b = n / (n - 0.8)

t_k is the natural scatter of the fleet, or that of intervals that are too narrow: where friction scatters by 30 %, a
robot has to be off by more. It is at least v_k median_l (t_l / v_l) over the L parameters l of the same kind, since one
median is uncertain in a small fleet. v is the size of a parameter; for base parameters, that of the bodies in it. The
second part of u is the error of the median. A robot differs where

    N P p(z_ik) < 0.01   and   |x_ik - m_k| > f v_k

with N robots and P parameters (Bonferroni). p is the two-sided probability of Student's t with
0.37 (n - 1) L (1 + u^2 / t^2)^2 degrees of freedom (Welch, Satterthwaite; 0.37 is the efficiency of a median of
absolute deviations). f is the largest negligible difference: 2 % of a coefficient and 0.5 % of the bodies in a base
parameter. Medians need more than half of the sisters to be sound.

The level is one false alarm in a hundred fleets of equal robots. Large fleets reach it. Small ones have fewer where
only errors make them differ; those that scatter more have more, three of a hundred with six robots, since t is hardly
known then (``benchmarks/fleet_alarms.py``).

Source: Rousseeuw, Croux, "Alternatives to the median absolute deviation", JASA 1993: 1.4826, 0.37; Croux, Rousseeuw,
"Time-efficient algorithms for two highly robust estimators of scale", COMPSTAT 1992: b, there for n > 9.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from torchrbd.comparison.inertia import MOST_OF_URDF
from torchrbd.comparison.reading import Inertia
from torchrbd.comparison.results import NEGLIGIBLE, NEGLIGIBLE_INERTIA
from torchrbd.diagnosis.results import Quantity
from torchrbd.fleet.results import Deviation, Member

LEVEL = 0.01
"""Probability of a false alarm in a fleet that is aimed at."""
LEAST_SISTERS = 6
"""With fewer robots the scatter of the fleet is too uncertain."""
_NORMAL, _EFFICIENCY, _LEAST_SHARE = 1.4826, 0.37, 1e-9


@dataclass(frozen=True)
class _Values:
    """One parameter of n robots: which they are, x (n,), s (n,), the size v, and what part of it is negligible."""

    name: str
    kind: str
    unit: str
    robots: np.ndarray
    values: np.ndarray
    std: np.ndarray
    size: float
    negligible: float

    @property
    def off(self) -> np.ndarray:
        """x - m, (n,)."""
        return self.values - np.median(self.values)

    @property
    def error(self) -> np.ndarray:
        """u, (n,)."""
        return np.sqrt(self.std**2 + np.pi / 2 * np.median(self.std**2) / len(self.std))

    def scatter(self) -> float:
        """Return t of this parameter alone."""
        b = len(self.values) / (len(self.values) - 0.8)
        apart = _NORMAL * b * float(np.median(np.abs(self.off)))
        return math.sqrt(max(apart**2 - float(np.median(self.error**2)), 0.0))


def sisters(members: Sequence[Member]) -> list[list[Member]]:
    """Group robots whose parameters mean the same, in the order of their first."""
    groups: list[list[Member]] = []
    for one in members:
        own = next((group for group in groups if _alike(group[0], one)), None)
        if own is None:
            groups.append([one])
        else:
            own.append(one)
    return groups


def _alike(one: Member, other: Member) -> bool:
    return one.robot == other.robot and one.inertia.alike(other.inertia)


def deviations(group: Sequence[Member]) -> dict[str, list[Deviation]]:
    """Return by robot where it differs from its sisters, the most certain first; empty lists where it does not."""
    found: dict[str, list[Deviation]] = {one.name: [] for one in group}
    if len(group) < LEAST_SISTERS:
        return found
    measured = [one for one in (*_inertial(group), *_terms(group)) if len(one.robots) >= LEAST_SISTERS]
    tests = sum(len(one.robots) for one in measured)
    scatters = {one.name: one.scatter() for one in measured}
    for one in measured:
        alike = [scatters[x.name] / max(x.size, 1e-300) for x in measured if x.kind == one.kind]
        scatter = max(scatters[one.name], one.size * float(np.median(alike)))
        spread = np.hypot(one.error, scatter)
        z = one.off / spread
        share = np.maximum((scatter / spread) ** 4, _LEAST_SHARE)
        chance = 2.0 * tests * stdtr(_EFFICIENCY * (len(one.robots) - 1) * len(alike) / share, -np.abs(z))
        differs = (chance < LEVEL) & (np.abs(one.off) > one.negligible * one.size)
        for k in np.flatnonzero(differs).tolist():
            value = Quantity(float(one.values[k]), float(one.std[k]), one.unit)
            numbers = float(np.median(one.values)), float(spread[k]), float(z[k]), float(chance[k])
            found[group[int(one.robots[k])].name].append(Deviation(one.name, one.kind, value, *numbers))
    return {name: sorted(own, key=lambda d: -abs(d.z)) for name, own in found.items()}


def median_inertia(group: Sequence[Member]) -> Inertia:
    """Return the base parameters of the fleet's median robot, as sure as it is."""
    first = group[0].inertia
    beta = np.stack([one.inertia.beta for one in group])
    covariance = np.median([one.inertia.covariance for one in group], axis=0) * (np.pi / 2 / len(group))
    return Inertia(
        first.columns,
        first.K,
        np.median([one.inertia.pi for one in group], axis=0),
        np.median(beta, axis=0),
        covariance,
        np.median([one.inertia.share for one in group], axis=0),
        first.expressions,
        first.units,
    )


def _inertial(group: Sequence[Member]) -> Iterable[_Values]:
    first = group[0].inertia
    size = np.median([np.abs(one.inertia.K) @ np.abs(one.inertia.pi) for one in group], axis=0)
    for k, name in enumerate(first.expressions):
        robots = np.array([i for i, one in enumerate(group) if one.inertia.share[k] < MOST_OF_URDF], dtype=int)
        own = [group[i].inertia for i in robots]
        values, std = np.array([x.beta[k] for x in own]), np.sqrt([x.covariance[k, k] for x in own])
        yield _Values(name, "inertia", first.units[k], robots, values, std, float(size[k]), NEGLIGIBLE_INERTIA)


def _terms(group: Sequence[Member]) -> Iterable[_Values]:
    names = dict.fromkeys(name for one in group for name in one.terms)
    for name in names:
        robots = np.array([i for i, one in enumerate(group) if _has_estimate(one.terms, name)], dtype=int)
        own = [group[i].terms[name] for i in robots]
        values, std = np.array([q.value for q in own]), np.array([q.std for q in own])
        size = float(np.abs(np.median(values))) if len(own) else 0.0
        yield _Values(name, _kind(name), own[0].unit if own else "", robots, values, std, size, NEGLIGIBLE)


def _has_estimate(terms: Mapping[str, Quantity], name: str) -> bool:
    return name in terms and bool(np.isfinite(terms[name].value)) and terms[name].std > 0


def _kind(term: str) -> str:
    """Return the parameter of a term without its place: "viscous" of "viscous_friction_joint1.viscous"."""
    return term.rpartition(".")[2]
