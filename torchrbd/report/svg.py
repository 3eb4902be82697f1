"""Draw axes, lines and dots as SVG text: a few kilobytes a figure, sharp at any size, in the page's own fonts.

Every mark carries a class (``urdf``, ``rigid_body``, ...) and the page's style sheet gives it a colour.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

MINUS = "\N{MINUS SIGN}"


def plain(value: float) -> str:
    """Return a number in at most four digits, without trailing zeros and with a true minus sign."""
    return f"{float(f'{value:.4g}') + 0.0:g}".replace("-", MINUS)


def power_of_ten(exponent: int) -> str:
    """Return e.g. "10⁻⁵"."""
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def ticks(low: float, high: float, about: int) -> np.ndarray:
    """Return round numbers (1, 2 or 5 times a power of ten apart) from ``low`` to ``high``, some ``about`` of them."""
    rough = (high - low) / about
    power = 10.0 ** np.floor(np.log10(rough))
    step = min((power * m for m in (1, 2, 5, 10)), key=lambda s: abs(np.log(s / rough)))
    return np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step


def limits(*values: np.ndarray, quantile: float = 0.0, margin: float = 0.06) -> tuple[float, float]:
    """Return the range of the finite values less a ``quantile`` at either end, widened by ``margin``; never empty."""
    flat = np.concatenate([np.ravel(v) for v in values])
    flat = flat[np.isfinite(flat)]
    low, high = np.quantile(flat, [quantile, 1 - quantile]) if flat.size else (0.0, 1.0)
    pad = margin * (high - low) or 0.1 * abs(high) or 1.0
    return float(low - pad), float(high + pad)


def figure(width: float, height: float, label: str, parts: Iterable[Markup]) -> Markup:
    """Wrap ``parts`` as an image of ``width`` x ``height`` user units that scales with the page."""
    head = Markup('<svg viewBox="0 0 {:g} {:g}" role="img" aria-label="{}">').format(width, height, label)
    return head + Markup("").join(parts) + Markup("</svg>")


@dataclass(frozen=True)
class Axes:
    """A box in the figure, in user units with y downward, and the ranges of data that it shows."""

    left: float
    top: float
    width: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]

    def at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return data in user units, pinned to the box."""
        u = np.clip((np.asarray(x) - self.x[0]) / (self.x[1] - self.x[0]), 0, 1)
        v = np.clip((np.asarray(y) - self.y[0]) / (self.y[1] - self.y[0]), 0, 1)
        return self.left + self.width * u, self.top + self.height * (1 - v)

    def line(self, x: np.ndarray, y: np.ndarray, kind: str) -> Markup:
        """Join the points; NaN breaks the line."""
        path, pen = [], "M"
        for u, v in zip(*self.at(x, y), strict=True):
            finite = np.isfinite(u + v)
            if finite:
                path.append(f"{pen}{u:.1f} {v:.1f}")
            pen = "L" if finite else "M"
        return Markup('<path class="line {}" d="{}"/>').format(kind, "".join(path))

    def dots(self, x: np.ndarray, y: np.ndarray, kind: str) -> Markup:
        """Draw a dot at every finite point: one path of empty strokes with round caps."""
        u, v = self.at(x, y)
        path = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(u, v, strict=True) if np.isfinite(a + b))
        return Markup('<path class="dots {}" d="{}"/>').format(kind, path)

    def bands(self, intervals: Iterable[tuple[float, float]], kind: str) -> Markup:
        """Shade intervals of x over the full height."""
        box = Markup('<rect class="{}" x="{:.1f}" y="{:g}" width="{:.1f}" height="{:g}"/>')
        spans = [self.at(np.array(pair), np.zeros(2))[0] for pair in intervals]
        return Markup("").join(box.format(kind, a, self.top, b - a, self.height) for a, b in spans)

    def frame(self, x_label: str = "", y_label: str = "") -> Markup:
        """Draw grid, tick labels and axis titles; no tick labels along x without an ``x_label``."""
        parts, bottom, right = [], self.top + self.height, self.left + self.width
        text = Markup('<text class="{}" x="{:.1f}" y="{:.1f}">{}</text>')
        grid = Markup('<path class="{}" d="M{:.1f} {:.1f}L{:.1f} {:.1f}"/>')
        for value in ticks(*self.x, about=max(3, int(self.width // 90))):
            u = float(self.at(value, self.y[0])[0])
            parts.append(grid.format("grid", u, self.top, u, bottom))
            if x_label:
                parts.append(text.format("tick x", u, bottom + 15, plain(value)))
        for value in ticks(*self.y, about=max(3, int(self.height // 42))):
            v = float(self.at(self.x[0], value)[1])
            parts.append(grid.format("zero" if abs(value) < 1e-12 else "grid", self.left, v, right, v))
            parts.append(text.format("tick y", self.left - 6, v + 4, plain(value)))
        if x_label:
            parts.append(text.format("title x", self.left + self.width / 2, bottom + 32, x_label))
        turned = Markup('<text class="title x" transform="translate({:.1f} {:.1f}) rotate(-90)">{}</text>')
        parts.append(turned.format(self.left - 44, self.top + self.height / 2, y_label))
        return Markup("").join(parts)
