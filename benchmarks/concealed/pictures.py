"""Draw how often findings are right against how sure they were."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure as Drawing

from .score import CaseScore
from .tables import calibration

_SVG = {"svg.hashsalt": "torchrbd", "svg.fonttype": "none", "font.size": 9}


def draw_calibration(cases: Sequence[CaseScore], file: Path) -> None:
    """Write a picture of the share of findings that are right over their probability, with 95 % intervals."""
    bins = [(p, right) for _, _, p, right in calibration(cases) if right.n]
    with mpl.rc_context(_SVG):
        drawing = Drawing(figsize=(4.2, 3.8), layout="constrained")
        axes = drawing.add_subplot()
        axes.plot((0, 1), (0, 1), color="0.7", lw=1, label="as sure as right")
        if bins:
            p, value = np.array([p for p, _ in bins]), np.array([f.value for _, f in bins])
            reach = [value - [f.low for _, f in bins], [f.high for _, f in bins] - value]
            axes.errorbar(p, value, reach, fmt="o", ms=5, capsize=3, label="findings, 95 % interval")
            for x, (_, f) in zip(p, bins, strict=True):
                axes.annotate(str(f.n), (x, f.value), (6, -10), textcoords="offset points", color="0.35")
        axes.set(xlim=(-0.03, 1.12), ylim=(-0.03, 1.06), xlabel="probability told", ylabel="part that is right")
        axes.legend(loc="lower right", frameon=False)
        drawing.savefig(file, format="svg", metadata={"Date": None})
