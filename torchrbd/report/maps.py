"""Maps of what a model leaves, a row per joint: over time, position and velocity, louder is darker."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from torchrbd.diagnosis.results import Location, ResidualMap
from torchrbd.report.inline import INK, canvas
from torchrbd.report.text.numbers import number

LOUDEST, FOUND, EMPTY = 10.0, "#d55e00", "#e4e7ea"
# Pixels of a letter of a joint's name, and of the ranges at the rows; the largest share of the width for names.
LETTER, RANGES, MOST_LABEL = 8.0, 130, 0.4
AXES = {"t": "time [s]", "q": "position", "qd": "velocity"}


def map_figure(one: ResidualMap, joints: Sequence[str], locations: Sequence[Location], units: Sequence[str]) -> Figure:
    """Draw the RMS of the residual over the noise, 1 (white) to 10, and frame what was located.

    Args:
        one: the map.
        joints: names of its rows.
        locations: those in the residual of the same model.
        units: per joint, of the signal.
    """
    wide = one.signal == "t"
    figure = canvas(1040 if wide else 510, 64 + 24 * len(joints))
    width, height = figure.bbox.width, figure.bbox.height
    labels = min(12 + LETTER * max(map(len, joints)), MOST_LABEL * width)
    box = {"left": labels / width, "right": 1 - (10 if wide else RANGES) / width, "bottom": 46 / height}
    box["top"] = 1 - 6 / height
    axes = figure.subplots(gridspec_kw=box)
    axes.grid(visible=False)
    level = np.clip(np.array(one.level), 1.0, LOUDEST)
    norm = LogNorm(1.0, LOUDEST)
    for row, edges in enumerate(one.edges):
        x = np.array(edges) if wide else np.linspace(0.0, 1.0, len(edges))
        axes.add_patch(Rectangle((x[0], row - 0.42), x[-1] - x[0], 0.84, facecolor=EMPTY, linewidth=0, zorder=0))
        axes.pcolormesh(x, [row - 0.42, row + 0.42], level[[row]], cmap="Blues", norm=norm, rasterized=True)
        for begin, end in _framed(one, joints[row], locations):
            if not wide:
                begin, end = ((v - edges[0]) / (edges[-1] - edges[0]) for v in (begin, end))
            begin, end = max(begin, float(x[0])), min(end, float(x[-1]))
            axes.add_patch(Rectangle((begin, row - 0.46), end - begin, 0.92, fill=False, edgecolor=FOUND, linewidth=2))
    axes.set_yticks(range(len(joints)), [*joints], color=INK)
    axes.set_ylim(len(joints) - 0.5, -0.5)
    if wide:
        axes.set_xlabel(AXES["t"])
    else:
        _own_ranges(axes, one, units)
    return figure


def _own_ranges(axes: Axes, one: ResidualMap, units: Sequence[str]) -> None:
    """Write each joint's range at its row: the rows share no scale."""
    axes.set_xticks([0.0, 1.0], ["lowest", "highest"])
    axes.set_xlabel(AXES[one.signal])
    axes.get_xticklabels()[0].set_horizontalalignment("left")
    axes.get_xticklabels()[1].set_horizontalalignment("right")
    for row, (edges, unit) in enumerate(zip(one.edges, units, strict=True)):
        words = f"{number(edges[0])} to {number(edges[-1])} {unit}"
        axes.annotate(words, (1.01, row), xycoords=("axes fraction", "data"), va="center", fontsize=9)


def _framed(one: ResidualMap, joint: str, locations: Sequence[Location]) -> list[tuple[float, float]]:
    """Return the intervals of a map's signal that hold something located at a joint."""
    here = [x.where for x in locations if joint in x.joints and x.model == one.model]
    if one.signal == "t":
        mine = [w for w in here if w.recordings is None or one.recording in w.recordings]
        return [span for w in mine for span in w.time_s or ()]
    return [(r.low, r.high) for w in here for r in w.region or () if r.signal == f"{one.signal}_{joint}"]
