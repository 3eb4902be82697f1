"""The report's pictures: torque and residual against time, residual against a state, errors on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchrbd.diagnosis.results import Curve
from torchrbd.inference.results import TorqueSeries
from torchrbd.report.excerpt import Excerpt, binned_mean, shown_rows, signal_words
from torchrbd.report.inline import COLOURS, HELD_OUT, MARK, MEASURED, SOFT, canvas
from torchrbd.report.text.numbers import power_of_ten

MAX_LINE, MAX_DOTS = 1500, 1500  # points of one line, of one cloud


@dataclass(frozen=True)
class Units:
    """The units of one joint: "N m" and "rad", or "N" and "m"."""

    tau: str
    q: str

    def of(self, signal: str) -> str:
        """Return the unit of q, qd or qdd."""
        return self.q + {"q": "", "qd": "/s", "qdd": "/s²"}[signal]


def _small() -> tuple[Figure, Axes]:
    figure = canvas(510, 250)
    return figure, figure.subplots(gridspec_kw={"left": 0.13, "right": 0.985, "top": 0.98, "bottom": 0.175})


def _zero_line(axes: Axes, label: str) -> None:
    axes.axhline(0, color=MEASURED, linewidth=1, zorder=1)
    axes.set_ylabel(label)


def time_figure(
    series: TorqueSeries,
    joint: int,
    excerpt: Excerpt,
    units: Units,
    models: Sequence[str],
    compared: Sequence[str],
    marks: Sequence[tuple[float, float]] = (),
) -> Figure:
    """Draw measured and predicted torque, and below it the residual of the ``compared`` models, on one clock.

    ``marks`` are the intervals [s] to which a finding is confined.
    """
    rows = excerpt.index[:: max(1, -(-len(excerpt.index) // MAX_LINE))]
    t, measured = series.t[rows], series.measured[rows, joint].copy()
    step = np.diff(t, prepend=t[0])
    measured[step > 5 * np.median(step)] = np.nan  # a gap in the recording is no straight line
    figure = canvas(1040, 404)
    box = {"left": 0.065, "right": 0.988, "top": 0.985, "bottom": 0.105, "hspace": 0.12, "height_ratios": [1.6, 1]}
    upper, lower = figure.subplots(2, sharex=True, gridspec_kw=box)
    upper.plot(t, measured, color=MEASURED, linewidth=5)
    for model in models:
        predicted = np.where(np.isnan(measured), np.nan, series.predicted[model][rows, joint])
        upper.plot(t, predicted, color=COLOURS[model], linestyle=(0, (4, 2)) if model == "urdf" else "-")
    for model in compared:
        lower.plot(t, measured - series.predicted[model][rows, joint], color=COLOURS[model], linewidth=1.2)
    for axes in (upper, lower):
        whole_height = axes.get_xaxis_transform()
        axes.fill_between(t, 0, 1, where=series.held_out[rows].tolist(), transform=whole_height, color=HELD_OUT, lw=0)
        for begin, end in marks:
            axes.axvspan(max(begin, t[0]), min(end, t[-1]), color=MARK, linewidth=0, zorder=1)
    upper.set_ylabel(f"{'torque' if units.tau == 'N m' else 'force'} [{units.tau}]")
    _zero_line(lower, f"residual [{units.tau}]")
    lower.set_xlabel("time [s]")
    lower.set_xlim(t[0], max(t[-1], t[0] + 1e-3))
    figure.align_ylabels()
    return figure


def dependence_figure(
    series: TorqueSeries, joint: int, signal: tuple[str, int], units: tuple[Units, Units], compared: Sequence[str]
) -> Figure:
    """Draw the residual of ``joint`` against q, qd or qdd of a joint: a thinned cloud, binned means and their error.

    Args:
        signal: "q", "qd" or "qdd", and the index of the joint that it belongs to.
        units: of the joint with the residual, and of the joint with the signal.
        compared: the models before and after.
    """
    key, other = signal
    rows = shown_rows(series, joint)
    x = getattr(series, key)[rows, other]
    residual = {m: series.residual(m)[rows, joint] for m in compared}
    thin = slice(None, None, max(1, -(-len(rows) // MAX_DOTS)))
    figure, axes = _small()
    size = np.clip(60 / np.sqrt(len(rows)), 2.5, 5.0)  # a few dots are drawn larger
    for model, y in residual.items():
        dots = {"markersize": size, "markeredgewidth": 0, "alpha": 0.3, "rasterized": True}
        axes.plot(x[thin], y[thin], "o", color=COLOURS[model], **dots)
    for model, y in residual.items():
        centre, mean, error, _ = binned_mean(x, y)
        axes.fill_between(centre, mean - error, mean + error, color=COLOURS[model], alpha=0.22, linewidth=0)
        axes.plot(centre, mean, color=COLOURS[model], linewidth=2.5)
    _zero_line(axes, f"residual [{units[0].tau}]")
    axes.set_xlabel(signal_words(series, joint, signal) + f" [{units[1].of(key)}]")
    low, high = np.quantile(np.stack([*residual.values()]), [0.004, 0.996])
    margin = 0.08 * (high - low) or 1.0
    axes.set_ylim(min(low, 0.0) - margin, max(high, 0.0) + margin)
    return figure


def curve_figure(
    curve: Curve, labels: tuple[str, str], colour: str, data: tuple[np.ndarray, np.ndarray] | None = None
) -> Figure:
    """Draw a torque as a function of one signal with its 95 % band, over binned means of what was measured of it.

    Args:
        curve: the function.
        labels: of the signal and of the torque, with their units.
        colour: of the line.
        data: values of the signal, and residual torque of all else in the model, if known.
    """
    x, y, margin = np.array(curve.at), np.array(curve.torque), 1.96 * np.array(curve.std)
    figure, axes = _small()
    if data is not None:
        inside = (data[0] >= x.min()) & (data[0] <= x.max())
        centre, mean, error, _ = binned_mean(*(v[inside] for v in data)) if inside.sum() > 1 else (np.zeros(0),) * 4
        axes.errorbar(centre, mean, error, fmt="o", color=SOFT, markersize=4, linewidth=1, zorder=2)
    axes.fill_between(x, y - margin, y + margin, color=colour, alpha=0.22, linewidth=0)
    axes.plot(x, y, color=colour, linewidth=2.5)
    _zero_line(axes, labels[1])
    axes.set_xlabel(labels[0])
    # A constant that another term may have as well makes a band beyond which the function would look flat.
    seen = np.concatenate((y, [0.0]))
    reach = np.ptp(seen) or 1.0
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, seen.min() - reach), min(top, seen.max() + reach))
    return figure


def residual_figure(
    series: TorqueSeries, joint: int, rows: np.ndarray, unit: str, compared: Sequence[str], span: tuple[float, float]
) -> Figure:
    """Draw the residual of a joint against time on ``rows`` of one recording; ``span`` [s] is marked if it ends."""
    rows = rows[:: max(1, -(-len(rows) // MAX_LINE))]
    t = series.t[rows]
    figure, axes = _small()
    if np.isfinite(span).any():
        axes.axvspan(max(span[0], t[0]), min(span[1], t[-1]), color=MARK, linewidth=0, zorder=1)
    for model in compared:
        axes.plot(t, series.residual(model)[rows, joint], color=COLOURS[model], linewidth=1.2)
    _zero_line(axes, f"residual [{unit}]")
    axes.set_xlabel("time [s]")
    axes.set_xlim(t[0], max(t[-1], t[0] + 1e-3))
    return figure


def decades(values: Sequence[float]) -> tuple[float, float]:
    """Return the powers of ten that hold all finite positive ``values``."""
    exponents = np.log10([v for v in values if np.isfinite(v) and v > 0] or [1.0])
    low = np.floor(exponents.min())
    return float(10.0**low), float(10.0 ** max(np.ceil(exponents.max()), low + 1))


def error_figure(errors: dict[str, float], limits: tuple[float, float], *, labels: bool = False) -> Figure:
    """Draw one dot per model on the logarithmic scale that a column of a table shares, or the scale's ``labels``."""
    figure = canvas(260, 16 if labels else 22)
    axes = figure.add_axes((0.05, 0.0, 0.9, 0.02 if labels else 1.0), xscale="log", xlim=limits, yticks=[])
    exponents = range(round(np.log10(limits[0])), round(np.log10(limits[1])) + 1)
    every = -(-len(exponents) // 6)
    words = [power_of_ten(k) if labels and i % every == 0 else "" for i, k in enumerate(exponents)]
    axes.set_xticks([10.0**k for k in exponents], words)
    axes.minorticks_off()
    axes.xaxis.tick_top()
    shown = {m: float(np.clip(v, *limits)) for m, v in errors.items() if np.isfinite(v)}
    axes.plot([*shown.values()], np.zeros(len(shown)), color=MEASURED, linewidth=2)
    for model, value in shown.items():
        axes.plot(value, 0, "o", color=COLOURS[model], markersize=11, markeredgecolor="white", clip_on=False)
    return figure
