"""The page of a fleet: who differs from its sisters, and what changed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from markupsafe import Markup
from matplotlib.ticker import NullFormatter

from torchrbd._runtime.outputs import write_whole
from torchrbd.fleet.results import Deviation, FleetComparison, MemberResult
from torchrbd.report.inline import SOFT, canvas, inline, page_style
from torchrbd.report.templates import environment
from torchrbd.report.text.fleet import parameter_name
from torchrbd.report.text.numbers import power_of_ten

# Robots that are listed one by one where nothing is to be said of them; fleet.json has all.
MOST_ALIKE = 200
# Standard deviations at which a bar ends.
_BAR_END = 20.0
_OFF = "#c24f00"


def write_fleet_report(result: FleetComparison, path: Path) -> None:
    """Write one HTML file that needs nothing else: no scripts, no external style, font or picture."""
    templates = environment()
    templates.filters |= {"parameter_name": parameter_name, "bar": bar}
    notable = sorted((one for one in result.members if one.is_notable), key=_first)
    alike = [one for one in result.members if not one.is_notable]
    with page_style():
        picture = errors_picture(result)
    text = templates.get_template("fleet.html.j2").render(
        result=result, notable=notable, alike=alike[:MOST_ALIKE], more=max(0, len(alike) - MOST_ALIKE), picture=picture
    )
    write_whole(path, text.encode())


def _first(one: MemberResult) -> tuple[bool, float]:
    """Sort failures last, and the others by how clearly they differ."""
    return bool(one.error), -max((abs(d.z) for d in one.deviations), default=0.0)


def bar(d: Deviation) -> Markup:
    """Draw how many standard deviations a parameter is off, to the left if it is smaller than the median."""
    length = 50.0 * min(abs(d.z) / _BAR_END, 1.0)
    left = 50.0 if d.z > 0 else 50.0 - length
    return Markup('<span class="bar"><i style="left:{:.1f}%;width:{:.1f}%"></i></span>').format(left, length)


def errors_picture(result: FleetComparison) -> Markup | None:
    """Draw the held-out errors of all robots in their order, those that differ marked; None if there are none."""
    nmse = np.array([one.nmse for one in result.members])
    seen = np.isfinite(nmse) & (nmse > 0)
    if not seen.any():
        return None
    off = np.array([bool(one.deviations) for one in result.members])
    figure = canvas(1080, 170)
    axes = figure.add_axes((0.08, 0.28, 0.91, 0.58))
    at = np.arange(1, len(nmse) + 1)
    for mask, colour, label in ((seen & ~off, SOFT, "like its sisters"), (seen & off, _OFF, "differs")):
        if mask.any():
            axes.plot(at[mask], nmse[mask], "o", color=colour, markersize=4, label=label)
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(lambda value, _: power_of_ten(round(math.log10(value))))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("robot, in the order of the list")
    axes.set_ylabel("held-out nmse")
    axes.set_xlim(0.0, len(nmse) + 1.0)
    axes.margins(y=0.15)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, frameon=False, borderpad=0.0)
    return inline(figure, "held-out torque error of every robot", "fleet")
