"""What the page says, and in which order: the results in the words and numbers of the template."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from markupsafe import Markup

from torchrbd._runtime.outputs import write_whole
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.results import Finding, HeldOutCheck
from torchrbd.inference.identification import Identification
from torchrbd.inference.results import ParameterEstimate
from torchrbd.report.cards import Card, PlainRow, finding_cards, plain_rows, plain_titles, unexplained_cards
from torchrbd.report.considered import BAR_END, Considered, considered
from torchrbd.report.excerpt import informative_excerpt
from torchrbd.report.inline import page_style
from torchrbd.report.pictures import Pictures
from torchrbd.report.springs import spring_figure
from torchrbd.report.templates import environment
from torchrbd.report.text.console import closed_loop_words
from torchrbd.report.text.numbers import plain
from torchrbd.report.text.verdict import badge, headline, model_words, part_left
from torchrbd.simulation import COASTING, MotionError

RESIDUALS = {
    "rigid_body": "Residual of the re-fitted rigid body with baseline friction",
    "extended": "Residual of the extended model",
}
MOST_TIME_MAPS = 4


def write_report(result: Identification | Diagnosis, path: str | Path) -> None:
    """Write one HTML file that needs nothing else: no scripts, no external style, font or picture.

    Args:
        result: what ``identify`` or ``diagnose`` returned.
        path: the file to write.
    """
    page = Page(result)
    templates = environment()
    templates.filters |= {"part_left": part_left, "signal_words": _signal_words, "thousandths": _thousandths}
    templates.globals |= {"closed_loop_words": closed_loop_words}
    with page_style():
        text = templates.get_template("report.html.j2").render(page=page)
    write_whole(Path(path), text.encode())


def _signal_words(signal: str, pictures: Pictures) -> str:
    return pictures.words_of(signal)


@dataclass(frozen=True)
class JointFigures:
    """Torque against time, what its window is called, whether findings are marked, residual against states."""

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


@dataclass(frozen=True)
class Strayed:
    """How far a model strays from a recorded motion, in thousandths, and whether that is no better than coasting."""

    median: str
    range: str
    useless: bool


class Page:
    """Everything the template shows; each attribute is one part of the page, made when it is asked for."""

    def __init__(self, result: Identification | Diagnosis) -> None:
        self.diagnosis = result if isinstance(result, Diagnosis) else None
        self.result = result.identification if isinstance(result, Diagnosis) else result
        self.pictures = Pictures(self.result)
        self.joints = self.pictures.joints
        self.models = self.pictures.models | {"urdf": model_words(result)}
        self.verdict = self.diagnosis.verdict if self.diagnosis else self.result.verdict
        self.badge = badge(result)
        self.headline = headline(result)
        self.with_intervals = self.result.covariance is not None

    @property
    def mean(self) -> dict[str, float]:
        """Mean nmse of each model over the joints that have one."""
        return {m: self.result.fits[m].mean_nmse for m in self.models}

    @staticmethod
    def best(errors: Mapping[str, float]) -> float:
        """Return the largest error that cannot be distinguished from the smallest, of models by name."""
        return (1.0 + DECISIONS.no_change) * min((e for e in errors.values() if math.isfinite(e)), default=math.nan)

    @cached_property
    def findings(self) -> list[Card]:
        """The named effects, strongest first, without plain friction that has its table."""
        return finding_cards(self.diagnosis.findings, self.pictures) if self.diagnosis else []

    @cached_property
    def friction(self) -> list[PlainRow]:
        """Viscous and Coulomb friction and offsets, a row per joint, if there are many."""
        return plain_rows(self.diagnosis.findings, self.joints) if self.diagnosis else []

    @cached_property
    def considered(self) -> Considered | None:
        """What was considered, by its evidence, if that is known."""
        if self.diagnosis is None or self.diagnosis.ranking is None:
            return None
        return considered(self.diagnosis.ranking, self.result.robot)

    @property
    def bar_end(self) -> float:
        """Evidence at which a bar ends."""
        return BAR_END

    @property
    def held_out_checks(self) -> list[HeldOutCheck]:
        """What the extended model is worth at each joint, if it has anything that the rigid body lacks."""
        return list(self.diagnosis.held_out_checks) if self.diagnosis and self.diagnosis.findings else []

    @property
    def plain_titles(self) -> list[str]:
        """What the columns of that table are called."""
        return plain_titles(self.friction)

    @cached_property
    def unexplained(self) -> list[Card]:
        """What depends on something and has no name."""
        return unexplained_cards(self.diagnosis, self.pictures) if self.diagnosis else []

    @property
    def not_confirmed(self) -> tuple[Finding, ...]:
        """Effects that are likely, but that cross-validation does not confirm."""
        return self.diagnosis.not_confirmed if self.diagnosis else ()

    @property
    def found(self) -> set[str]:
        """Joints at which something special was found."""
        return {j for card in (*self.findings, *self.unexplained) for j in card.item.joints}

    @cached_property
    def located(self) -> list[Located]:
        """Where each model differs from the robot: sentences and maps; the recordings that are loudest."""
        found = []
        for model, title in RESIDUALS.items() if self.diagnosis else ():
            maps = [m for m in self.diagnosis.maps if m.model == model] if self.diagnosis else []
            here = [x for x in self.diagnosis.locations if x.model == model] if self.diagnosis else []
            times = sorted((m for m in maps if m.signal == "t"), key=lambda m: -np.nansum(np.square(m.level)))
            pictures = [self.pictures.map(m, here) for m in times[:MOST_TIME_MAPS]]
            states = [self.pictures.map(m, here) for m in maps if m.signal != "t"]
            if maps:
                found.append(Located(title, [x.statement for x in here], pictures, states))
        return found

    @cached_property
    def springs(self) -> list[tuple[str, Markup]]:
        """What encoders behind the gears show: sentences with their pictures."""
        draw, found = self.pictures, self.diagnosis.joint_deflections if self.diagnosis else ()
        units = dict(zip(self.joints, draw.units, strict=True))
        return [
            (d.statement, draw.inline(spring_figure(d, units[d.joint]), f"deflection of {d.joint} against its load"))
            for d in found
            if d.joint in units
        ]

    def strayed(self, within: MotionError, model: str, joint: str) -> Strayed:
        """Return how far a model strays from the recorded motion of a joint within windows of one length."""
        if joint not in within.windows:
            return Strayed("", "", False)
        found, coasting = within.errors[model][joint], within.errors[COASTING][joint]
        last = [name for name in within.errors if name != COASTING][-1]
        useless = model == last and found.median > coasting.median and found.high > coasting.high
        median, low, high = (_thousandths(x) for x in (found.median, found.low, found.high))
        return Strayed(median, f"{low}–{high}" if math.isfinite(found.low) else "", useless)

    def figures(self, joint: int) -> JointFigures:
        """Return what is drawn of one joint."""
        name, draw = self.joints[joint], self.pictures
        compared = draw.compared(name)
        excerpt = informative_excerpt(draw.series, joint, compared[0])
        marks = self.marks(name, excerpt.recording)
        time = draw.over_time(joint, excerpt, compared, marks)
        states = [draw.over_state(joint, (s, joint), compared) for s in ("q", "qd")]
        return JointFigures(time, excerpt.words, bool(marks), states)

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
        """What to record next, with the names of the parameters that it would identify; longest lists first."""
        found: dict[str, list[str]] = {}
        for p in self.result.parameters:
            if p.suggestion:
                found.setdefault(p.suggestion, []).append(p.name)
        return dict(sorted(found.items(), key=lambda item: -len(item[1])))

    def statuses(self, group: list[ParameterEstimate]) -> dict[str, int]:
        """Return how many parameters have each status, in the order of appearance."""
        found = [p.status for p in group]
        return {s: found.count(s) for s in dict.fromkeys(found)}


def _thousandths(x: float) -> str:
    """Return a length or angle in mm or mrad in two digits."""
    return plain(1e3 * x, 2) if math.isfinite(x) else "∞"
