"""The cards of the page: findings with their pictures, plain friction in one table, what has no name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.results import Curve, Finding, Unexplained
from torchrbd.effects import known_effects
from torchrbd.effects.registry import PLAIN
from torchrbd.report.excerpt import telling_signal
from torchrbd.report.inline import COLOURS, UNKNOWN
from torchrbd.report.pictures import Pictures, Sense
from torchrbd.report.text.findings import CERTAINLY_MISSING, SHARED
from torchrbd.report.text.names import alternatives, at, guessed, most_changed, when, words_of
from torchrbd.report.text.numbers import measure, unit

# Findings of plain friction from which on they share a table; joints whose errors a card names; change worth naming.
FOLDED, MOST_ERRORS, CHANGED = 4, 4, 0.02


@dataclass(frozen=True)
class Picture:
    """A picture under its own heading, and the models that it compares."""

    title: str
    models: list[str]
    image: Markup


@dataclass(frozen=True)
class Card:
    """A finding or an unexplained residual; ``line``: a remark, or empty; ``errors``: joints whose errors it shows."""

    item: Finding | Unexplained
    title: str
    equation: str
    where: str
    errors: list[str]
    line: str
    pictures: list[Picture]

    @property
    def alternatives(self) -> list[str]:
        """The effects that this data cannot distinguish from the finding."""
        return alternatives(self.item) if isinstance(self.item, Finding) else []

    @property
    def laws(self) -> list[tuple[str, float]]:
        """The effects that explain the same in words, with their probabilities; nothing where there is only one."""
        laws = self.item.laws if isinstance(self.item, Finding) else ()
        return [(words_of(law.effect), law.probability) for law in laws] if len(laws) > 1 else []


@dataclass(frozen=True)
class PlainRow:
    """Plain friction at one joint, None where it was found at others only, and what it could also be."""

    joint: str
    findings: list[Finding | None]
    alternatives: list[str]

    @property
    def values(self) -> list[str]:
        """The findings in numbers, ± 95 %, without unit."""
        quantities = [next(iter(f.parameters.values())) if f else None for f in self.findings]
        return ["" if q is None else measure(q.value, 1.96 * q.std) for q in quantities]


def finding_cards(findings: Sequence[Finding], pictures: Pictures) -> list[Card]:
    """Return a card for each finding, but none for plain friction that has a table."""
    folded = {id(f) for row in plain_rows(findings, pictures.joints) for f in row.findings}
    return [_finding_card(f, pictures) for f in findings if id(f) not in folded]


def plain_rows(findings: Sequence[Finding], joints: Sequence[str]) -> list[PlainRow]:
    """Return plain friction that is likely, a row per joint, if there is much of it."""
    likely = [f for f in findings if f.probability > DECISIONS.likely]
    plain = [f for f in likely if f.effect in PLAIN and f.where.recordings is None]
    here = [f for f in plain if len(f.joints) == 1 and f.joints[0] in joints]
    if len(here) < FOLDED:
        return []
    rows, columns = [], [identifier for identifier in PLAIN if any(f.effect == identifier for f in here)]
    for joint in joints:
        mine = {f.effect: f for f in here if f.joints == (joint,)}
        other = [f"{words_of(f.effect)}: {', '.join(alternatives(f))}" for f in mine.values() if alternatives(f)]
        if mine:
            rows.append(PlainRow(joint, [mine.get(identifier) for identifier in columns], other))
    return rows


def plain_titles(rows: Sequence[PlainRow]) -> list[str]:
    """Return the effects of the table's columns, with their units."""
    titles = []
    for column in zip(*(row.findings for row in rows), strict=True):
        found = [f for f in column if f is not None]
        units = dict.fromkeys(unit(q.unit) for f in found for q in f.parameters.values())
        titles.append(f"{words_of(found[0].effect)} [{', '.join(units)}]")
    return titles


