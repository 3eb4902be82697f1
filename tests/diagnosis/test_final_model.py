"""The model with what was found: curves that could pass for friction or inertia take nothing from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from likelihood.arms import recorded
from likelihood.fits import OPTIONS, URDF, at_joint, with_friction
from simulated import Motion, with_wrong_inertials

from torchrbd.diagnosis.curve_hypotheses import could_absorb_baseline, curves, has_friction, is_curve
from torchrbd.diagnosis.explain import _once
from torchrbd.diagnosis.final_model import FinalModel, fit_final_model
from torchrbd.diagnosis.ranking import run_search
from torchrbd.diagnosis.refitted_models import RefittedModels
from torchrbd.diagnosis.results import Elpd
from torchrbd.diagnosis.search import Term
from torchrbd.effects import Site, effect
from torchrbd.inference.ordinary import with_friction as friction_of
from torchrbd.inference.ordinary import with_machine
from torchrbd.inference.physical.fitting import judge
from torchrbd.inference.physical.terms import estimated_parameters
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.robot import RobotModel

WORTHLESS = Elpd(-1.0, 1.0, -1.0, 0.0, 0.0)
EVERY = ("smooth_torque_over_qd", "smooth_torque_over_load", "smooth_friction_over_load")
MAY = ("viscous_friction", "coulomb_friction")


def waves(m: Motion) -> np.ndarray:
    return 0.5 * np.cos(4.0 * m.qd[:, 0]) + 0.5 * np.sin(6.0 * m.q[:, 0])


def pushed(m: Motion) -> np.ndarray:
    return waves(m) + 0.3


def with_curves(
    wanted: Sequence[str] = ("smooth_torque_over_qd", "smooth_torque_over_q"),
    torque: Any = waves,
    may: tuple[str, ...] = MAY,
    **options: Any,
) -> FinalModel:
    """Return a model with a curve over the velocity and one over the position, whatever the evidence."""
    recording = recorded(URDF, 2, with_friction(at_joint(0, torque)), **{**OPTIONS, "duration_s": 30.0})
    settings = Settings.from_mapping({"effects": may, **options}, "test")
    prepared = prepare(RobotModel.from_urdf(with_wrong_inertials(URDF, 1, 0.1)), [recording], settings, ())
    ranked = run_search(prepared.reading, settings, prepared.kept_back, lambda *_: None)
    prepared = with_machine(prepared, settings, friction_of(settings), lambda *_: None, ranked.clocks)
    found = ranked.explanation
    own = {h.candidate.effect.id: h for h in curves(found.fit, found.rows) if h.candidate.site == Site(0)}
    terms = tuple(Term(own[name], ()) for name in wanted)
    fit = found.base.extended([own[name].extra(found.base, found.rows) for name in wanted]).refit
    return fit_final_model(prepared, replace(found, terms=terms, fit=fit), may, lambda *_: None)


@pytest.fixture(scope="module")
def model() -> FinalModel:
    return with_curves()


def late_columns(model: FinalModel) -> list[int]:
    return [k for c in model.terms if could_absorb_baseline(c) for k in model.model.columns.of(c)]


def test_a_curve_over_the_velocity_changes_nothing_else(model: FinalModel) -> None:
    assert [(is_curve(c), could_absorb_baseline(c)) for c in model.terms] == [(True, True), (True, False)]
    late = late_columns(model)
    rest = np.setdiff1d(np.arange(len(model.model.x)), late)
    torch.testing.assert_close(model.model.x[rest], model.first.x[rest], rtol=0, atol=0)
    assert (model.first.x[late] == 0).all()
    assert model.model.x[late].abs().max() > 0.1


def test_intervals_are_those_of_the_model_without_it(model: FinalModel) -> None:
    for f in model.first.proper_terms[: len(model.friction)]:
        for name, (value, std) in estimated_parameters(model.model, f).items():
            assert (value, std) == pytest.approx(estimated_parameters(model.first, f)[name], rel=1e-9)


def test_it_is_where_the_posterior_of_what_is_left_is_largest(model: FinalModel) -> None:
    """w = D^2 C'(tau - X x) / s^2, also where the motion never comes to a knot and D is zero."""
    late, training = late_columns(model), model.prepared.training
    pull = training.scores(model.model.x, 1.0 / model.model.noise_variance).sum(0)[late]
    pulled = model.prepared.prior.scale.diagonal()[late] ** 2 * pull
    torch.testing.assert_close(pulled, model.model.x[late], rtol=1e-6, atol=1e-8)


def test_friction_is_told_without_curves_that_could_stand_in_for_it() -> None:
    may = (*MAY, "asymmetric_coulomb_friction")
    found, alone = (with_curves(wanted, pushed, may).friction for wanted in (EVERY, ()))
    assert [f.candidate.effect.id for f in found] == [f.candidate.effect.id for f in alone]
    np.testing.assert_allclose([f.log_evidence for f in found], [f.log_evidence for f in alone], rtol=0.2, atol=1.0)


def test_states_may_be_uncertain() -> None:
    """What uncertain states take from the information is that of the columns as they are."""
    smoothed = with_curves(estimator="smoother", cutoff_hz=8.0)
    assert smoothed.prepared.states is not None
    assert smoothed.prepared.states.lost.shape == (smoothed.model.columns.n, smoothed.model.columns.n)
    fit = smoothed.prepared.fit(smoothed.first.terms)
    assert torch.isfinite(fit.x).all()


