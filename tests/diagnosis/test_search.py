"""The search: what is concealed and nothing else, and terms that are swapped and dropped beside all others."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from likelihood.fits import at_joint, candidate, carried, fitted

from torchrbd.diagnosis import search
from torchrbd.diagnosis.explain import likeliest_left
from torchrbd.diagnosis.hypotheses import Hypothesis
from torchrbd.diagnosis.posterior import log_odds
from torchrbd.diagnosis.residual import is_curve, stands_in
from torchrbd.diagnosis.search import MOST_TERMS, Explanation, Term, _Search, explained
from torchrbd.effects import Site, Window, effect
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.rows import Rows

EFFECTS = (
    "rotor_inertia",
    "joint_spring",
    "quadratic_drag",
    "stribeck_friction",
    "torque_ripple",
    "torque_scale",
    "joint_coupling",
    "base_tilt",
    "payload",
)
ROTOR = at_joint(1, lambda m: 0.05 * m.qdd[:, 1])
BOTH = at_joint(1, lambda m: 0.05 * m.qdd[:, 1] + 0.08 * np.sin(17.4 * m.q[:, 1] + 0.7))
BUMP = at_joint(0, lambda m: 1.5 * np.exp(-(((m.q[:, 0] - np.median(m.q[:, 0])) / 0.15) ** 2)))
PULL_SIZE, PULLS_S = 0.8, (6.2, 9.1)
PULL = at_joint(0, lambda m: PULL_SIZE * ((m.t >= PULLS_S[0]) & (m.t < PULLS_S[1])))


def searched(torque: Any, names: Sequence[str] = EFFECTS) -> tuple[Explanation, list[int]]:
    told: list[int] = []
    return explained(fitted(torque), [effect(name) for name in names], told.append), told


@pytest.mark.parametrize(
    ("torque", "names"),
    [
        (None, set()),
        (ROTOR, {("rotor_inertia", Site(1))}),
        (BOTH, {("rotor_inertia", Site(1)), ("torque_ripple", Site(1))}),
    ],
    ids=["nothing", "one", "two"],
)
def test_what_is_concealed_is_found_and_nothing_else(torque: Any, names: set[tuple[str, Site]]) -> None:
    found, told = searched(torque)
    assert {t.own.name for t in found.terms} == names
    assert len(found.terms) == len(found.fit.extra) == len(names)
    assert told == list(range(1, len(names) + 1))
    for t in found.terms:
        assert t.own.log_evidence > 30
        assert t.best(found.rows) is t.own
    assert found.considered == len(found.first) > 10
    for hypotheses in (found.first, found.last):
        odds = [log_odds(h, found.rows) for h in hypotheses]
        assert odds == sorted(odds, reverse=True)
    assert not names & {h.name for h in found.last}
    assert all(log_odds(h, found.rows) <= 0.0 for h in found.last)


def test_torque_of_one_joint_that_comes_and_goes_is_no_load() -> None:
    """A body could be made to weigh on one joint alone; an offset there has one number."""
    found, _ = searched(PULL, (*EFFECTS, "torque_offset", "external_wrench"))
    (term,) = found.terms
    assert term.own.name == ("torque_offset", Site(0))
    window = term.own.candidate.site.window
    assert window is not None
    assert (window.start_s, window.end_s) == pytest.approx(PULLS_S, abs=0.1)
    assert float(term.own.coefficients[0]) == pytest.approx(PULL_SIZE, rel=0.2)


def test_evidence_of_a_term_is_beside_all_others() -> None:
    """Beside the rotor the ripple has as much evidence as where no rotor is missing."""
    found, _ = searched(BOTH)
    alone, _ = searched(at_joint(1, lambda m: 0.08 * np.sin(17.4 * m.q[:, 1] + 0.7)))
    both, one = (next(t.own for t in e.terms if t.own.candidate.effect.id == "torque_ripple") for e in (found, alone))
    assert both.log_evidence == pytest.approx(one.log_evidence, rel=0.15)
    assert both.candidate.shape["order"] == pytest.approx(17.4, abs=0.1)


def test_torque_without_a_law_is_a_curve_where_it_acts() -> None:
    """No effect of the list is a bump, and of curves that of the joint's own position is it."""
    found, _ = searched(BUMP, ["quadratic_drag", "base_tilt"])
    curves = [t.own for t in found.terms if is_curve(t.own.candidate)]
    assert ("smooth_torque_over_q", Site(0)) in {h.name for h in curves}
    assert {h.candidate.site.joint for h in curves} == {0}
    assert max(h.log_evidence for h in curves) > 30


