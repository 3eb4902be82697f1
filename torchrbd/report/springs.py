"""Pictures of what encoders behind the gears show: deflection against load."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from torchrbd.diagnosis.results import Deflection
from torchrbd.report.figures import Units
from torchrbd.report.inline import COLOURS, MEASURED, SOFT, canvas


def spring_figure(found: Deflection, units: Units) -> Figure:
    """Draw the deflection over parts of the load's range, with its scatter, and the spring with its 95 % band."""
    load, mean = np.array(found.load), 1e3 * (np.array(found.deflection) - np.mean(found.deflection))
    figure = canvas(510, 250)
    axes = figure.subplots(gridspec_kw={"left": 0.13, "right": 0.985, "top": 0.98, "bottom": 0.175})
    axes.axhline(0, color=MEASURED, linewidth=1, zorder=1)
    dots = {"fmt": "o", "color": SOFT, "markersize": 4, "linewidth": 1}
    axes.errorbar(load, mean, 1e3 * np.array(found.deflection_std), zorder=2, **dots)
    if found.stiffness is not None:
        x = np.linspace(load.min(), load.max(), 21)  # the band is narrowest in the middle
        compliance = 1e3 / found.stiffness.value
        slope_std = compliance * found.stiffness.std / found.stiffness.value
        y, band = compliance * (x - load.mean()), 1.96 * slope_std * np.abs(x - load.mean())
        axes.fill_between(x, y - band, y + band, color=COLOURS["extended"], alpha=0.22, linewidth=0)
        axes.plot(x, y, color=COLOURS["extended"], linewidth=2.5)
    margin = 0.03 * float(np.ptp(load))
    axes.set_xlim(load.min() - margin, load.max() + margin)
    axes.set_xlabel(f"load of {found.joint} [{units.tau}]")
    axes.set_ylabel(f"deflection [m{units.q}]")
    return figure
