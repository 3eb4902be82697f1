"""The report's pictures: torque and residual against time, residual against a state, errors on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from torchrbd.inference.results import TorqueSeries
from torchrbd.report.svg import Axes, figure, limits, power_of_ten

WINDOW_S = 15.0
SIGNALS = {"q": "position", "qd": "velocity", "qdd": "acceleration"}
MAX_LINE, MAX_DOTS = 1500, 450  # points of one line, of one cloud


@dataclass(frozen=True)
class Units:
    """The units of one joint: "N m" and "rad", or "N" and "m"."""

    tau: str
    q: str

    def of(self, signal: str) -> str:
        """Return the unit of q, qd or qdd."""
        return self.q + {"q": "", "qd": "/s", "qdd": "/s²"}[signal]


@dataclass(frozen=True)
class Stretch:
    """Samples ``index`` of one recording that a figure shows, and where they lie, in words."""

    recording: str
    index: np.ndarray
    words: str


def informative_stretch(series: TorqueSeries, joint: int, model: str) -> Stretch:
    """Return the 15 s of held-out data in which ``model`` leaves the largest residual at a joint."""
    energy = np.nan_to_num(series.residual(model)[:, joint] ** 2)
    energy = np.where(series.held_out, energy, 0.0) if (energy * series.held_out).any() else energy
    best, score = Stretch("", np.zeros(0, dtype=int), ""), -1.0
    for r, name in enumerate(series.recordings):
        rows = np.flatnonzero(series.recording == r)
        if not rows.size:
            continue
        t = series.t[rows]
        start = np.flatnonzero(t <= max(t[-1] - WINDOW_S, t[0]))
        end = np.searchsorted(t, t[start] + WINDOW_S, side="right")
        total = np.concatenate([[0.0], np.cumsum(energy[rows])])
        k = int(np.argmax(total[end] - total[start]))
        if total[end[k]] - total[start[k]] > score:
            score, index = total[end[k]] - total[start[k]], rows[start[k] : end[k]]
            part = f", {t[start[k]]:.1f} to {t[end[k] - 1]:.1f} s, where the residual is largest"
            best = Stretch(name, index, name + part * (len(index) < len(rows)))
    return best


def _intervals(t: np.ndarray, mask: np.ndarray) -> list[tuple[float, float]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(float(t[a]), float(t[min(b, len(t) - 1)])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def time_figure(
    series: TorqueSeries,
    joint: int,
    stretch: Stretch,
    units: Units,
    models: Sequence[str],
    compared: Sequence[str],
    marks: Sequence[tuple[float, float]] = (),
) -> Markup:
    """Draw measured and predicted torque, and below it the residual of the ``compared`` models, on one clock.

    ``marks`` are the intervals [s] to which a finding is confined.
    """
    rows = stretch.index[:: max(1, -(-len(stretch.index) // MAX_LINE))]
    t, measured = series.t[rows], series.measured[rows, joint].copy()
    step = np.diff(t, prepend=t[0])
    measured[step > 5 * np.median(step)] = np.nan  # a gap in the recording is no straight line
    predicted = {m: np.where(np.isnan(measured), np.nan, series.predicted[m][rows, joint]) for m in models}
    residual = {m: measured - predicted[m] for m in compared}
    span = (float(t[0]), float(max(t[-1], t[0] + 1e-3)))
    upper = Axes(62, 8, 970, 210, span, limits(measured, *predicted.values()))
    lower = Axes(62, 236, 970, 130, span, limits(*residual.values(), np.zeros(1)))
    held_out = _intervals(t, series.held_out[rows])
    parts = [axes.bands(held_out, "held-out") + axes.bands(marks, "mark") for axes in (upper, lower)]
    parts += [upper.frame(y_label=f"torque [{units.tau}]" if units.tau == "N m" else f"force [{units.tau}]")]
    parts += [lower.frame("time [s]", f"residual [{units.tau}]"), upper.line(t, measured, "measured")]
    parts += [upper.line(t, y, m) for m, y in predicted.items()] + [lower.line(t, y, m) for m, y in residual.items()]
    return figure(1040, 404, f"torque of {series.joints[joint]} against time", parts)


def binned_median(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return centre, median and count of up to 25 equal bins of x; bins of fewer than ten samples are left out."""
    low, high = np.quantile(x, [0.005, 0.995])
    edges = np.linspace(low, high, int(np.clip(len(x) // 30, 2, 25)) + 1)
    which = np.digitize(x, edges[1:-1])
    groups = [(i, y[which == i]) for i in range(len(edges) - 1)]
    groups = [(i, g) for i, g in groups if len(g) >= 10]
    centres = (edges[:-1] + edges[1:]) / 2
    columns = (centres[[i for i, _ in groups]], [np.median(g) for _, g in groups], [len(g) for _, g in groups])
    return columns[0], np.array(columns[1], dtype=float), np.array(columns[2], dtype=float)


def _shown(series: TorqueSeries, joint: int) -> np.ndarray:
    """Return the held-out samples that have a measured torque, or all that have one if none is held out."""
    measured = np.isfinite(series.measured[:, joint])
    held_out = measured & series.held_out
    return np.flatnonzero(held_out if held_out.any() else measured)


def telling_signal(series: TorqueSeries, joint: int, model: str) -> str:
    """Return which of q, qd and qdd of a joint its residual follows most: the largest variance of binned medians."""
    rows = _shown(series, joint)
    residual = series.residual(model)[rows, joint]

    def share(signal: str) -> float:
        _, median, count = binned_median(getattr(series, signal)[rows, joint], residual)
        return (
            float(np.average((median - np.average(median, weights=count)) ** 2, weights=count)) if len(count) else 0.0
        )

    return max(SIGNALS, key=share)


def dependence_figure(
    series: TorqueSeries, joint: int, signal: tuple[str, int], units: tuple[Units, Units], compared: Sequence[str]
) -> Markup:
    """Draw the residual of ``joint`` against q, qd or qdd of a joint: a thinned cloud and binned medians.

    Args:
        signal: "q", "qd" or "qdd", and the index of the joint that it belongs to.
        units: of the joint with the residual, and of the joint with the signal.
        compared: the models before and after.
    """
    key, other = signal
    rows = _shown(series, joint)
    x = getattr(series, key)[rows, other]
    residual = {m: series.residual(m)[rows, joint] for m in compared}
    axes = Axes(62, 8, 440, 205, limits(x, quantile=0.002), limits(*residual.values(), np.zeros(1), quantile=0.005))
    owner = "" if other == joint else f" of {series.joints[other]}"
    parts = [axes.frame(f"{SIGNALS[key]}{owner} [{units[1].of(key)}]", f"residual [{units[0].tau}]")]
    thin = slice(None, None, max(1, -(-len(rows) // MAX_DOTS)))
    parts += [axes.dots(x[thin], y[thin], m) for m, y in residual.items()]
    parts += [axes.line(*binned_median(x, y)[:2], f"median {m}") for m, y in residual.items()]
    return figure(510, 250, f"residual of {series.joints[joint]} against {SIGNALS[key]}{owner}", parts)


@dataclass(frozen=True)
class ErrorScale:
    """One logarithmic scale for the errors of all joints and models, drawn as a row of dots per joint."""

    low: int
    high: int

    @classmethod
    def over(cls, values: Sequence[float]) -> ErrorScale:
        """Return the decades that hold all finite positive ``values``."""
        decades = np.log10([v for v in values if np.isfinite(v) and v > 0] or [1.0])
        low = int(np.floor(decades.min()))
        return cls(low, max(int(np.ceil(decades.max())), low + 1))

    def _x(self, value: float) -> float:
        return 14 + 232 * float(np.clip((np.log10(max(value, 1e-300)) - self.low) / (self.high - self.low), 0, 1))

    def _grid(self, height: float) -> list[Markup]:
        line = Markup('<path class="grid" d="M{0:.1f} 0V{1:g}"/>')
        return [line.format(self._x(10.0**k), height) for k in range(self.low, self.high + 1)]

    def header(self) -> Markup:
        """Draw the decades' labels."""
        text = Markup('<text class="tick x" x="{:.1f}" y="11">{}</text>')
        every = -(-(self.high - self.low) // 5)
        labels = [text.format(self._x(10.0**k), power_of_ten(k)) for k in range(self.low, self.high + 1, every)]
        return figure(260, 15, "normalised mean squared error, logarithmic", labels)

    def row(self, errors: dict[str, float]) -> Markup:
        """Draw one dot per model."""
        shown = {m: self._x(v) for m, v in errors.items() if np.isfinite(v)}
        parts = self._grid(22)
        if shown:
            parts.append(
                Markup('<path class="track" d="M{:.1f} 11H{:.1f}"/>').format(min(shown.values()), max(shown.values()))
            )
        parts += [Markup('<circle class="dot {}" cx="{:.1f}" cy="11" r="5.5"/>').format(m, x) for m, x in shown.items()]
        return figure(260, 22, "nmse " + ", ".join(f"{m} {v:.3g}" for m, v in errors.items()), parts)
