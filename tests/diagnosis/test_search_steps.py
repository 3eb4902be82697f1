"""Steps of a search, of stubs: names, and what they are worth beside each other."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from likelihood.fits import candidate, carried, fitted

from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis import search
from torchrbd.diagnosis.explain import likeliest_left
from torchrbd.diagnosis.hypotheses import Hypothesis
from torchrbd.diagnosis.results import NextEffect
from torchrbd.diagnosis.search import MOST_TERMS
from torchrbd.diagnosis.terms import Explanation, Term
from torchrbd.effects import Site, Window
from torchrbd.likelihood.likelihood import Likelihood

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
    rows: Rows,
    monkeypatch: pytest.MonkeyPatch,
    worth: Any,
    chosen: str,
    seen: Sequence[str],
    curve: str = "",
    report: Callable[[float], None] = lambda _: None,
) -> tuple[frozenset[str], tuple[Term, ...]]:
    """Return the model and terms of a search in which ``worth(name, beside)`` is the evidence."""

    def again(fit: Any, rows: Rows, h: Hypothesis) -> Hypothesis | None:
        evidence = worth(letter(h), fit)
        return None if evidence is None else replace(h, log_evidence=evidence)

    monkeypatch.setattr(search, "again", again)
    monkeypatch.setattr(search, "curves_at", lambda fit, *_: [made(c) for c in curve if c not in fit])
    for learnt in ("quick_evidence", "with_own_noise"):
        monkeypatch.setattr(search, learnt, lambda fit, rows, h: h)

    def made(name: str) -> Hypothesis:
        shape = {"low": -1.0, "high": 1.0} if name == "S" else {}
        c = candidate(rows, *SITES[name], **shape)
        return Hypothesis(c, 99.0, np.zeros(len(c.labels)), np.ones(len(c.labels)), 1.0, 1)

    at = Table(rows, (), report)
    none = cast(Any, frozenset())
    fit, terms, _ = at.swap_and_drop(
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


def test_a_sweep_is_half_of_what_is_left_in_equal_steps(rows: Rows, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[float] = []
    settled(rows, monkeypatch, lambda *_: 40.0, "ACEF", [""] * 4, report=told.append)
    np.testing.assert_allclose(told, np.arange(1, 5) / 8)


def test_progress_never_falls_where_terms_are_dropped(rows: Rows, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[float] = []
    settled(rows, monkeypatch, lambda name, _: {"A": -5.0}.get(name, 40.0), "FCA", [""] * 3, report=told.append)
    # All are judged, and what meets the dropped one a second time.
    assert len(told) == 4
    assert told == sorted(set(told))
    assert told[-1] < 1.0


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

    monkeypatch.setattr(search, "quick_evidence", lambda fit, rows, h: replace(h, log_evidence=first[letter(h)]))
    monkeypatch.setattr(search, "with_own_noise", with_own_noise)
    found = [Hypothesis(candidate(rows, *SITES[name]), 99.0, np.zeros(2), np.ones(2), 1.0, 1) for name in first]
    judged = Table(rows, (), lambda _: None).judged(cast(Any, frozenset()), found)
    assert learnt == ["A", "B"]
    assert [h.log_evidence for h in judged] == [640.0, 645.0, 1.0, 45.0]


def test_what_hides_at_a_glance_is_learnt_with_what_leads(rows: Rows, monkeypatch: pytest.MonkeyPatch) -> None:
    """A law that leads beside independent rows may seem to be nothing beside the noise that it has coloured."""
    glance, then = {"A": 28.0, "C": -3.0, "D": -2.0}, {"A": 13.0, "C": 57.0, "D": 99.0}
    monkeypatch.setattr(search, "quick_evidence", lambda fit, rows, h: replace(h, log_evidence=glance[letter(h)]))
    monkeypatch.setattr(search, "with_own_noise", lambda fit, rows, h: replace(h, log_evidence=then[letter(h)]))
    found = [Hypothesis(candidate(rows, *SITES[name]), 99.0, np.zeros(2), np.ones(2), 1.0, 1) for name in glance]
    judged = Table(rows, (), lambda _: None).judged(cast(Any, frozenset()), found, found[1:2])
    assert [h.log_evidence for h in judged] == [13.0, 57.0, -2.0]


def test_rivals_are_judged_at_their_best_shape(rows: Rows, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the shapes of a grid a law that is right would lose to a curve."""

    class Shaped(Table):
        def shaped(self, fit: Likelihood, h: Hypothesis) -> list[Hypothesis]:
            return [h, replace(h, log_evidence=h.log_evidence + 60.0)] if letter(h) == "B" else [h]

    monkeypatch.setattr(search, "quick_evidence", lambda fit, rows, h: h)
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
    for learnt in ("quick_evidence", "with_own_noise"):
        monkeypatch.setattr(search, learnt, lambda fit, rows, h: h)
    monkeypatch.setattr(Table, "with_terms", lambda self, base, chosen: [h.candidate for h in chosen])
    at = Table(rows, (), lambda _: None)
    fit, (term,), _ = at.swap_and_drop(cast(Any, []), cast(Any, [early.candidate]), [early], [[late]], [])
    assert term.own.candidate == late.candidate
    assert cast(Any, fit) == [late.candidate]


