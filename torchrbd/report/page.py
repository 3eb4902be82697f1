"""What the page says, and in which order: the results in the words and numbers of the template."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from torchrbd.diagnosis.results import Diagnosis, Finding, Unexplained, Where
from torchrbd.inference.results import Identification, ParameterEstimate
from torchrbd.physics import effects
from torchrbd.report.figures import (
    SIGNALS,
    ErrorScale,
    Units,
    dependence_figure,
    informative_stretch,
    telling_signal,
    time_figure,
)
from torchrbd.report.svg import MINUS, plain, power_of_ten

MODELS = {"urdf": "URDF", "rigid_body": "re-fitted rigid body", "extended": "extended model"}
BADGES = {
    "consistent": "✓ URDF consistent",
    "parameters": "≠ Parameters differ",
    "missing_physics": "! Missing physics",
    "unexplained": "? Unexplained",
    "identified": "✓ Identified",
}


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
    environment.filters |= {"number": number, "measure": measure, "percent": percent, "change": change, "plain": plain}
    Path(path).write_text(environment.get_template("report.html.j2").render(page=page), encoding="utf-8")


def number(value: float) -> str:
    """Return three significant digits, or a dash where there is no number."""
    if not math.isfinite(value):
        return "–"
    if value == 0 or 1e-4 <= abs(value) < 1e3:
        return (f"{value:#.3g}" if value else "0").rstrip(".").replace("-", MINUS)
    if 1e3 <= abs(value) < 1e6:
        return f"{value:.0f}".replace("-", MINUS)
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}·{power_of_ten(int(exponent))}".replace("-", MINUS)


def measure(value: float, spread: float) -> str:
    """Return ``value ± spread`` with the digits that two significant ones of the spread leave."""
    if not (math.isfinite(spread) and spread > 0):
        return number(value)
    digits = 1 - math.floor(math.log10(spread))
    if digits > 6:
        return f"{number(value)} ± {number(spread)}"
    return f"{value:.{max(0, digits)}f} ± {spread:.{max(0, digits)}f}".replace("-", MINUS)


def percent(share: float) -> str:
    """Return a share in per cent; only certainty is 0 or 100."""
    if 0.995 <= share < 1.0:
        return "> 99 %"
    return "< 1 %" if 0.0 < share < 0.005 else f"{100 * share:.0f} %"


def change(before: float, after: float) -> str:
    """Return by how much an error fell or rose."""
    if not (before > 0 and math.isfinite(after)):
        return ""
    if 0 < after < 0.01 * before:
        return f"{float(f'{before / after:.2g}'):,.0f} times less".replace(",", "\N{NARROW NO-BREAK SPACE}")
    return f"{100 * (after / before - 1):+.0f} %".replace("-", MINUS)


def words_of(effect: str) -> str:
    """Return an effect's name in words, whether or not its effect is registered here."""
    known = effects().get(effect)
    return known.words if known else effect.replace("_", " ").capitalize()


def where_words(where: Where) -> str:
    """Return in which recordings, when and in which region, or nothing for everywhere."""
    parts = [] if where.recordings is None else ["in " + ", ".join(where.recordings)]
    parts += [f"{low:g} to {high:g} s" for low, high in where.time_s or ()]
    parts += [f"{r.signal} from {plain(r.low)} to {plain(r.high)}" for r in where.region or ()]
    return "; ".join(parts)


@dataclass(frozen=True)
class Card:
    """A finding or something unexplained, with its picture."""

    item: Finding | Unexplained
    title: str
    equation: str
    where: str
    joints: list[str]
    picture: Markup
    models: list[str]


