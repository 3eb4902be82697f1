"""What a diagnosis has left open: findings, and the effects that cannot be distinguished from them."""

from __future__ import annotations

import copy
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from torchrbd.comparison.reading import side_of
from torchrbd.diagnosis import Alternative, Diagnosis, Finding
from torchrbd.display import Remark
from torchrbd.effects import Effect, Shape, Site, Term, effect
from torchrbd.errors import InputError
from torchrbd.model import RigidBodyDynamics
from torchrbd.robot import RobotModel

# A finding less probable than this has "nothing" among its rivals.
_SURE = 0.95
NOTHING = "nothing"
_REMEDY = "give the folder that 'torchrbd diagnose -o' wrote, or diagnose the recordings again"


@dataclass(frozen=True)
class Rival:
    """An effect with its estimate from the first recordings.

    Attributes:
        words: its name and place; ``NOTHING`` for no effect.
        effect, site, shape: as of a term; None and at no place for no effect.
        coefficients: w (K,).
        probability: given that one of the rivals is true.
    """

    words: str
    effect: Effect | None
    site: Site
    shape: Shape
    coefficients: Tensor
    probability: float


@dataclass(frozen=True)
class Question:
    """Effects to distinguish: a finding first, then its rivals."""

    rivals: tuple[Rival, ...]

    def asks_of(self, term: Term) -> bool:
        """Say whether a term of the model is the finding."""
        own = self.rivals[0]
        return own.effect is not None and (term.effect.id, _everywhere(term.site)) == (own.effect.id, own.site)


@dataclass(frozen=True)
class Known:
    """What is known of a robot before the next recording.

    Attributes:
        model: that torques are predicted by; its parameters need no gradient.
        questions: what is open.
        noise_std: (n,) of the torques, infinite where they are not measured [N m or N].
        cutoff_hz: band limit of the comparison.
        notes: what a user should know of it.
    """

    model: RigidBodyDynamics
    questions: tuple[Question, ...]
    noise_std: Tensor
    cutoff_hz: float
    notes: tuple[Remark, ...]


def known_from(diagnosis: Diagnosis | str | Path) -> Known:
    """Read a diagnosis.

    Args:
        diagnosis: the object, its folder, or its diagnosis.json.

    Raises:
        InputError: it cannot be used; says why.
    """
    side = side_of(diagnosis, "the diagnosis")
    if isinstance(diagnosis, Diagnosis):
        model = copy.deepcopy(diagnosis.identification.model)
        noise = {joint: one.torque for joint, one in diagnosis.identification.noise.items()}
    else:
        folder = Path(diagnosis) if Path(diagnosis).is_dir() else Path(diagnosis).parent
        model, noise = RigidBodyDynamics.load(folder), _noise_of(folder / "parameters.json")
    robot, questions, notes = model.robot, [], []
    for finding in side.findings:
        try:
            rivals = _rivals(robot, finding)
        except (KeyError, ValueError) as error:
            raise InputError(f"{diagnosis}: finding '{finding.effect}' cannot be read ({error}); {_REMEDY}") from None
        if len(rivals) > 1:
            questions.append(Question(rivals))
        if any(not a.parameters for a in finding.indistinguishable_from):
            notes.append(Remark("rivals without parameters", {"finding": _words(finding)}))
    return Known(
        model=model.requires_grad_(False),
        questions=tuple(questions),
        noise_std=torch.tensor([noise.get(j) or torch.inf for j in robot.joint_names], dtype=torch.float64),
        cutoff_hz=side.cutoff_hz,
        notes=tuple(notes),
    )


def _noise_of(file: Path) -> dict[str, float]:
    try:
        return {str(joint): float(std or 0.0) for joint, std in json.loads(file.read_text())["noise_std"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{file}: cannot be read as 'torchrbd diagnose' writes it ({type(error).__name__}: {error}); {_REMEDY}"
        ) from None


def _rivals(robot: RobotModel, finding: Finding) -> tuple[Rival, ...]:
    """Return a finding, the effects that cannot be distinguished from it, and no effect if that is possible.

    Viscous and Coulomb friction are always in the model and are never compared with no effect.
    """
    alike = [a for a in finding.indistinguishable_from if a.parameters]
    others = sum(a.probability for a in alike)
    values = {name: one.value for name, one in finding.parameters.items()}
    own = Alternative(finding.effect, finding.joints, finding.links, finding.depends_on, values, max(1.0 - others, 0.0))
    found = [_rival(robot, one) for one in (own, *alike)]
    found = [one for one in found if bool(one.coefficients.isfinite().all())]
    there = max(finding.probability, finding.family_probability)
    if there < _SURE and not effect(finding.effect).is_ubiquitous and found:
        found = [replace(one, probability=there * one.probability) for one in found]
        found.append(Rival(NOTHING, None, Site(), {}, torch.zeros(0, dtype=torch.float64), 1.0 - there))
    return tuple(found)


def _rival(robot: RobotModel, one: Alternative) -> Rival:
    kind = effect(one.effect)
    names = (one.joints[:1], [s.partition("_")[2] for s in one.depends_on[:1]])
    joint, other = (robot.joint_names.index(name[0]) if name else None for name in names)
    body = robot.body_names.index(one.links[0]) if one.links else None
    w, shape = kind.coefficients(one.parameters)
    coefficients = torch.tensor(w, dtype=torch.float64)
    return Rival(_words(one), kind, Site(joint, other, body), shape, coefficients, one.probability)


def _words(one: Finding | Alternative) -> str:
    """Return an effect's name and place."""
    words, others = effect(one.effect).words, [s.partition("_")[2] for s in one.depends_on]
    if others:
        words = words.replace("another joint's", f"{others[0]}'s")
    place = " and ".join((*one.joints, *one.links))
    return words + (f" at {place}" if place else "")


def _everywhere(site: Site) -> Site:
    return replace(site, window=None, recordings=None)


def other_terms(model: RigidBodyDynamics, question: Question) -> Sequence[Term]:
    """Return the terms of a model that a question is not about."""
    return [term for term in model.terms if not question.asks_of(term)]