def test_of_curves_that_could_pass_for_friction_a_joint_has_one() -> None:
    """Two of them may be large and their sum small."""
    fit = fitted(BUMP)
    search = _Search(carried(fit), [], lambda _: None)
    every = search.offered(fit, [])
    kinds = {h.candidate.effect.id for h in every if stands_in(h.candidate) and h.candidate.joint == 0}
    assert len(kinds) == 4
    one = next(h for h in every if stands_in(h.candidate) and h.candidate.joint == 0)
    left = search.offered(fit, [one])
    assert not [h for h in left if stands_in(h.candidate) and h.candidate.joint == 0]
    assert len(left) == len(every) - len(kinds)


def test_torque_without_a_law_is_not_given_one_that_is_somewhat_like_it() -> None:
    found, _ = searched(BUMP, ["torque_ripple", "joint_spring", "quadratic_drag"])
    assert {t.own.name for t in found.terms} == {("smooth_torque_over_q", Site(0))}


def test_a_curve_takes_what_a_law_lacks_and_not_its_place() -> None:
    """A curve over the acceleration could be all of a rotor's torque, and of what else depends on it."""

    def torque(m: Any) -> Any:
        qdd = m.qdd[:, 1]
        return 0.05 * qdd + 0.15 * np.exp(-(((qdd - np.quantile(qdd, 0.8)) / (0.2 * qdd.std())) ** 2))

    found, _ = searched(at_joint(1, torque), ["rotor_inertia", "quadratic_drag"])
    assert {t.own.name for t in found.terms} == {("rotor_inertia", Site(1)), ("smooth_torque_over_qdd", Site(1))}


def test_nothing_may_be_there_and_nothing_is() -> None:
    found, told = searched(None, ())
    assert (found.terms, found.first, found.considered, told) == ((), [], 0, [])


def test_signals_that_no_curve_can_be_drawn_over_have_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """A joint may stand still in all recordings."""
    monkeypatch.setattr(search, "curves", lambda fit, rows: [])
    found, _ = searched(None, ["quadratic_drag"])
    assert found.terms == ()
    assert {h.candidate.effect.id for h in found.last} == {"quadratic_drag"}


def test_laws_come_before_curves_that_are_no_likelier() -> None:
    """A spring is a curve over the position as well."""
    spring = at_joint(0, lambda m: 2.0 * m.q[:, 0])
    found, _ = searched(spring, ["joint_spring", "quadratic_drag"])
    (term,) = found.terms
    assert term.own.name == ("joint_spring", Site(0))
    assert term.own.coefficients[0] == pytest.approx(2.0, abs=4 * term.own.std[0])


# What is below is of stubs: names and what they are worth beside each other.
SITES = {
    "A": ("joint_spring", Site(0)),
    "B": ("rotor_inertia", Site(0)),
    "C": ("joint_spring", Site(1)),
    "D": ("rotor_inertia", Site(1)),
    "E": ("quadratic_drag", Site(1)),
    "F": ("quadratic_drag", Site(0)),
    "S": ("smooth_torque_over_q", Site(0)),
}
LETTERS = {place: letter for letter, place in SITES.items()}


def letter(h: Hypothesis) -> str:
    return LETTERS[h.name]


class Table(search._Search):
    """A search whose models are the names of what is in them."""

    def with_terms(self, base: Likelihood, chosen: Sequence[Hypothesis]) -> Likelihood:
        return cast(Any, frozenset(map(letter, chosen)))

    def leading(self, fit: Likelihood, chosen: Sequence[Hypothesis] = ()) -> list[Hypothesis]:
        return []

    def side_by_side(self, fit: Likelihood, now: list[Hypothesis], done: Collection[int]) -> list[Hypothesis]:
        return now

    def shaped(self, fit: Likelihood, h: Hypothesis) -> list[Hypothesis]:
        return [h]