def test_what_is_not_needed_beside_what_was_added_last_is_dropped_one_after_the_other(rows: Rows, monkeypatch) -> None:
    """Beside both of them neither the first nor the second is needed; beside the last alone the first one is."""
    worth = {"ABC": (-3.0, -9.0, 99.0), "AC": (50.0, 99.0)}

    def model(letters: str) -> Any:
        return SimpleNamespace(name=letters, evidence_for=lambda k: worth[letters][k])

    chosen = [Hypothesis(candidate(rows, *SITES[c]), 99.0, np.zeros(1), np.ones(1), 1.0, 1) for c in "ABC"]
    monkeypatch.setattr(Table, "with_terms", lambda self, base, terms: model("".join(map(letter, terms))))
    at = Table(rows, (), lambda _: None)
    fit, left, seen = at.needed(cast(Any, None), model("ABC"), chosen, [[h] for h in chosen])
    assert cast(Any, fit).name == "".join(map(letter, left)) == "AC"
    assert [h for (h,) in seen] == left
    # The last one has just been weighed.
    worth["AC"] = (50.0, -99.0)
    assert at.needed(cast(Any, None), model("AC"), left, seen)[1] == left


def test_no_more_terms_are_added_than_a_person_would_read(rows: Rows, monkeypatch) -> None:
    c = candidate(rows, *SITES["A"])
    sure = Hypothesis(c, 99.0, np.zeros(2), np.ones(2), 1.0, 1)
    at = Table(rows, (), lambda _: None)
    monkeypatch.setattr(Table, "leading", lambda self, fit, chosen=(): [sure])
    monkeypatch.setattr(Likelihood, "evidence_for", lambda self, k: 99.0)
    _, chosen, seen, _ = at.added(fitted(), fitted(), [], [], [sure])
    assert len(chosen) == len(seen) == MOST_TERMS
    # What is left, and likelier than not, is told.
    chance = replace(sure, log_evidence=0.0)
    found = Explanation(fitted(), fitted(), rows, (), [], [sure, chance], 3)
    assert likeliest_left(found) == NextEffect(0, "joint_spring", (rows.columns.robot.joint_names[0],))
    for_a_time = candidate(rows, "payload", Site(body=1, window=Window("simulated", 1.0)))
    found = replace(found, last=[replace(sure, candidate=for_a_time)])
    body = rows.columns.robot.body_names[1]
    assert likeliest_left(found) == NextEffect(0, "payload", (), (body,), recording="simulated")
    for nothing in ([chance], []):
        assert likeliest_left(replace(found, last=nothing)) is None