class Page:
    """Everything the template shows; each attribute is one part of the page, made when it is asked for."""

    def __init__(self, result: Identification | Diagnosis) -> None:
        self.diagnosis = result if isinstance(result, Diagnosis) else None
        self.result = result.identification if isinstance(result, Diagnosis) else result
        self.series = self.result.series
        self.joints = list(self.series.joints)
        self.models = {m: label for m, label in MODELS.items() if m in self.result.fits}
        self.drawn = [m for m in self.models if m in self.series.predicted]
        self.verdict = self.diagnosis.verdict if self.diagnosis else "identified"
        self.badge = BADGES[self.verdict]
        names = list(self.result.robot.joint_names)
        prismatic = [bool(self.result.robot.prismatic[names.index(j)]) for j in self.joints]
        self.units = [Units("N", "m") if p else Units("N m", "rad") for p in prismatic]
        self.measured = [bool(np.isfinite(self.series.measured[:, i]).any()) for i in range(len(self.joints))]

    @property
    def mean(self) -> dict[str, float]:
        """Mean nmse of each model over the joints that have one."""
        finite = {m: [v for v in self.result.fits[m].nmse.values() if math.isfinite(v)] for m in self.models}
        return {m: float(np.mean(v)) if v else math.nan for m, v in finite.items()}

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        if self.diagnosis:
            return self.diagnosis.statement
        before, after = self.mean["urdf"], self.mean["rigid_body"]
        name, numbers = self.result.robot.name, f"mean nmse {number(before)} → {number(after)}"
        if not after < before:
            return f"Re-fitting does not lower the held-out torque error of {name}: {numbers}."
        return f"Re-fitting lowers the held-out torque error of {name} by {percent(1 - after / before)}: {numbers}."

    @property
    def scale(self) -> ErrorScale:
        """The scale of the table's dots."""
        return ErrorScale.over([v for m in self.models for v in self.result.fits[m].nmse.values()])

    def errors(self, kind: str, joint: str) -> dict[str, float]:
        """Return nmse or rmse of one joint by model, NaN where there is none."""
        return {m: getattr(self.result.fits[m], kind).get(joint, math.nan) for m in self.models}

    def compared(self, joint: str) -> list[str]:
        """Return the last model and the latest before it that did clearly worse at a joint: the step that mattered."""
        rmse, last = self.errors("rmse", joint), self.drawn[-1]
        worse = [m for m in self.drawn[:-1] if rmse[m] > 1.1 * rmse[last]]
        return [(worse or self.drawn)[-1 if worse else 0], last] if len(self.drawn) > 1 else self.drawn

    def _picture(self, joint: int, signal: tuple[str, int], models: list[str]) -> Markup:
        return dependence_figure(self.series, joint, signal, (self.units[joint], self.units[signal[1]]), models)

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
        return Card(item, title, equation, where_words(item.where), joints, picture, models)

    @property
    def findings(self) -> list[Card]:
        """The named effects, strongest first."""
        cards = []
        for finding in self.diagnosis.findings if self.diagnosis else ():
            known = effects().get(finding.effect)
            title = f"{words_of(finding.effect)} at {', '.join(finding.joints + finding.links) or 'the robot'}"
            signals = tuple(r.signal for r in finding.where.region or ())
            cards.append(self._card(finding, title, known.equation if known else "", signals))
        return cards

    @property
    def unexplained(self) -> list[Card]:
        """What depends on something and has no name."""
        items = self.diagnosis.unexplained if self.diagnosis else ()
        return [self._card(u, f"Unexplained at {', '.join(u.joints)}", "", u.depends_on) for u in items]

    def alternatives(self, finding: Finding) -> list[str]:
        """Return the effects that this data cannot tell from the finding."""
        places = [(a.effect, ", ".join(a.joints + a.links)) for a in finding.indistinguishable_from]
        return [words_of(effect) + (f" at {place}" if place else "") for effect, place in places]

    def figures(self, joint: int) -> tuple[Markup, str, list[Markup]]:
        """Return the figure against time, the stretch it shows in words, and those against position and velocity."""
        compared = self.compared(self.joints[joint])
        stretch = informative_stretch(self.series, joint, compared[0])
        marks = self.marks(self.joints[joint], stretch.recording)
        against_time = time_figure(self.series, joint, stretch, self.units[joint], self.drawn, compared, marks)
        return against_time, stretch.words, [self._picture(joint, (s, joint), compared) for s in ("q", "qd")]

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

    def statuses(self, group: list[ParameterEstimate]) -> dict[str, int]:
        """Return how many parameters have each status, in the order of appearance."""
        found = [p.status for p in group]
        return {s: found.count(s) for s in dict.fromkeys(found)}
