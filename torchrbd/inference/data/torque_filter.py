"""Whether torques were low-passed before they were recorded, and by which filter.

Torques without any noise above some frequency passed a filter, or the motion has nothing there. Friction shows which of
both: it changes its sign at once, whatever the motion. Least squares of the torque on the regressor and friction,

    tau = H(f_half, n) [Y pi + viscous qd + coulomb sign(qd) + offset],   sum_j N_j/2 log |e_j|^2 -> min

is tried without and with the filter. A filter has two parameters, each worth log(N)/2 (Schwarz's criterion). States are
Wiener-filtered: noise of the positions would be in Y, not in the torque, and a filter would seem to remove it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from scipy.ndimage import convolve1d
from scipy.optimize import OptimizeResult, minimize_scalar

from torchrbd.dataset.columns import Columns
from torchrbd.dataset.reading import Reading
from torchrbd.dataset.rows import Rows, read_rows
from torchrbd.dataset.scales import covered_scales
from torchrbd.errors import RecordingError
from torchrbd.recordings import Filtering, LowPass

# Orders that are tried; lowest half-amplitude frequency as a part of that at which torques end.
_ORDERS, _LOWEST = (1, 2, 3, 4, 5, 6), 0.1
# Directions of the regression below this part of the largest are rounding; how often joints are weighed again.
_RANK, _SWEEPS = 1e-10, 2
# Parameters of a filter.
_PARAMETERS = 2


def find_low_pass(reading: Reading, fitted: int) -> LowPass | None:
    """Return the filter that all torques had passed, if they end below the clock's band and one explains them better.

    Args:
        reading: the recordings.
        fitted: how many of them, the first ones, it is estimated from; the others are held out.
    """
    if any(math.isnan(s.torque_ends_hz) for s in reading.surveys if not s.at_rest):
        return None
    band = float(np.fmax.reduce([s.torque_ends_hz for s in reading.surveys[:fitted]]))
    if math.isnan(band):
        return None
    first = {key: getattr(reading, key)[:fitted] for key in ("recordings", "surveys", "simulated")}
    reading = replace(reading, filtering=Filtering(band, of_motion=True), **first)
    try:
        rows = read_rows(reading, Columns(reading.robot, (), covered_scales(reading.surveys, reading.filtering)), _none)
    except RecordingError:  # too short for the filters; the fit says so
        return None
    regression = _Regression(rows, reading.filtering.effective_rate)
    without, found = regression.misfit(None), list[tuple[float, LowPass]]()
    for order in _ORDERS:
        best = minimize_scalar(
            lambda log_hz, order=order: regression.misfit(LowPass(math.exp(log_hz), order)),
            bounds=(math.log(_LOWEST * band), math.log(band)),
            method="bounded",
        )
        assert isinstance(best, OptimizeResult)
        found.append((float(best["fun"]), LowPass(math.exp(float(best["x"])), order, band)))
    least, low_pass = min(found, key=lambda one: one[0])
    price = 0.5 * _PARAMETERS * math.log(max(regression.count, 2.0))
    return low_pass if without - least > price else None


def _none(name: str, t: torch.Tensor) -> torch.Tensor:
    return torch.zeros(len(t), dtype=torch.bool)


class _Regression:
    """Least squares of all torques on regressor and friction, whose columns pass a filter.

    Args:
        rows: band-limited samples.
        rate_hz: independent samples per second; there are more rows.
    """

    def __init__(self, rows: Rows, rate_hz: float) -> None:
        self._dt, self._runs = rows.dt_out, np.split(np.arange(len(rows.t)), np.flatnonzero(np.diff(rows.run)) + 1)
        sign, one = rows.evaluated(lambda signals: signals.qd.sign()), np.ones(len(rows.t))
        seen, bodies = [j for j in range(rows.n_dof) if rows.seen[j]], rows.columns.robot.n_params
        self._torque = [rows.tau[j][rows.measured[j]] for j in seen]
        self._joints = [(np.column_stack((rows.rigid[j], rows.qd[j], sign[j], one)), rows.measured[j]) for j in seen]
        self._places = [np.append(rows.columns.inertial[j], bodies + 3 * k + np.arange(3)) for k, j in enumerate(seen)]
        self._unknowns = bodies + 3 * len(seen)
        self._samples = [rate_hz * rows.dt_out * len(tau) for tau in self._torque]

    @property
    def count(self) -> float:
        """Number of independent samples."""
        return sum(self._samples)

    def misfit(self, low_pass: LowPass | None) -> float:
        """Return sum_j N_j/2 log |e_j|^2 of joints that are weighed by their own errors."""
        size = np.array([np.linalg.norm(tau) for tau in self._torque])
        columns = [self._passed(own, low_pass)[measured] for own, measured in self._joints]
        for _ in range(_SWEEPS):
            A = np.zeros((sum(map(len, self._torque)), self._unknowns))
            ends = np.cumsum([0, *map(len, self._torque)])
            for own, at, begin, end, s in zip(columns, self._places, ends[:-1], ends[1:], size, strict=True):
                A[begin:end, at] = own / s
            scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
            y = np.concatenate([tau / s for tau, s in zip(self._torque, size, strict=True)])
            left = np.split(y - A @ (np.linalg.lstsq(A / scale, y, rcond=_RANK)[0] / scale), ends[1:-1])
            size = np.maximum(size * [np.linalg.norm(e) for e in left], 1e-300)
        return float(self._samples @ np.log(size))

    def _passed(self, columns: np.ndarray, low_pass: LowPass | None) -> np.ndarray:
        if low_pass is None:
            return columns
        kernel = low_pass.kernel(self._dt)
        return np.concatenate([convolve1d(columns[run], kernel, axis=0, mode="nearest") for run in self._runs])
