"""What the page says, and in which order: the results in the words and numbers of the template."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from torchrbd.diagnosis.results import Diagnosis, Finding, LeftoverMap, Location, Unexplained
from torchrbd.diagnosis.words import number, words_of
from torchrbd.inference.results import Identification, ParameterEstimate
from torchrbd.physics import effects
from torchrbd.report.excerpt import SIGNALS, informative_stretch, signal_words, telling_signal
from torchrbd.report.figures import Units, decades, dependence_figure, error_figure, time_figure
from torchrbd.report.inline import inline, page_style
from torchrbd.report.maps import map_figure
from torchrbd.report.words import VERDICTS, change, headline, measure, percent, plain, tied, unit, where_words

MODELS = {"urdf": "URDF", "rigid_body": "re-fitted rigid body", "extended": "extended model"}
LEFTOVERS = {
    "rigid_body": "What the re-fitted rigid body with friction leaves",
    "extended": "What the extended model leaves",
}
MOST_TIME_MAPS = 4
CERTAIN, DOUBTFUL = 20.0, 0.9  # log-evidence gain of what is surely there, probability that needs a word


def write_report(result: Identification | Diagnosis, path: Path) -> None:
    """Write one HTML file that needs nothing else: no scripts, no external style, font or picture.

    Args:
        result: what ``identify`` or ``diagnose`` returned.
        path: the file to write.
    """
    page = Page(result)
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "measure": measure, "percent": percent, "change": change}
    environment.filters |= {"plain": plain, "unit": unit, "tied": tied}
    with page_style():
        text = environment.get_template("report.html.j2").render(page=page)
    Path(path).write_text(text, encoding="utf-8")


@dataclass(frozen=True)
class Card:
    """A finding or something unexplained, with its picture; ``line`` is a remark, or empty."""

    item: Finding | Unexplained
    title: str
    equation: str
    where: str
    joints: list[str]
    line: str
    picture: Markup
    models: list[str]


@dataclass(frozen=True)
class JointFigures:
    """Torque against time, the stretch that it shows in words, whether findings are marked, residual against states."""

    time: Markup
    words: str
    marked: bool
    states: list[Markup]


@dataclass(frozen=True)
class Located:
    """Where one model differs from the robot; pictures with the name of their recording, or none."""

    title: str
    statements: list[str]
    times: list[tuple[str, Markup]]
    states: list[tuple[str, Markup]]


class Page:
    """Everything the template shows; each attribute is one part of the page, made when it is asked for."""

    def __init__(self, result: Identification | Diagnosis) -> None:
        self.diagnosis = result if isinstance(result, Diagnosis) else None
        self.result = result.identification if isinstance(result, Diagnosis) else result
        self.series = self.result.series
        self.joints = list(self.series.joints)
        self.models = {m: label for m, label in MODELS.items() if m in self.result.fits}
        self.drawn = [m for m in self.models if m in self.series.predicted]
        self.verdict = self.diagnosis.verdict if self.diagnosis else self.result.verdict
        self.badge = VERDICTS[self.verdict]
        self.headline = headline(result)
        self.with_intervals = self.result.covariance is not None
        names = list(self.result.robot.joint_names)
        prismatic = [bool(self.result.robot.prismatic[names.index(j)]) for j in self.joints]
        self.units = [Units("N", "m") if p else Units("N m", "rad") for p in prismatic]
        self._keys = count(1)
        self.measured = [bool(np.isfinite(self.series.measured[:, i]).any()) for i in range(len(self.joints))]

    @property
    def mean(self) -> dict[str, float]:
        """Mean nmse of each model over the joints that have one."""
        return {m: self.result.fits[m].mean_nmse for m in self.models}

    @cached_property
    def _decades(self) -> tuple[float, float]:
        return decades([v for m in self.models for v in self.result.fits[m].nmse.values()])

    def dots(self, errors: dict[str, float]) -> Markup:
        """Return errors as dots on the scale of the table, or the scale's labels if there are none."""
        label = ", ".join(f"{m} {number(v)}" for m, v in errors.items()) or "logarithmic"
        return self._inline(error_figure(errors, self._decades, labels=not errors), f"nmse {label}")

    def _inline(self, figure: Figure, label: str) -> Markup:
        return inline(figure, label, f"f{next(self._keys)}")

    def errors(self, kind: str, joint: str) -> dict[str, float]:
        """Return nmse or rmse of one joint by model, NaN where there is none."""
        return {m: getattr(self.result.fits[m], kind).get(joint, math.nan) for m in self.models}

    def compared(self, joint: str) -> list[str]:
        """Return the last model and the latest before it that did clearly worse at a joint: the step that mattered."""
        rmse, last = self.errors("rmse", joint), self.drawn[-1]
        worse = [m for m in self.drawn[:-1] if rmse[m] > 1.1 * rmse[last]]
        return [(worse or self.drawn)[-1 if worse else 0], last] if len(self.drawn) > 1 else self.drawn

    def _picture(self, joint: int, signal: tuple[str, int], models: list[str]) -> Markup:
        figure = dependence_figure(self.series, joint, signal, (self.units[joint], self.units[signal[1]]), models)
        return self._inline(
            figure, f"residual of {self.joints[joint]} against {signal_words(self.series, joint, signal)}"
        )

    def _card(self, item: Finding | Unexplained, title: str, equation: str, signals: tuple[str, ...]) -> Card:
        """Illustrate an item by the first of ``signals`` that is a state ("q_joint2"), or the most telling one."""
        picture, models = Markup(), []
        joints = [j for j in item.joints if j in self.joints]
        if isinstance(item, Finding) and not joints:  # an effect on a link: the joint that gains most shows it
            gains = {j: item.nmse_before[j] - after for j, after in item.nmse_after.items() if j in item.nmse_before}
            joints = [j for j in sorted(gains, key=lambda j: -gains[j]) if j in self.joints][:1]
        joint = self.joints.index(joints[0]) if joints else None
        if joint is not None and self.measured[joint] and self.drawn:
            models = self.compared(joints[0]) if isinstance(item, Finding) else self.drawn[-1:]
            states = {f"{key}_{j}": (key, i) for key in SIGNALS for i, j in enumerate(self.joints)}
            signal = next((states[s] for s in signals if s in states), None)
            picture = self._picture(joint, signal or (telling_signal(self.series, joint, models[0]), joint), models)
        line = ""
        if isinstance(item, Finding) and item.indistinguishable_from and item.probability < DOUBTFUL:
            line = "The probability is shared with what it could also be."
            if item.log_evidence_gain > CERTAIN:
                line = "Something is missing here beyond doubt. " + line
        return Card(item, title, equation, where_words(item.where), joints, line, picture, models)

    @cached_property
    def findings(self) -> list[Card]:
        """The named effects, strongest first."""
        cards = []
        for finding in self.diagnosis.findings if self.diagnosis else ():
            known = effects().get(finding.effect)
            equation = known.equation if known else ""
            title = f"{words_of(finding.effect)} at {', '.join(finding.joints + finding.links) or 'the robot'}"
            states = [f"{key}_{j}" for key in re.findall(r"\bq(?:dd?)?\b", equation) for j in finding.joints]
            signals = (*(r.signal for r in finding.where.region or ()), *states)
            cards.append(self._card(finding, title[0].upper() + title[1:], equation, signals))
        return cards

    @cached_property
    def unexplained(self) -> list[Card]:
        """What depends on something and has no name."""
        items = self.diagnosis.unexplained if self.diagnosis else ()
        return [self._card(u, f"Unexplained at {', '.join(u.joints)}", "", u.depends_on) for u in items]

    @cached_property
    def located(self) -> list[Located]:
        """Where each model differs from the robot: sentences and maps; the recordings that are loudest."""
        found = []
        for model, title in LEFTOVERS.items() if self.diagnosis else ():
            maps = [m for m in self.diagnosis.maps if m.model == model] if self.diagnosis else []
            here = [x for x in self.diagnosis.locations if x.model == model] if self.diagnosis else []
            times = sorted((m for m in maps if m.signal == "t"), key=lambda m: -np.nansum(np.square(m.level)))
            pictures = [self._map(m, here) for m in times[:MOST_TIME_MAPS]]
            states = [self._map(m, here) for m in maps if m.signal != "t"]
            if maps:
                found.append(Located(title, [x.statement for x in here], pictures, states))
        return found

    def _map(self, one: LeftoverMap, locations: list[Location]) -> tuple[str, Markup]:
        units = [u.q if one.signal == "t" else u.of(one.signal) for u in self.units]
        label = f"leftover of each joint over {one.signal} {one.recording}".strip()
        return one.recording, self._inline(map_figure(one, self.joints, locations, units), label)

    def alternatives(self, finding: Finding) -> list[str]:
        """Return the effects that this data cannot tell from the finding."""
        places = [(a.effect, ", ".join(a.joints + a.links)) for a in finding.indistinguishable_from]
        return [words_of(effect) + (f" at {place}" if place else "") for effect, place in places]

    def figures(self, joint: int) -> JointFigures:
        """Return what is drawn of one joint."""
        name = self.joints[joint]
        compared = self.compared(name)
        stretch = informative_stretch(self.series, joint, compared[0])
        marks = self.marks(name, stretch.recording)
        figure = time_figure(self.series, joint, stretch, self.units[joint], self.drawn, compared, marks)
        time = self._inline(figure, f"torque of {name} against time")
        return JointFigures(
            time, stretch.words, bool(marks), [self._picture(joint, (s, joint), compared) for s in ("q", "qd")]
        )

    def marks(self, joint: str, recording: str) -> list[tuple[float, float]]:
        """Return when in a recording something that was found at a joint holds, if it does not always."""
        items = [*self.diagnosis.findings, *self.diagnosis.unexplained] if self.diagnosis else []
        here = [i.where for i in items if joint in i.joints or not i.joints]
        return [span for w in here if w.recordings is None or recording in w.recordings for span in w.time_s or ()]

    @property
    def parameters(self) -> dict[str, list[ParameterEstimate]]:
        """The parameters by owner: coefficients of terms first, then link by link."""
        terms = [p for p in self.result.parameters if p.status == "term"]
        groups: dict[str, list[ParameterEstimate]] = {"named terms": terms} if terms else {}
        for p in self.result.parameters:
            if p.status != "term":
                groups.setdefault(p.owner, []).append(p)
        return groups

    @property
    def suggestions(self) -> dict[str, list[str]]:
        """What to record next, with the names of the parameters that it would tell; longest lists first."""
        found: dict[str, list[str]] = {}
        for p in self.result.parameters:
            if p.suggestion:
                found.setdefault(p.suggestion, []).append(p.name)
        return dict(sorted(found.items(), key=lambda item: -len(item[1])))

    def statuses(self, group: list[ParameterEstimate]) -> dict[str, int]:
        """Return how many parameters have each status, in the order of appearance."""
        found = [p.status for p in group]
        return {s: found.count(s) for s in dict.fromkeys(found)}