def test_a_model_without_a_law_is_the_fit_without_it_and_its_slopes() -> None:
    """Slopes of a law in its shape would stand in for a part of it."""
    resisting = at_joint(0, lambda m: 2.0 * np.sign(m.qd[:, 0]) * np.abs(m.qd[:, 0]) ** 1.5)
    recording = recorded(URDF, 2, with_friction(resisting), **{**OPTIONS, "duration_s": 30.0})
    settings = Settings.from_mapping({"effects": (*MAY, "power_law_friction")}, "test")
    prepared = prepare(RobotModel.from_urdf(with_wrong_inertials(URDF, 1, 0.1)), [recording], settings, ())
    ranked = run_search(prepared.reading, settings, prepared.kept_back, lambda *_: None)
    prepared = with_machine(prepared, settings, friction_of(settings), lambda *_: None, ranked.clocks)
    model = fit_final_model(prepared, ranked.explanation, MAY, lambda *_: None)
    (law,) = model.terms
    assert any(c not in model.first.proper_terms for c in model.first.terms), "the law has slopes"
    ordinary = model.first.proper_terms[: len(model.friction)]
    judging, without = model.prepared.judging, model.without({law: WORTHLESS})
    assert (without.terms, without.open, without.first.terms) == ((), (), ordinary)
    expected = judge(judging, model.prepared.fit(ordinary).x).nmse
    assert judge(judging, without.model.x).nmse == pytest.approx(expected, rel=1e-6)
    # At the noise of the whole model, which the other joint's torque is weighed against.
    assert RefittedModels(model).error_without([law])["joint1"] == pytest.approx(expected["joint1"], rel=0.02)
    assert expected["joint1"] > 10.0 * judge(judging, model.model.x).nmse["joint1"]


def test_friction_that_a_law_stands_in_for_is_sure_without_it() -> None:
    """A power law is nearly viscous friction: beside it there may be none."""
    recording = recorded(URDF, 2, with_friction(), **{**OPTIONS, "duration_s": 30.0})
    settings = Settings.from_mapping({"effects": (*MAY, "power_law_friction")}, "test")
    prepared = prepare(RobotModel.from_urdf(with_wrong_inertials(URDF, 1, 0.1)), [recording], settings, ())
    ranked = run_search(prepared.reading, settings, prepared.kept_back, lambda *_: None)
    prepared = with_machine(prepared, settings, friction_of(settings), lambda *_: None, ranked.clocks)
    plain = ranked.explanation
    assert plain.terms == ()
    (law,) = (h for h in plain.first if h.name == ("power_law_friction", Site(0)))
    with_law = replace(
        plain, terms=(Term(law, ()),), fit=plain.base.extended([law.extra(plain.base, plain.rows)]).refit
    )
    never, model = (fit_final_model(prepared, found, MAY, lambda *_: None) for found in (plain, with_law))
    again = model.without(dict.fromkeys(model.terms, WORTHLESS))
    assert [f.candidate for f in again.friction] == [f.candidate for f in model.friction]
    viscous = [one.friction[0] for one in (never, again, model)]
    assert {(f.candidate.effect.id, f.candidate.joint) for f in viscous} == {("viscous_friction", 0)}
    assert viscous[1].log_evidence == pytest.approx(viscous[0].log_evidence, rel=0.05)
    assert viscous[2].log_evidence < 0.5 * viscous[0].log_evidence


def test_a_torque_is_told_once(model: FinalModel) -> None:
    """The level that friction falls to is Coulomb friction; whoever adds both up has it twice."""
    columns, fading = model.model.columns, effect("time_varying_friction")
    laws = [columns.candidate(fading, Site(0), shape) for shape in fading.shapes(columns.scales[0])[:1]]
    wider = columns.of_candidates((*columns.candidates, *laws), columns.pi, columns.friction)
    friction = [c for c in model.first.proper_terms if c.effect.id in MAY]
    sure, doubtful = SimpleNamespace(probability=0.99), SimpleNamespace(probability=0.7)
    told: Any = [(c, sure) for c in (*friction, *laws)]
    left = {(c.effect.id, c.joint) for c, _ in _once(told, wider)}
    everything = {(c.effect.id, c.joint) for c, _ in told}
    assert everything - left == {("coulomb_friction", 0)}
    assert _once(told[: len(friction)], wider) == told[: len(friction)]
    # What is certain does not go with a law that is not.
    guess = [*told[: len(friction)], (laws[0], doubtful)]
    assert _once(guess, wider) == guess  # type: ignore[arg-type]


def test_friction_is_missed_without_curves_of_which_it_may_be_a_part() -> None:
    """A curve of friction over the position has a constant part, and held-out time would not miss Coulomb friction."""
    model = with_curves(("smooth_friction_over_q", "smooth_torque_over_q"))
    fits = RefittedModels(model)
    coulomb = [f.candidate for f in model.friction if f.candidate.effect.id == "coulomb_friction"]
    assert len(coulomb) == 2
    for gone in ([], *([c] for c in coulomb)):
        assert [c.effect.id for c in fits.without(gone).proper_terms if is_curve(c)] == ["smooth_torque_over_q"]
    assert [c.effect.id for c in model.model.proper_terms if has_friction(c)] == ["smooth_friction_over_q"]
