"""The search: what is concealed and nothing else, and terms that are swapped and dropped beside all others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from likelihood.fits import URDF, at_joint, candidate, carried, fitted, with_friction
from simulated import Motion, inverse_dynamics

from torchrbd.diagnosis import search
from torchrbd.diagnosis.curve_hypotheses import is_curve
from torchrbd.diagnosis.discrepancy import learn_discrepancy
from torchrbd.diagnosis.hypotheses import Hypothesis, hypothesis_of
from torchrbd.diagnosis.outcome import SearchOutcome
from torchrbd.diagnosis.posterior import log_odds
from torchrbd.diagnosis.screening import screen
from torchrbd.diagnosis.search import Search, search_effects
from torchrbd.diagnosis.sharpening import best_shape
from torchrbd.effects import Site, effect

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
LATE_S = 0.03
PULL_SIZE, PULLS_S = 0.8, (6.2, 9.1)
PULL = at_joint(0, lambda m: PULL_SIZE * ((m.t >= PULLS_S[0]) & (m.t < PULLS_S[1])))


def searched(torque: Any, names: Sequence[str] = EFFECTS) -> tuple[SearchOutcome, list[tuple[float, int]]]:
    told: list[tuple[float, int]] = []
    return search_effects(fitted(torque), [effect(name) for name in names], lambda *said: told.append(said)), told


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
    # Each term is a step where it is added, and one where it is judged.
    assert len(told) >= 2 * len(names)
    parts = [part for part, _ in told]
    assert parts == sorted(set(parts))
    assert all(0.0 < part < 1.0 for part in parts)
    assert max((terms for _, terms in told), default=0) >= len(names)
    for t in found.terms:
        assert t.own.log_evidence > 30
        assert max((t.own, *t.rivals), key=lambda h: log_odds(h, found.rows)) is t.own
    assert found.considered == len(found.first) > 10
    for hypotheses in (found.first, found.last):
        odds = [log_odds(h, found.rows) for h in hypotheses]
        assert odds == sorted(odds, reverse=True)
    # All hypotheses are compared at the end, but those that the model has.
    assert {h.name for h in found.last} == {h.name for h in found.first} - names
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


def test_what_a_model_has_is_not_added_to_it_again() -> None:
    """However small it is believed to be: a second one of the same time would stand for a larger first one."""
    fit = fitted(PULL)
    rows = carried(fit)
    search = Search(rows, [effect("torque_offset")], learn_discrepancy(fit))
    first = next(h for h in search.rank([]) if h.candidate.site.window is not None)
    small = replace(first, scale=1e-3 * first.scale)
    assert first.candidate not in [h.candidate for h in search.rank([small])]


def test_rivals_of_what_acts_for_a_time_are_at_its_place() -> None:
    """At its joint or on the whole robot; what lasts has rivals that last, at its joint."""
    fit = fitted(PULL)
    rows = carried(fit)
    effects = [effect(name) for name in ("torque_offset", "payload", "joint_spring", "quadratic_drag")]
    search = Search(rows, effects, learn_discrepancy(fit))
    ranked = search.rank([])
    brief = next(h for h in ranked if h.candidate.site.window is not None and h.candidate.place is not None)
    places = {h.candidate.place for h in search.rivals([], brief)}
    assert places
    assert places <= {None, brief.candidate.place}
    lasting = next(h for h in ranked if h.candidate.effect.id == "joint_spring")
    rivals = [h.candidate for h in search.rivals([], lasting)]
    assert rivals
    assert {c.place for c in rivals} == {lasting.candidate.place}
    assert all(c.site.window is None for c in rivals)


def test_a_joint_has_one_shape_of_friction_and_one_modulator() -> None:
    fit = fitted(at_joint(0, lambda m: 0.8 * np.tanh(m.qd[:, 0] / 0.05) * np.abs(m.qd[:, 0])))
    rows = carried(fit)
    names = (
        "quadratic_drag",
        "stribeck_friction",
        "load_dependent_friction",
        "position_dependent_friction",
        "joint_spring",
    )
    search = Search(rows, [effect(name) for name in names], learn_discrepancy(fit))
    drag = hypothesis_of(fit, rows, candidate(rows, "quadratic_drag", Site(0)))
    assert drag is not None
    offered = {h.name for h in search.rank([drag])}
    assert ("stribeck_friction", Site(0)) not in offered
    assert {("stribeck_friction", Site(1)), ("load_dependent_friction", Site(0)), ("joint_spring", Site(0))} <= offered
    load = hypothesis_of(fit, rows, candidate(rows, "load_dependent_friction", Site(0)))
    assert load is not None
    assert ("position_dependent_friction", Site(0)) not in {h.name for h in search.rank([drag, load])}
    assert "stribeck_friction" in {h.name[0] for h in search.rivals([load], drag)}, "shapes compete for the place"


def test_refining_a_shape_leads_from_one_kind_to_another() -> None:
    """A bump where friction has a range with edges: no other bump is likelier than the range."""
    fit = fitted(at_joint(0, lambda m: 2.0 * (np.abs(m.q[:, 0] - 0.3) < 0.6) * np.tanh(m.qd[:, 0] / 0.01)))
    rows = carried(fit)
    bump = candidate(rows, "position_dependent_friction", Site(0), centre=0.2, width=0.7, profile=0.0)
    start = hypothesis_of(fit, rows, bump)
    assert start is not None
    found = best_shape(fit, rows, start)
    assert found.log_evidence > start.log_evidence + 10.0
    shape = found.candidate.shape
    assert shape["profile"] == 1.0
    assert (shape["centre"], shape["width"]) == pytest.approx((0.3, 0.6), abs=0.1)


def test_each_kind_of_a_shape_is_refined_before_they_are_compared() -> None:
    """Friction has a range with edges: the likeliest bump of the grid leads there, though no range is near it."""
    fit = fitted(at_joint(0, lambda m: 2.0 * (np.abs(m.q[:, 0] - 0.13) < 0.25) * np.tanh(m.qd[:, 0] / 0.05)))
    found = learn_discrepancy(fit)
    e, columns = effect("position_dependent_friction"), found.rows.columns

    def at(shape: Mapping[str, float]) -> Hypothesis:
        one = hypothesis_of(found.fit, found.rows, columns.candidate(e, Site(0), shape))
        assert one is not None
        return one

    grid = [at(shape) for shape in e.shapes(columns.scales[0])]
    bump = max((h for h in grid if h.candidate.shape["profile"] == 0.0), key=lambda h: h.log_evidence)
    assert at({**bump.candidate.shape, "profile": 1.0}).log_evidence < bump.log_evidence
    shape = best_shape(found.fit, found.rows, bump).candidate.shape
    assert shape["profile"] == 1.0
    assert (shape["centre"], shape["width"]) == pytest.approx((0.13, 0.25), abs=0.01)


def turned(m: Motion) -> np.ndarray:
    """Return what an encoder offset of the first joint adds, by Pinocchio."""
    return inverse_dynamics(URDF, replace(m, q=m.q - np.array([0.18, 0.0]))) - inverse_dynamics(URDF, m)


def test_two_hypotheses_are_compared_each_in_its_own_model() -> None:
    """An offset of the first joint, and a turned second one: evidence given other bodies than their own is no judge."""
    fit = fitted(turned)
    found, effects = learn_discrepancy(fit), [effect("encoder_offset"), effect("geometry_error")]
    search, places = Search(found.rows, effects, found), dict(zip(effects, (Site(0), Site(1)), strict=True))
    ranked = (h for h in screen(fit, found.rows, effects) if places[h.candidate.effect] == h.candidate.site)
    judged = (search.evidence([], best_shape(fit, found.rows, h))[0] for h in ranked)
    better, worse = sorted(judged, key=lambda h: -search.total([h]) - search.odds(h) + h.log_evidence)
    wrong = replace(worse, log_evidence=better.log_evidence + 50.0)
    assert search.odds(wrong) > search.odds(better)
    assert search.choose([], better, wrong) is better
    assert search.choose([], wrong, better) is better


def test_a_search_knows_that_drives_are_alike() -> None:
    """A rotor at the second joint is judged, and ranked, as one more where the first joint has one."""
    fit = fitted(at_joint(0, lambda m: 0.3 * m.qdd[:, 0]))
    rows = carried(fit)
    search = Search(rows, [effect("rotor_inertia"), effect("joint_spring")], learn_discrepancy(fit))
    first, second = (hypothesis_of(fit, rows, candidate(rows, "rotor_inertia", Site(j))) for j in (0, 1))
    assert first is not None
    assert second is not None
    assert [search.judge(chosen, [second])[0].elsewhere for chosen in ([], [first])] == [0, 1]
    ranked = {h.name[0]: h.elsewhere for h in search.rank([first]) if h.candidate.place == 1}
    assert ranked["rotor_inertia"] == 1
    assert ranked["joint_spring"] == 0


@pytest.mark.parametrize(("settles_s", "possible"), [(1.0, False), (5.0, True)])
def test_a_shape_that_physics_does_not_allow_has_no_evidence(settles_s: float, possible: bool) -> None:
    """Between two values of the grid a search tries shapes beyond its end, too."""
    fit = fitted(at_joint(0, lambda m: 0.8 * np.exp(-m.t / settles_s) * np.tanh(m.qd[:, 0] / 0.05)))
    rows = carried(fit)
    one = hypothesis_of(fit, rows, candidate(rows, "time_varying_friction", Site(0), time_constant=settles_s))
    assert one is not None
    (judged,) = Search(rows, [effect("time_varying_friction")], learn_discrepancy(fit)).evidence([], one)
    assert np.isfinite(judged.log_evidence) == possible


def late_torque(m: Motion) -> np.ndarray:
    """Return what a first joint's torque, friction included, lacks where it comes late."""
    torque = (inverse_dynamics(URDF, m) + with_friction()(m))[:, 0]
    return np.interp(m.t - LATE_S, m.t, torque) - torque


def test_delayed_friction_is_no_other_law() -> None:
    """Without the delay friction seems to change its sign over a wide range of speeds; so its width is learnt again."""
    found, _ = searched(at_joint(0, late_torque), ("time_delay", "presliding_hysteresis", "torque_scale"))
    (term,) = found.terms
    assert term.own.name == ("time_delay", Site(0))
    assert found.fit.hyper.rest_width[0] < 0.8 * found.base.hyper.rest_width[0]
