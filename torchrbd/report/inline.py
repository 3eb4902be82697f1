"""A matplotlib figure as SVG inside a page: the page's colours, its fonts, its width, and no name that clashes."""

from __future__ import annotations

import re
import warnings
from contextlib import AbstractContextManager
from io import StringIO

import matplotlib.style
from markupsafe import Markup
from matplotlib.figure import Figure

INK, SOFT, RULE, MEASURED = "#17212b", "#5a6673", "#e8ecf0", "#b4bcc5"
HELD_OUT, MARK, UNKNOWN = "#eef3f8", "#f9d9c2", "#a8578a"
COLOURS = {"urdf": "#e69f00", "baseline": "#cc79a7", "rigid_body": "#0072b2", "extended": "#009e73"}  # Okabe and Ito

STYLE = {
    "svg.fonttype": "none",  # text stays text: the page sets it in its own fonts, and it can be searched
    "svg.hashsalt": "torchrbd",
    "text.parse_math": False,  # "$" in the name of a joint is no formula
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 12,
    "text.color": SOFT,
    "axes.labelcolor": SOFT,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.autolimit_mode": "data",
    "axes.xmargin": 0.0,
    "axes.ymargin": 0.06,
    **{f"axes.spines.{side}": False for side in ("left", "right", "top", "bottom")},
    "figure.facecolor": "none",
    "grid.color": RULE,
    "grid.linewidth": 1.0,
    "lines.linewidth": 1.5,
    "lines.solid_joinstyle": "round",
    **{f"{axis}tick.{key}": value for axis in "xy" for key, value in {"color": SOFT, "major.size": 0}.items()},
}
DPI = 110  # of clouds of dots, with 72 to the page's inch: one and a half times the width of the page


def page_style() -> AbstractContextManager[None]:
    """Return a context in which figures look like the page, whatever the user's own style; it ends as it began."""
    return matplotlib.style.context(["default", STYLE])


def canvas(width: float, height: float) -> Figure:
    """Return an empty figure in the page's pixels: one is one point of matplotlib."""
    return Figure(figsize=(width / 72, height / 72))


def inline(figure: Figure, label: str, key: str) -> Markup:
    """Return a figure as an SVG element that scales with the page and refers to nothing outside itself.

    Args:
        figure: drawn within ``page_style``.
        label: what it shows, for those who cannot see it.
        key: a prefix, unique in the page, for the names inside the SVG.
    """
    file = StringIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # the reader's fonts draw the text, not matplotlib's
        figure.savefig(file, format="svg", dpi=DPI, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    head, body = file.getvalue().split("</defs>", 1)  # the style in the first <defs> would hold for the whole page
    box = re.search(r'viewBox="[\d. ]+"', head)
    body = re.sub(r'<g id="[^"]*"', "<g", body).replace("xlink:href", "href")
    body = re.sub(r' (id="|href="#|clip-path="url\(#)', rf" \1{key}-", body)
    body = re.sub(r' d="[^"]*"', _shorter, body)
    opening = Markup('<svg {} role="img" aria-label="{}">').format(Markup(box[0] if box else ""), label)
    return opening + Markup(body)


def _shorter(path: re.Match[str]) -> str:
    """Round a path to a tenth of a pixel: half the size of the page."""
    return re.sub(r"(\.\d)\d+", r"\1", " " + " ".join(path[0].split()))
