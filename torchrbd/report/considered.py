"""What was considered: hypotheses by their evidence, baseline friction, clocks, in words and bars."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from torchrbd.diagnosis.ranked import Ranked, Ranking
from torchrbd.diagnosis.results import Where
from torchrbd.effects import known_effects
from torchrbd.report.text.hypotheses import (
    FIRST_STEP,
    LAST_STEP,
    WITHOUT_EFFECTS,
    as_alternative,
    clock_words,
    given_words,
    misfit_sentence,
)
from torchrbd.report.text.names import named, when
from torchrbd.report.text.numbers import MINUS, joined, number, with_unit
from torchrbd.robot import RobotModel

# Evidence at which a bar ends [nats], rows of a table, and parameters that one row names.
BAR_END, MOST_ROWS, MOST_PARAMETERS = 30.0, 12, 4
_Key = tuple[str, tuple[str, ...], tuple[str, ...], tuple[str, ...]]


@dataclass(frozen=True)
class Row:
    """One hypothesis: ``bar`` is the part of the longest bar that it takes, ``beyond`` whether it would be longer."""

    title: str
    place: str
    when: str
    parameters: list[str]
    more: int
    evidence: str
    bar: float
    beyond: bool
    adopted: bool
    beats_chance: bool


@dataclass(frozen=True)
class Step:
    """Hypotheses given one model, best first; ``more`` were considered and are not shown."""

    title: str
    condition: str
    rows: list[Row]
    more: int

    @property
    def at_times(self) -> bool:
        """Whether any of them acts for a time only."""
        return any(row.when for row in self.rows)


@dataclass(frozen=True)
class Ordinary:
    """Baseline friction of one joint in words; evidence against leaving out viscous and Coulomb friction.

    ``urdf_viscous`` and ``urdf_coulomb`` are what the URDF has of it, empty if nothing.
    """

    joint: str
    viscous: str
    viscous_evidence: str
    viscous_significant: bool
    urdf_viscous: str
    coulomb: list[str]
    width: str
    coulomb_evidence: str
    coulomb_significant: bool
    urdf_coulomb: str


@dataclass(frozen=True)
class Considered:
    """What the page says of a ranking."""

    number: int
    band_hz: float
    chance: str
    chance_at: float
    ordinary: list[Ordinary]
    misfit: str
    clocks: list[tuple[str, str]]
    steps: list[Step]


def considered(found: Ranking, robot: RobotModel) -> Considered:
    """Return a ranking in the words and numbers of the page.

    Args:
        found: the ranking.
        robot: the robot.
    """
    prismatic = dict(zip(robot.joint_names, robot.prismatic.tolist(), strict=True))
    adopted = {_key(one) for one in found.adopted}

    def step(title: str, condition: str, ranked: Sequence[Ranked], known: set[_Key]) -> Step:
        rows = [_row(one, found, prismatic, adopted=_key(one) in known) for one in ranked[:MOST_ROWS]]
        return Step(title, condition, rows, max(found.considered, len(ranked)) - len(rows))

    steps = [step(FIRST_STEP, WITHOUT_EFFECTS, found.first, adopted)]
    if adopted:
        steps.append(step(LAST_STEP, given_words(found.adopted), found.last, adopted))
    return Considered(
        number=found.considered,
        band_hz=found.band_hz,
        chance=nats(_chance(found)),
        chance_at=min(1.0, _chance(found) / BAR_END),
        ordinary=_ordinary(found.ordinary, robot),
        misfit=misfit_sentence(found.misfit),
        clocks=[(name, clock_words(*delay)) for name, delay in found.delay_s.items()],
        steps=steps,
    )


def nats(evidence: float) -> str:
    """Return a log evidence as one reads it."""
    if not math.isfinite(evidence):
        return "–"
    return f"{evidence:.{0 if abs(evidence) >= 100 else 1}f}".replace("-0.0", "0.0").replace("-", MINUS)


def _key(one: Ranked) -> _Key:
    return one.effect, one.joints, one.links, () if one.other is None else (one.other,)


def _chance(found: Ranking) -> float:
    return math.log(max(found.considered, 1))


def _beats_chance(one: Ranked, found: Ranking) -> bool:
    return one.log_evidence > _chance(found)


def _row(one: Ranked, found: Ranking, prismatic: Mapping[str, bool], *, adopted: bool) -> Row:
    words = named(as_alternative(one))
    bar = one.log_evidence / BAR_END if math.isfinite(one.log_evidence) else 0.0
    parameters = _parameters(one, prismatic)
    return Row(
        title=words[0].upper() + words[1:],
        place=joined((*one.joints, *one.links)) or "whole robot",
        when="" if one.window is None else when(Where((one.window[0],), (one.window[1:],))),
        parameters=parameters[:MOST_PARAMETERS],
        more=max(0, len(parameters) - MOST_PARAMETERS),
        evidence=nats(one.log_evidence),
        bar=min(max(bar, 0.0), 1.0),
        beyond=bar > 1.0,
        adopted=adopted,
        beats_chance=_beats_chance(one, found),
    )


def _parameters(one: Ranked, prismatic: Mapping[str, bool]) -> list[str]:
    """Return parameters with their units: "mass 0.5 kg"."""
    known, slides = known_effects().get(one.effect), any(prismatic.get(j, False) for j in one.joints)
    units = known.units if known else {}
    return [
        with_unit(
            f"{name.replace('_', ' ')} {number(value)}",
            known.unit(name, prismatic=slides) if known and name in units and math.isfinite(value) else "",
        )
        for name, value in one.parameters.items()
    ]


def _ordinary(found: Sequence[Ranked], robot: RobotModel) -> list[Ordinary]:
    """Return a row per joint."""
    viscous = {one.joints: one for one in found if "viscous" in one.parameters}
    coulomb = {one.joints: one for one in found if "coulomb_plus" in one.parameters}
    rows = []
    for j, joint in enumerate(robot.joint_names):
        slow, dry = viscous.get((joint,)), coulomb.get((joint,))
        if slow is None or dry is None:
            continue
        length, torque = ("m", "N") if bool(robot.prismatic[j]) else ("rad", "N m")
        urdf_viscous, urdf_coulomb = (number(float(x[j])) if x[j] else "" for x in (robot.damping, robot.friction))
        rows.append(
            Ordinary(
                joint=joint,
                viscous=with_unit(number(slow.parameters["viscous"]), f"{torque} s/{length}"),
                viscous_evidence=nats(slow.log_evidence),
                viscous_significant=slow.log_evidence > 0,
                urdf_viscous=urdf_viscous,
                coulomb=[with_unit(number(dry.parameters[f"coulomb_{way}"]), torque) for way in ("plus", "minus")],
                width=with_unit(number(dry.shape.get("width", math.nan)), f"{length}/s"),
                coulomb_evidence=nats(dry.log_evidence),
                coulomb_significant=dry.log_evidence > 0,
                urdf_coulomb=urdf_coulomb,
            )
        )
    return rows