@pytest.fixture(scope="module")
def rows() -> Rows:
    return carried(fitted())


def settled(
    rows: Rows, monkeypatch: pytest.MonkeyPatch, worth: Any, chosen: str, seen: Sequence[str], curve: str = ""
) -> tuple[frozenset[str], tuple[Term, ...]]:
    """Return the model and terms of a search in which ``worth(name, beside)`` is the evidence."""

    def again(fit: Any, rows: Rows, h: Hypothesis) -> Hypothesis | None:
        evidence = worth(letter(h), fit)
        return None if evidence is None else replace(h, log_evidence=evidence)

    monkeypatch.setattr(search, "again", again)
    monkeypatch.setattr(search, "curves_at", lambda fit, *_: [made(c) for c in curve if c not in fit])
    for learnt in ("at_a_glance", "with_own_noise"):
        monkeypatch.setattr(search, learnt, lambda fit, rows, h: h)

    def made(name: str) -> Hypothesis:
        shape = {"low": -1.0, "high": 1.0} if name == "S" else {}
        c = candidate(rows, *SITES[name], **shape)
        return Hypothesis(c, 99.0, np.zeros(len(c.labels)), np.ones(len(c.labels)), 1.0, 1)

    at = Table(rows, (), lambda _: None)
    none = cast(Any, frozenset())
    fit, terms, _ = at.settled(
        none,
        cast(Any, frozenset(chosen)),
        [made(c) for c in chosen],
        [[made(s) for s in others] for others in seen],
        [],
    )
    return cast(Any, fit), terms


def names(terms: Sequence[Term]) -> str:
    return "".join(letter(t.own) for t in terms)


def test_a_term_that_is_worse_than_a_rival_beside_all_others_is_replaced(rows: Rows, monkeypatch) -> None:
    def worth(name: str, beside: frozenset[str]) -> float:
        if name == "A":
            return 10.0 if "C" in beside else 50.0
        return 40.0

    fit, terms = settled(rows, monkeypatch, worth, "AC", ["B", "D"])
    assert fit == {"B", "C"}
    assert names(terms) == "BC"
    assert [letter(h) for h in terms[0].rivals] == ["A"]
    assert (terms[0].own.log_evidence, terms[0].rivals[0].log_evidence) == (40.0, 10.0)


@pytest.mark.parametrize(("beside_it", "stands"), [(30.0, "AS"), (-5.0, "S")], ids=["needed", "not needed"])
def test_a_curve_takes_the_place_of_a_law_that_is_not_needed_beside_it(
    rows: Rows, monkeypatch: pytest.MonkeyPatch, beside_it: float, stands: str
) -> None:
    def worth(name: str, beside: frozenset[str]) -> float:
        if name == "A":
            return beside_it if "S" in beside else 40.0
        return 60.0

    fit, terms = settled(rows, monkeypatch, worth, "A", [""], curve="S")
    assert names(terms) == stands
    assert fit == set(stands)


def test_a_term_that_nothing_asks_for_beside_all_others_is_dropped(rows: Rows, monkeypatch) -> None:
    fit, terms = settled(
        rows, monkeypatch, lambda name, beside: {"A": -5.0, "B": -9.0}.get(name, 40.0), "ACE", ["B", "", "F"]
    )
    assert fit == {"C", "E"}
    assert names(terms) == "CE"


def test_what_is_likeliest_beside_all_others_stays(rows: Rows, monkeypatch) -> None:
    """As do rivals that cannot be told beside others, by not being there."""
    fit, terms = settled(
        rows, monkeypatch, lambda name, beside: {"B": 30.0, "D": None}.get(name, 40.0), "AC", ["B", "D"]
    )
    assert fit == {"A", "C"}
    assert [[letter(h) for h in t.rivals] for t in terms] == [["B"], []]


