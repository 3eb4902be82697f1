"""Pictures of one result, ready for the page: which models a joint compares, drawn and inlined."""

from __future__ import annotations

import math
from functools import cached_property
from itertools import count
from typing import Literal

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from torchrbd.diagnosis.results import Curve, Location, ResidualMap, Where
from torchrbd.inference.identification import Identification
from torchrbd.report.excerpt import SIGNALS, Excerpt, signal_words
from torchrbd.report.figures import (
    Units,
    curve_figure,
    decades,
    dependence_figure,
    error_figure,
    residual_figure,
    time_figure,
)
from torchrbd.report.inline import inline
from torchrbd.report.maps import map_figure
from torchrbd.report.text.numbers import number

MODELS = {
    "urdf": "URDF",
    "baseline": "baseline (least squares with friction)",
    "rigid_body": "re-fitted rigid body",
    "extended": "extended model",
}
# Errors alone are shown of it.
_NOT_DRAWN = "baseline"
OTHER_SIGNALS = {
    "t": "time",
    "frequency": "frequency",
    "tau": "torque of the rigid body",
    "tau_rate": "rate of the torque of the rigid body",
    "temperature": "temperature",
    "deflection": "deflection of the gear",
}
Sense = Literal["added", "against the motion"]
# Slower than this part of the largest speed a motion has no direction here.
_MOVING = 0.02
# What is shown of a recording before and after a window of time, in parts of its length, and at least [s].
_MARGIN, _LEAST_MARGIN_S = 0.5, 2.0
# Of a hum.
_CYCLES = 12


