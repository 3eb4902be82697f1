"""Fits on whitened rows, with what they leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis.rows.samples import Samples
from torchrbd.diagnosis.rows.white_rows import LEAST_NOISE, ORDER, Colour, Place, Rows, joint_noise, predictor
from torchrbd.likelihood.gaussian import Posterior
from torchrbd.likelihood.urdf_prior import Prior

_ROUNDS = 3


@dataclass(frozen=True)
class Extra:
    """Features without a name: (K, M) at a joint, or (K, n, M) at all if ``place`` is None."""

    place: int | None
    features: np.ndarray


class Fit:
    """The fit of one set of terms.

    Args:
        rows: the data.
        terms: of the model besides the rigid body.
        extra: further features.

    Attributes:
        places: of the terms' columns, in the order of the last columns of X.
        X: (N, P + T).
        posterior: of the coefficients, in prior coordinates.
        x: coefficients (P + T,) in prior coordinates.
        e: (N,) residual.
    """

    def __init__(self, rows: Rows, terms: Sequence[Candidate], extra: Sequence[Extra] = ()) -> None:
        self.rows, self.terms, self.extra = rows, tuple(terms), tuple(extra)
        columns: dict[Place, np.ndarray] = {}
        for term in terms:
            columns |= dict(zip((found := rows.columns(term))[0], found[1].T, strict=True))
        for number, one in enumerate(extra):
            columns |= dict(zip(_places(number, one), rows.widened(one.place, one.features).T, strict=True))
        self.places = list(columns)
        self.X = np.concatenate((rows.X, np.array(list(columns.values())).reshape(-1, len(rows.y)).T), axis=1)
        self.posterior = Posterior(self.X.T @ self.X + np.eye(self.X.shape[1]), self.X.T @ rows.y)
        self.x = self.posterior.z
        self.e = rows.y - self.X @ self.x

    @property
    def pi(self) -> torch.Tensor:
        """Inertial parameters (n_params,)."""
        return torch.from_numpy(self.rows.pi(self.x[: self.rows.X.shape[1]]))

    def renoised(self) -> Fit:
        """Return the same fit whitened by what it leaves."""
        return Fit(Rows(self.rows.samples, self.rows.prior, self.noise()), self.terms, self.extra)

    def equations(self, features: Mapping[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the normal equations of coefficients that features (K, M) at some joints share.

        Returns:
            Gram (K, K) given the fit, the same without it, and score (K,).
        """
        rows = self.rows
        white = {j: rows.white(A, j) for j, A in features.items()}
        cross = np.sum([self.X[rows.parts[j]].T @ A.T for j, A in white.items()], axis=0)
        alone = np.sum([A @ A.T for A in white.values()], axis=0)
        score = np.sum([A @ self.e[rows.parts[j]] for j, A in white.items()], axis=0)
        return self.posterior.schur(cross, alone), alone, score

    def projected(self, C: np.ndarray) -> np.ndarray:
        """Return what the model cannot imitate of whitened columns C (N, ...)."""
        return C - self.X @ self.posterior.solve(self.X.T @ C)

    def coefficients(self, term: Candidate) -> np.ndarray:
        """Return the coefficients w (K,) of a term in their own units."""
        first = self.rows.X.shape[1]
        z = self.x[[first + self.places.index((term.place, label)) for label in term.labels]]
        return z * self.rows.widths_of(term)

    def residual(self) -> np.ndarray:
        """Return the residual as it is, (n, M) [N m] or [N]."""
        samples, rows = self.rows.samples, self.rows
        left = samples.tau - samples.rigid @ self.pi.numpy()
        value = dict(zip(self.places, self.x[rows.X.shape[1] :], strict=True))
        done: set[Place] = set()
        for term in self.terms:
            for label, f, w in zip(term.labels, samples.features(term), self.coefficients(term), strict=True):
                place = (term.place, label)
                if place not in done:
                    left[slice(None) if term.place is None else term.place] -= w * f
                    done.add(place)
        for number, one in enumerate(self.extra):
            w = rows.widths(one.place, one.features) * [value[place] for place in _places(number, one)]
            left[slice(None) if one.place is None else one.place] -= np.tensordot(w, one.features, 1)
        return np.where(samples.measured, left, 0.0)

    def noise(self) -> Colour:
        """Return the noise that makes this residual white."""
        left, rows = self.residual(), self.rows
        filters, scale = np.zeros((len(left), ORDER)), np.ones(len(left))
        Q = self.posterior.half(self.X.T)
        for j, index in enumerate(rows.index):
            if len(index):
                weight = rows.samples.weight[j]
                filters[j] = predictor(left[j] * weight, index)
                e = joint_noise(index, filters[j], 1.0, weight).white(left[j] * weight)
                used = min(float((Q[:, rows.parts[j]] ** 2).sum()), 0.9 * rows.counts[j])
                least = LEAST_NOISE * np.sqrt(np.mean(rows.samples.tau[j] ** 2))
                scale[j] = max(float(np.sqrt(np.sum(e**2) / (rows.counts[j] - used) + least**2)), 1e-300)
        return filters, scale


def fitted(
    samples: Samples,
    prior: Prior,
    terms: Sequence[Candidate],
    noise: Colour | None = None,
    extra: Sequence[Extra] = (),
    rounds: int = _ROUNDS,
) -> Fit:
    """Fit terms and further features, and whiten by what they leave, in turn."""
    rms = np.sqrt(np.mean(samples.tau**2, axis=1))
    noise = noise or (np.zeros((len(rms), ORDER)), np.where(rms > 0, 0.1 * rms, 1.0))
    fit = Fit(Rows(samples, prior, noise), terms, extra)
    for _ in range(rounds):
        fit = fit.renoised()
    return fit


def _places(number: int, extra: Extra) -> list[Place]:
    return [(extra.place, f"extra {number} {k}") for k in range(len(extra.features))]