def unexplained_cards(diagnosis: Diagnosis, pictures: Pictures) -> list[Card]:
    """Return a card for each thing that depends on something and has no name."""
    cards = []
    for item in diagnosis.unexplained:
        joint = next((j for j in item.joints if j in pictures.joints), None)
        shown = _pictures(item, joint, item.depends_on, pictures)
        where = when(item.where, pictures.unit_of)
        cards.append(Card(item, f"Unexplained{at(item.joints, ())}", "", where, [], "", shown))
    return cards


def _finding_card(finding: Finding, pictures: Pictures) -> Card:
    known = known_effects().get(finding.effect)
    equation = known.equation if known else ""
    title = guessed(finding) + (at(finding.joints, finding.links) or " (whole robot)")
    own = [f"{key}_{j}" for key in (known.own_signals if known else ()) for j in finding.joints]
    regions = [r.signal for r in finding.where.region or ()]
    joint = most_changed(finding) or next((j for j in finding.joints), None)
    shown = _pictures(
        finding, joint if joint in pictures.joints else None, (*regions, *finding.depends_on, *own), pictures
    )
    where = when(finding.where, pictures.unit_of)
    return Card(finding, title[0].upper() + title[1:], equation, where, _joints_shown(finding), _doubt(finding), shown)


def _doubt(finding: Finding) -> str:
    """Say why a finding is not surer; nothing where it is sure, or where it is common."""
    if finding.probability >= DECISIONS.doubtful:
        return ""
    if finding.indistinguishable_from:
        return f"{CERTAINLY_MISSING} {SHARED}" if finding.log_evidence_gain > DECISIONS.certain_nats else SHARED
    return ""


def _joints_shown(finding: Finding) -> list[str]:
    """Return the joints whose error changes with a finding, its own first, then by fall; or the one that falls most."""
    fall = {j: b - finding.nmse_after[j] for j, b in finding.nmse_before.items() if j in finding.nmse_after}
    best = most_changed(finding)
    changed = [j for j in sorted(fall, key=lambda j: -fall[j]) if abs(fall[j]) > CHANGED * finding.nmse_after[j]]
    changed.sort(key=lambda j: j not in finding.joints)
    return changed[:MOST_ERRORS] or ([best] if best else [])


def _pictures(
    item: Finding | Unexplained,
    name: str | None,
    signals: Sequence[str],
    pictures: Pictures,
) -> list[Picture]:
    """Draw the curve of an item, and the residual at a joint: in its window of time, or against a state.

    The state is the first of ``signals`` that is one, or the most informative if there is no curve.
    """
    if name is None or not pictures.drawn:
        return []
    curve = item.curve
    joint, found = pictures.joints.index(name), []
    if curve is not None:
        colour = COLOURS["extended"] if isinstance(item, Finding) else UNKNOWN
        sense = _sense(item.effect, curve) if isinstance(item, Finding) else None
        image, with_data = pictures.curve(curve, joint, colour, sense)
        found.append(Picture(f"{name}: what it adds ± 95 %{', dots: data' if with_data else ''}", [], image))
    if not pictures.measured[joint]:
        return found
    models = pictures.compared(name)
    excerpt = None
    if item.where.time_s or curve is None:
        excerpt = pictures.around(joint, item.where, models, whole=item.depends_on == ("t",))
    if excerpt is not None:
        return [*found, Picture(f"{name}, {excerpt[0]}", models, excerpt[1])]
    signal = next((pictures.states[s] for s in signals if s in pictures.states), None)
    signal = signal or (telling_signal(pictures.series, joint, models[0]), joint)
    return [*found, Picture(f"{name}, held out", models, pictures.over_state(joint, signal, models))]


def _sense(identifier: str, curve: Curve) -> Sense | None:
    """Return how a curve's torque acts if its signal, and at most the direction of motion, determines it."""
    known = known_effects().get(identifier)
    if known is None:
        return None
    if curve.signal.startswith("qd"):
        return None if known.uses_load else "added"
    senses: dict[str, Sense | None] = {"": "added", "direction": "against the motion", "speed": None}
    return senses[known.curve_times]
