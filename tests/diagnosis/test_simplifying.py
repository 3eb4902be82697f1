"""A law is no richer than its estimate: fabricated fits of a spring that may be a constant torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch
from inference.problems import urdf_of

from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.diagnosis import simplifying
from torchrbd.diagnosis.evidence_cap import bayes_factor
from torchrbd.diagnosis.final_model import FinalModel
from torchrbd.diagnosis.hypotheses import Hypothesis
from torchrbd.diagnosis.outcome import SearchOutcome, Term
from torchrbd.diagnosis.simplifying import as_estimated, simplified
from torchrbd.effects import JointScale, Site, effect
from torchrbd.robot import RobotModel

COLUMNS = Columns(RobotModel.from_urdf(urdf_of(2, 2)), (), [JointScale(1.0, 1e-3, -1.0, 1.0)] * 2)
ROWS = cast(Any, SimpleNamespace(columns=COLUMNS))
# Of the stiffness and the torque at zero; the prior's are SCALE.
CERTAIN, ZERO, STD, SCALE = (5.0, 1.0), (0.1, 1.0), 0.5, 2.0
NARROW = np.diag([1e-4, 1e-4])


def hypothesis(name: str, log_evidence: float, joint: int = 0) -> Hypothesis:
    c = COLUMNS.candidate(effect(name), Site(joint), {})
    return Hypothesis(c, log_evidence, np.zeros(len(c.labels)), np.ones(len(c.labels)), SCALE, 1)


def gain(stiffness: float) -> float:
    """Log B of a stiffness alone."""
    return bayes_factor(np.array([stiffness]), np.array([[STD**2]]), np.array([SCALE]))


class Model(SimpleNamespace):
    """A fit in which springs have an estimate at each joint, and all else is certain."""

    springs: Sequence[tuple[float, float]]
    scatter = None

    def coefficients(self, c: Candidate) -> tuple[torch.Tensor, torch.Tensor]:
        w = self.springs[c.joint] if c.effect.id == "joint_spring" else (5.0,) * len(c.labels)
        return torch.tensor(w, dtype=torch.float64), STD**2 * torch.eye(len(w), dtype=torch.float64)


class Fit(SimpleNamespace):
    """A likelihood that says what was added to it."""

    extra: list[Any]

    def extended(self, extra: list[Any]) -> Fit:
        return Fit(extra=extra)

    @property
    def refit(self) -> Fit:
        return self


def model(terms: Sequence[Term], *springs: tuple[float, float]) -> FinalModel:
    candidates, fit = tuple(t.own.candidate for t in terms), Fit(extra=[f"old {t.own.name[0]}" for t in terms])
    found = SearchOutcome(cast(Any, None), cast(Any, fit), ROWS, tuple(terms), [], [], 0, cast(Any, None))
    made = cast(Any, Model(springs=springs))
    return FinalModel(cast(Any, None), found, made, made, (), candidates, (NARROW,) * len(terms))


@pytest.fixture(autouse=True)
def refitted(monkeypatch: pytest.MonkeyPatch) -> list[tuple[FinalModel, tuple[str, ...]]]:
    """Return the models that were fitted again; none is a fit of data, and priors are of one."""
    calls: list[tuple[FinalModel, tuple[str, ...]]] = []

    def extended(_: Any, found: SearchOutcome, may: tuple[str, ...], __: Any) -> FinalModel:
        calls.append((replace(model(found.terms, ZERO, ZERO), found=found), may))
        return calls[-1][0]

    monkeypatch.setattr(simplifying, "fit_final_model", extended)
    monkeypatch.setattr(simplifying, "prior_std", lambda _, __, c: (np.ones(len(c.labels)), ()))
    monkeypatch.setattr(Hypothesis, "extra", lambda self, *_: f"new {self.name[0]}")
    return calls


def simplest(terms: Sequence[Term], *springs: tuple[float, float]) -> FinalModel:
    return simplified(model(terms, *springs), cast(Any, None), ("joint_spring",), lambda *_: None)


def test_a_spring_whose_stiffness_is_certain_stays(refitted: list[Any]) -> None:
    offset = hypothesis("torque_offset", 20.0)
    before = Term(hypothesis("joint_spring", 40.0), (offset,))
    assert gain(CERTAIN[0]) > 20.0
    found = simplest([before], CERTAIN)
    assert found.found.terms == (before,)
    assert refitted == []


def test_a_spring_is_no_likelier_than_its_stiffness_makes_it(refitted: list[Any]) -> None:
    """log B(spring) <= log B(offset) + log B(stiffness), with which it stays the likelier."""
    offset = hypothesis("torque_offset", 20.0)
    assert 0.0 < gain(2.0) < 20.0
    (term,) = simplest([Term(hypothesis("joint_spring", 40.0), (offset,))], (2.0, 1.0)).found.terms
    assert term.own.name[0] == "joint_spring"
    assert term.own.log_evidence == pytest.approx(20.0 + gain(2.0))
    assert term.rivals == (offset,)
    assert refitted == []


def test_a_spring_whose_stiffness_may_be_zero_is_a_constant_torque(refitted: list[Any]) -> None:
    inertia, offset = hypothesis("rotor_inertia", 30.0, joint=1), hypothesis("torque_offset", 20.0)
    drag, spring = hypothesis("quadratic_drag", 3.0), hypothesis("joint_spring", 40.0)
    assert gain(ZERO[0]) < 0.0
    found = simplest([Term(inertia, ()), Term(spring, (drag, offset))], ZERO)
    first, second = found.found.terms
    assert first == Term(inertia, ())
    assert second.own == offset
    assert [h.name[0] for h in second.rivals] == ["joint_spring", "quadratic_drag"]
    assert second.rivals[0].log_evidence == pytest.approx(20.0 + gain(ZERO[0]))
    ((again, may),) = refitted
    assert may == ("joint_spring",)
    # What has not changed keeps its columns, with the sizes that were learnt.
    assert again.found.fit.extra == ["old rotor_inertia", "new torque_offset"]
    assert found.terms == tuple(t.own.candidate for t in found.found.terms)


def test_a_law_that_is_richer_only_in_the_new_fit_is_replaced_too(refitted: list[Any]) -> None:
    springs = [hypothesis("joint_spring", 40.0, joint) for joint in (0, 1)]
    offsets = [hypothesis("torque_offset", 20.0, joint) for joint in (0, 1)]
    terms = [Term(*one) for one in zip(springs, [(offset,) for offset in offsets], strict=True)]
    found = simplest(terms, ZERO, CERTAIN)
    assert [t.own for t in refitted[0][0].found.terms] == [offsets[0], springs[1]]
    assert [t.own for t in found.found.terms] == offsets
    assert len(refitted) == 2


@pytest.mark.parametrize(
    ("name", "joint"),
    [("torque_offset", 1), ("rotor_inertia", 0), ("joint_spring", 0)],
    ids=["place", "column", "same"],
)
def test_only_a_part_of_the_law_at_its_place_is_simpler(name: str, joint: int, refitted: list[Any]) -> None:
    """Another law does not take its place here, however likely it is."""
    before = Term(hypothesis("joint_spring", 40.0), (hypothesis(name, 50.0, joint),))
    assert simplest([before], ZERO).found.terms == (before,)
    assert refitted == []


@pytest.mark.parametrize(("log_evidence", "less"), [(100.0, True), (1.0, False)], ids=["surer", "less sure"])
def test_a_term_and_its_rivals_are_no_surer_than_its_estimate(log_evidence: float, less: bool) -> None:
    rival = hypothesis("torque_offset", log_evidence - 4.0)
    before = Term(hypothesis("joint_spring", log_evidence), (rival,))
    now = as_estimated(model([before], CERTAIN), before, before.own.candidate, NARROW)
    of_both = bayes_factor(np.array(CERTAIN), STD**2 * np.eye(2), np.array([SCALE, SCALE]))
    assert 1.0 < of_both < 100.0
    assert now.own.log_evidence == pytest.approx(of_both if less else log_evidence)
    assert now.own.log_evidence - now.rivals[0].log_evidence == pytest.approx(4.0)