def test_of_two_that_stand_for_each_other_one_stays(rows: Rows, monkeypatch) -> None:
    """Each is worth nothing beside the other, and much without it: both must not be dropped at once."""

    def worth(name: str, beside: frozenset[str]) -> float:
        return -3.0 if {"A": "B", "B": "A"}.get(name) in beside else 40.0

    fit, terms = settled(rows, monkeypatch, worth, "ABC", ["", "", ""])
    assert len(fit & {"A", "B"}) == 1
    assert set(names(terms)) == fit


@pytest.mark.parametrize("chosen", ["AC", "ACE", "ABCD", "ABCDEF"])
def test_terms_are_those_of_the_model_however_many_are_dropped(rows: Rows, monkeypatch, chosen: str) -> None:
    fit, terms = settled(
        rows, monkeypatch, lambda name, beside: 40.0 if name == "C" else -5.0, chosen, [""] * len(chosen)
    )
    assert fit == {"C"}
    assert names(terms) == "C"


def test_terms_that_are_swapped_for_ever_are_those_of_the_model(rows: Rows, monkeypatch) -> None:
    """A wins beside D, B beside C, C beside A, D beside B."""
    wins = {"A": "D", "B": "C", "C": "A", "D": "B"}
    fit, terms = settled(
        rows, monkeypatch, lambda name, beside: 40.0 if wins[name] in beside else 20.0, "AC", ["B", "D"]
    )
    assert set(names(terms)) == fit
    assert len(fit) == 2


def test_a_term_is_judged_again_where_others_on_its_torque_have_changed(rows: Rows, monkeypatch) -> None:
    """B takes the place of A at the first joint, where F is; C is at the second."""
    asked: list[str] = []

    def worth(name: str, beside: frozenset[str]) -> float:
        asked.append(name)
        return {"A": 30.0, "B": 50.0}.get(name, 40.0)

    fit, terms = settled(rows, monkeypatch, worth, "CFA", ["", "", "B"])
    assert fit == {"B", "C", "F"}
    assert names(terms) == "CFB"
    assert (asked.count("C"), asked.count("F"), asked.count("B")) == (1, 2, 2)


def test_rivals_of_what_leads_are_learnt_anew_as_it_is(rows: Rows, monkeypatch: pytest.MonkeyPatch) -> None:
    """However far below it they are at a glance; not what is no likelier than not, nor what acts elsewhere."""
    first, then, learnt = {"A": 60.0, "B": 12.0, "F": 1.0, "C": 45.0}, {"A": 640.0, "B": 645.0}, []

    def with_own_noise(fit: Any, rows: Rows, h: Hypothesis) -> Hypothesis:
        learnt.append(letter(h))
        return replace(h, log_evidence=then[letter(h)])

    monkeypatch.setattr(search, "at_a_glance", lambda fit, rows, h: replace(h, log_evidence=first[letter(h)]))
    monkeypatch.setattr(search, "with_own_noise", with_own_noise)
    found = [Hypothesis(candidate(rows, *SITES[name]), 99.0, np.zeros(2), np.ones(2), 1.0, 1) for name in first]
    judged = Table(rows, (), lambda _: None).judged(cast(Any, frozenset()), found)
    assert learnt == ["A", "B"]
    assert [h.log_evidence for h in judged] == [640.0, 645.0, 1.0, 45.0]