class Pictures:
    """Draw what a result shows of its joints.

    Attributes:
        joints, units, measured: names, units, and whether there is a torque, of each joint.
        models: those that were fitted, by id, in words.
        drawn: those whose torque is drawn against time; none where only second moments were at hand.
    """

    def __init__(self, result: Identification) -> None:
        self.result, self.series = result, result.series
        self.joints = list(self.series.joints)
        self.models = {m: label for m, label in MODELS.items() if m in result.fits}
        seen = len(self.series.t) > 0
        self.drawn = [m for m in self.models if m in self.series.predicted and seen and m != _NOT_DRAWN]
        names = list(result.robot.joint_names)
        prismatic = [bool(result.robot.prismatic[names.index(j)]) for j in self.joints]
        self.units = [Units("N", "m") if p else Units("N m", "rad") for p in prismatic]
        known = result.fits["urdf"].nmse
        self.measured = [
            bool(np.isfinite(self.series.measured[:, i]).any()) if seen else j in known
            for i, j in enumerate(self.joints)
        ]
        self._keys = count(1)

    @cached_property
    def states(self) -> dict[str, tuple[str, int]]:
        """Kind and joint of every signal that is a state, by name: "q_joint2"."""
        return {f"{key}_{j}": (key, i) for key in SIGNALS for i, j in enumerate(self.joints)}

    @cached_property
    def unit_of(self) -> dict[str, str]:
        """Unit of every signal by name."""
        found = {name: self.units[i].of(key) for name, (key, i) in self.states.items()} | {"t": "s", "frequency": "Hz"}
        for joint, u in zip(self.joints, self.units, strict=True):
            others = {"tau": u.tau, "tau_rate": f"{u.tau}/s", "temperature": "°C", "deflection": u.q}
            found |= {f"{key}_{joint}": symbol for key, symbol in others.items()}
        return found

    @cached_property
    def _decades(self) -> tuple[float, float]:
        return decades([v for m in self.models for v in self.result.fits[m].nmse.values()])

    def words_of(self, signal: str) -> str:
        """Return a signal in words: "position of joint2"."""
        if signal in OTHER_SIGNALS:
            return OTHER_SIGNALS[signal]
        for joint in self.joints:
            words = (SIGNALS | OTHER_SIGNALS).get(signal.removesuffix(f"_{joint}"))
            if words and signal.endswith(f"_{joint}"):
                return f"{words} of {joint}"
        return signal

    def inline(self, figure: Figure, label: str) -> Markup:
        """Return a figure for the page, with names of its own."""
        return inline(figure, label, f"f{next(self._keys)}")

    def errors(self, kind: str, joint: str) -> dict[str, float]:
        """Return nmse or rmse of one joint by model, NaN where there is none."""
        return {m: getattr(self.result.fits[m], kind).get(joint, math.nan) for m in self.models}

    def compared(self, joint: str) -> list[str]:
        """Return the last model and the latest before it that did clearly worse at a joint: the step that mattered."""
        rmse, last = self.errors("rmse", joint), self.drawn[-1]
        worse = [m for m in self.drawn[:-1] if rmse[m] > 1.1 * rmse[last]]
        return [(worse or self.drawn)[-1 if worse else 0], last] if len(self.drawn) > 1 else self.drawn

    def dots(self, errors: dict[str, float]) -> Markup:
        """Return errors as dots on the scale of the table, or the scale's labels if there are none."""
        label = ", ".join(f"{m} {number(v)}" for m, v in errors.items()) or "logarithmic"
        return self.inline(error_figure(errors, self._decades, labels=not errors), f"nmse {label}")

    def over_state(self, joint: int, signal: tuple[str, int], models: list[str]) -> Markup:
        """Draw the residual of a joint against a state."""
        figure = dependence_figure(self.series, joint, signal, (self.units[joint], self.units[signal[1]]), models)
        return self.inline(
            figure, f"residual of {self.joints[joint]} against {signal_words(self.series, joint, signal)}"
        )

    def over_time(self, joint: int, excerpt: Excerpt, models: list[str], marks: list[tuple[float, float]]) -> Markup:
        """Draw torque and residual of a joint against time."""
        figure = time_figure(self.series, joint, excerpt, self.units[joint], self.drawn, models, marks)
        return self.inline(figure, f"torque of {self.joints[joint]} against time")

    def around(self, joint: int, where: Where, models: list[str], *, whole: bool) -> tuple[str, Markup] | None:
        """Draw the residual of a joint in and around the first window of time of ``where``, named by its recording.

        Of a hum, some cycles are drawn, from the middle of a recording. Without a window it is drawn only if ``whole``.
        """
        s = self.series
        names = [r for r in s.recordings if where.recordings is None or r in where.recordings]
        hum = next((r for r in where.region or () if r.signal == "frequency"), None)
        if not names or not (whole or where.recordings or where.time_s or hum):
            return None
        rows = np.flatnonzero(s.recording == s.recordings.index(names[0]))
        span = where.time_s[0] if where.time_s else (-math.inf, math.inf)
        margin = max(_MARGIN * (span[1] - span[0]), _LEAST_MARGIN_S)
        low, high = span[0] - margin, span[1] + margin
        if hum is not None:
            low = s.t[rows[len(rows) // 2]]
            high = low + _CYCLES / hum.low
        rows = rows[(s.t[rows] >= low) & (s.t[rows] <= high)]
        if len(rows) < 2:
            return None
        figure = residual_figure(s, joint, rows, self.units[joint].tau, models, span)
        return names[0], self.inline(figure, f"residual of {self.joints[joint]} in {names[0]}")

    def curve(self, curve: Curve, joint: int, colour: str, sense: Sense | None) -> tuple[Markup, bool]:
        """Draw the function that shows a term, and say whether data is drawn with it.

        The data is the residual of the extended model plus the function, for samples of all recordings.

        Args:
            curve: the function.
            joint: whose torque it is.
            colour: of the function.
            sense: whether the torque depends on the signal alone or acts against the motion too; None if neither.
        """
        name, state = self.joints[joint], self.states.get(curve.signal)
        key = curve.signal.removesuffix(f"_{name}")
        words = OTHER_SIGNALS.get(key, curve.signal) if state is None else signal_words(self.series, joint, state)
        x, data, direction = np.array(curve.at), None, self.series.qd[:, joint]
        sense = sense if (np.diff(x) >= 0).all() else None  # no function: a loop
        if sense and (state or key == "t") and self.measured[joint]:
            signal = self.series.t if state is None else getattr(self.series, state[0])[:, state[1]]
            left = self.series.residual(self.drawn[-1])[:, joint]
            rows = np.isfinite(left)
            if sense != "added":
                left, rows = left * np.sign(direction), rows & (np.abs(direction) > _MOVING * np.abs(direction).max())
            data = signal[rows], (left + np.interp(signal, x, curve.torque))[rows]
        unit = self.unit_of.get(curve.signal, "")
        torque = "force" if self.units[joint].tau == "N" else "torque"
        labels = f"{words} [{unit}]" if unit else words, f"{torque} {sense or 'added'} [{self.units[joint].tau}]"
        figure = curve_figure(curve, labels, colour, data)
        return self.inline(figure, f"torque added at {name} against {words}"), data is not None

    def map(self, one: ResidualMap, locations: list[Location]) -> tuple[str, Markup]:
        """Draw a map of the residual, named by its recording."""
        units = [u.q if one.signal == "t" else u.of(one.signal) for u in self.units]
        label = f"residual of each joint over {one.signal} {one.recording}".strip()
        return one.recording, self.inline(map_figure(one, self.joints, locations, units), label)
