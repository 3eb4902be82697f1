"""A test for a wrong model: do the efficient estimate and ordinary least squares agree? (Hausman's test)

Whitening gives weight to fast motion, least squares to large torques. Both are right if the model is; a wrong law
biases each in its own way. With z ~ N(m, P^-1), the whitened rows are W y = X z + e with white e. Least squares uses
the same rows as independent ones, y_o = X_o z + G e, each joint's divided by the size of its noise. Then

    z_w - z = H_w^-1 (X'e - P (z - m)),       H_w = X'X + P         efficient
    z_o - z = H_o^-1 (X_o'G e - P (z - m)),   H_o = X_o'X_o + P     consistent, whatever the noise's colour
    d = z_o - z_w,   V = cov(d),   d'V^+ d ~ chi-squared, of as many degrees of freedom as V has rank

Both have the same prior, and V includes it: directions that only the prior determines do not differ and do not count. G
is the noise's memory, the inverse of W.

Source: Hausman, "Specification Tests in Econometrics", Econometrica 1978, theorem 2.1. There V = C_o - C_w; here it is
that of d itself, because the first rows of a run are not whitened but only predict later ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2

from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.misfit import Misfit
from torchrbd.likelihood.noise import Noise

# The model counts as wrong below this p-value.
MISFIT = 0.01
# If whitening removes less than this fraction of least squares' variance, both estimates count as equal.
_LEAST_LOSS = 0.01
# The noise's impulse response is cut below this fraction of its first value, or after this many rows.
_FORGOTTEN, _MOST_MEMORY = 1e-4, 4096
# Directions of coefficients below this are dominated by rounding.
_LEAST_DIRECTION = 1e-9


class TwoEstimates:
    """The efficient and the least-squares estimate of the coefficients of one likelihood.

    Neither has the priors that keep friction non-negative: those are not Gaussian.

    Args:
        fit: the model, with its noise learnt.

    Attributes:
        efficient, ordinary: z_w and z_o, (P,).
    """

    def __init__(self, fit: Likelihood) -> None:
        g, rows, at = fit.gaussian, fit.machine.rows, fit.machine.positive
        sites = np.zeros((2, len(g.z)))
        sites[:, at] = fit.hyper.resists[:2]
        H, h = g.H - np.diag(sites[0]), g.h - sites[1]
        self._P, shift = H.copy(), h.copy()
        data, score = np.zeros_like(H), np.zeros_like(h)
        self._fit, self._scales = fit, dict[int, np.ndarray]()
        for j, (block, noise, index) in enumerate(zip(g.blocks, fit.hyper.noise, fit.index, strict=True)):
            if not len(index):
                continue
            scale = np.zeros(len(rows.t))
            scale[index] = 1.0 / noise.spread[index]
            scale /= np.sqrt(np.mean((scale * fit.residual(j))[index] ** 2))
            self._P[np.ix_(block.own, block.own)] -= block.gram
            shift[block.own] -= block.times(block.y)
            X = fit.columns(j) * scale
            data[np.ix_(block.own, block.own)] += X @ X.T
            score[block.own] += X @ (scale * fit.machine.target[j])
            self._scales[j] = scale
        self._Hw, self._Ho = _inverse(H), _inverse(data + self._P)
        self.efficient, self.ordinary = self._Hw @ h, self._Ho @ (score + shift)

    def test(self, index: Sequence[int] | np.ndarray) -> Misfit:
        """Test whether the two estimates of some coefficients (K,) differ only by noise.

        Raises:
            ValueError: there are no coefficients.
        """
        if not len(index):
            raise ValueError("no coefficients to compare: expected one index or more")
        V, C = self._covariances(index)
        # In coordinates in which C is one, V is the variance that least squares loses.
        size = np.sqrt(np.maximum(C.diagonal(), 1e-300))
        values, vectors = np.linalg.eigh(C / size / size[:, None])
        resolved = values > _LEAST_DIRECTION
        whole = (vectors[:, resolved] / np.sqrt(values[resolved])).T / size
        loss, axes = np.linalg.eigh(whole @ V @ whole.T)
        kept = loss > _LEAST_LOSS
        d = axes[:, kept].T @ whole @ (self.ordinary - self.efficient)[index]
        statistic, dof = float((d**2 / loss[kept]).sum()), int(kept.sum())
        return Misfit(statistic, dof, float(chi2.sf(statistic, dof)) if dof else 1.0)

    def estimate(self, index: Sequence[int] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return coefficients (K,) and their covariance: the efficient estimate, or the mean of both if they disagree.

        If they disagree, a law is wrong and either may be right: the uncertainty of the mean is then half their
        difference.
        """
        if self.test(index).p_value >= MISFIT:
            return self._fit.gaussian.z[index], self._fit.gaussian.covariance(index)
        apart = 0.5 * (self.ordinary - self.efficient)[index]
        return self.efficient[index] + apart, self._covariances(index)[1] + np.outer(apart, apart)

    def against(self, index: Sequence[int] | np.ndarray, value: np.ndarray | float = 0.0) -> float:
        """Return the log evidence against a value of coefficients (K,) with the prior N(value, 1).

        It is the Savage-Dickey density ratio, of an estimate that scatters by the actual noise.
        """
        m, C = self.estimate(index)
        return 0.5 * float(np.linalg.slogdet(C)[1] + (m - value) @ np.linalg.solve(C, m - value))

    def _covariances(self, index: Sequence[int] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return V (K, K), and the covariance of z_o around the truth (K, K)."""
        Kw, Ko = self._Hw[index], self._Ho[index]
        V, C = (Ko - Kw) @ self._P @ (Ko - Kw).T, Ko @ self._P @ Ko.T
        for j, scale in self._scales.items():
            block, noise, index = self._fit.blocks[j], self._fit.hyper.noise[j], self._fit.index[j]
            U = self._fit.explained(j, Ko[:, block.own]) * scale**2
            memory, before = remembered(U, noise, self._fit.machine.rows.run)
            ordinary, early = memory[:, index], before + _left(memory, index)
            apart = ordinary - block.explained(Kw[:, block.own])
            C += ordinary @ ordinary.T + early
            V += apart @ apart.T + early
        return V, C


def remembered(U: np.ndarray, noise: Noise, run: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the part of signals U v (K,), for a noise v (M,), that comes from its innovations: U G.

    G is applied from the right, by the noise's recursion backwards in time.

    Args:
        U: (K, M).
        noise: of the rows.
        run: (M,) number of a row's uninterrupted run.

    Returns:
        (K, M) of the innovations of each row, and the covariance (K, K) from those before the start of each run.
    """
    recursion = np.concatenate(([1.0], -noise.predictor))
    response = np.abs(np.asarray(lfilter([1.0], recursion, np.eye(1, _MOST_MEMORY)[0])))
    reach = int(np.flatnonzero(response > _FORGOTTEN)[-1])
    memory, before = np.zeros_like(U), np.zeros((len(U), len(U)))
    for number in np.unique(run):
        inside = np.flatnonzero(run == number)
        later = np.concatenate((U[:, inside[::-1]], np.zeros((len(U), reach))), axis=1)
        found = np.asarray(lfilter([1.0], recursion, later, axis=1))
        memory[:, inside] = found[:, : len(inside)][:, ::-1] * (noise.sigma * noise.scatter[inside])
        early = found[:, len(inside) :] * (noise.sigma * noise.scatter[inside[0]])
        before += early @ early.T
    return memory, before


def _left(memory: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return the covariance (K, K) from the innovations of rows that are not in ``index``."""
    rest = np.delete(memory, index, axis=1)
    return rest @ rest.T


def _inverse(H: np.ndarray) -> np.ndarray:
    size = np.sqrt(H.diagonal())
    return np.linalg.inv(H / size / size[:, None]) / size / size[:, None]