def test_rivals_are_judged_at_their_best_shape(rows: Rows, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the shapes of a grid a law that is right would lose to a curve."""

    class Shaped(Table):
        def shaped(self, fit: Likelihood, h: Hypothesis) -> list[Hypothesis]:
            return [h, replace(h, log_evidence=h.log_evidence + 60.0)] if letter(h) == "B" else [h]

    monkeypatch.setattr(search, "at_a_glance", lambda fit, rows, h: h)
    monkeypatch.setattr(search, "with_own_noise", lambda fit, rows, h: h)
    worth = {"A": 76.0, "B": 47.0}
    found = [Hypothesis(candidate(rows, *SITES[name]), w, np.zeros(2), np.ones(2), 1.0, 1) for name, w in worth.items()]
    judged = Shaped(rows, (), lambda _: None).judged(cast(Any, frozenset()), found)
    assert [h.log_evidence for h in judged] == [76.0, 107.0]


def test_rivals_are_weighed_by_the_noise_that_is_learnt_with_the_likeliest(rows: Rows, monkeypatch) -> None:
    """Each with its own noise says little of which is right, where both are worth hundreds of nats."""
    beside = {"A": {"A": 400.0, "B": 410.0}, "B": {"A": 370.0, "B": 390.0}}

    class Learnt:
        def __init__(self, name: str) -> None:
            self.name = name

        def extended(self, extra: Any) -> str:
            return self.name

    fit = SimpleNamespace(extra=())
    monkeypatch.setattr(search, "learnt_with", lambda fit, rows, h: Learnt(letter(h)))
    monkeypatch.setattr(
        search, "again", lambda fit, rows, h: replace(h, log_evidence=beside[fit].get(letter(h), np.nan))
    )
    worth = {"A": 405.0, "B": 398.0, "C": 30.0}
    found = [Hypothesis(candidate(rows, *SITES[name]), w, np.zeros(2), np.ones(2), 1.0, 1) for name, w in worth.items()]
    at = search._Search(rows, (), lambda _: None)
    judged = at.side_by_side(cast(Any, fit), found, {0, 1, 2})
    # Beside the noise of A, B is 10 nats better; beside that of B, A is 20 worse.
    assert [h.log_evidence for h in judged] == [395.0, 415.0, 30.0]


def test_a_term_that_is_swapped_for_another_time_is_that_of_the_model(rows: Rows, monkeypatch) -> None:
    """A load from 2 s on in the place of one from 1 s on: effect and link are the same, the model is not."""
    early, late = (
        Hypothesis(
            candidate(rows, "payload", Site(body=1, window=Window("simulated", start))),
            99.0,
            np.zeros(10),
            np.ones(10),
            1.0,
            1,
        )
        for start in (1.0, 2.0)
    )

    def again(fit: Any, rows: Rows, h: Hypothesis) -> Hypothesis:
        return replace(h, log_evidence=30.0 if h.candidate == early.candidate else 60.0)

    monkeypatch.setattr(search, "again", again)
    monkeypatch.setattr(search, "curves_at", lambda *_: [])
    for learnt in ("at_a_glance", "with_own_noise"):
        monkeypatch.setattr(search, learnt, lambda fit, rows, h: h)
    monkeypatch.setattr(Table, "with_terms", lambda self, base, chosen: [h.candidate for h in chosen])
    at = Table(rows, (), lambda _: None)
    fit, (term,), _ = at.settled(cast(Any, []), cast(Any, [early.candidate]), [early], [[late]], [])
    assert term.own.candidate == late.candidate
    assert cast(Any, fit) == [late.candidate]


def test_no_more_terms_are_added_than_a_person_would_read(rows: Rows, monkeypatch) -> None:
    c = candidate(rows, *SITES["A"])
    sure = Hypothesis(c, 99.0, np.zeros(2), np.ones(2), 1.0, 1)
    at = Table(rows, (), lambda _: None)
    monkeypatch.setattr(Table, "leading", lambda self, fit, chosen=(): [sure])
    _, chosen, seen, _ = at.added(fitted(), fitted(), [], [], [sure])
    assert len(chosen) == len(seen) == MOST_TERMS
    # What is left, and likelier than not, is told.
    chance = replace(sure, log_evidence=0.0)
    found = Explanation(fitted(), fitted(), rows, (), [], [sure, chance], 3)
    assert likeliest_left(found) == f"joint spring at {rows.columns.robot.joint_names[0]}"
    for_a_time = candidate(rows, "payload", Site(body=1, window=Window("simulated", 1.0)))
    found = replace(found, last=[replace(sure, candidate=for_a_time)])
    assert likeliest_left(found) == f"payload on {rows.columns.robot.body_names[1]} for a time in simulated"
    for nothing in ([chance], []):
        assert likeliest_left(replace(found, last=nothing)) == ""
