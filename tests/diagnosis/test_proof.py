"""A term is proven by blocks of the fitted time that its fit has not seen, and by being worth a name."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from diagnosis.test_own_time import searched, told
from diagnosis.test_unexplained import FIRST, MAY, diagnosed, quiet
from likelihood.arms import recorded
from likelihood.fits import BEGIN_S, OPTIONS, URDF, at_joint, payload, with_friction
from scipy.integrate import quad
from scipy.stats import norm
from simulated import Motion, inverse_dynamics, joint_names, multisine, with_wrong_inertials

import torchrbd
from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.explain import _is_needed, explain, torque_rms
from torchrbd.diagnosis.final_model import FinalModel, fit_final_model
from torchrbd.diagnosis.outcome import Term
from torchrbd.diagnosis.proof import Proof, backward_elimination, elpd_of, elpd_of_rows
from torchrbd.diagnosis.ranking import run_search
from torchrbd.diagnosis.refitted_models import acts_in
from torchrbd.diagnosis.results import Elpd, Finding
from torchrbd.effects import Site, Window
from torchrbd.inference.ordinary import with_friction as friction_of
from torchrbd.inference.ordinary import with_machine
from torchrbd.inference.physical.fitting import fit_model, judge
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

pytestmark = pytest.mark.usefixtures("fit_alone")

DRAG, POWER = "quadratic_drag", "power_law_friction"


def dragged(m: Motion) -> np.ndarray:
    return 2.0 * m.qd[:, 0] * np.abs(m.qd[:, 0])


def with_laws(laws: Sequence[str], torque: Callable | None, also: Sequence[str] = (), **options: float) -> FinalModel:
    """Return a model with laws at the first joint, whatever the evidence; ``also`` may be there too."""
    recording = recorded(URDF, 2, torque, **{**OPTIONS, "duration_s": 30.0, **options})
    may = ("viscous_friction", "coulomb_friction", *also, *laws)
    settings = Settings.from_mapping({"effects": may}, "test")
    prepared = prepare(RobotModel.from_urdf(with_wrong_inertials(URDF, 1, 0.1)), [recording], settings, ())
    ranked = run_search(prepared.reading, settings, prepared.kept_back, quiet)
    prepared = with_machine(prepared, settings, friction_of(settings), quiet, ranked.clocks)
    plain = replace(ranked.explanation, terms=(), fit=ranked.explanation.base)
    own = {h.name: h for h in plain.first}
    chosen = [own[law, Site(0)] for law in laws]
    fit = plain.base.extended([h.extra(plain.base, plain.rows) for h in chosen]).refit
    found = replace(plain, terms=tuple(Term(h, ()) for h in chosen), fit=fit)
    return fit_final_model(prepared, found, may, quiet)


def repeated(model: FinalModel, term: Candidate, folds: Sequence[Sequence[int]]) -> Elpd:
    """Return what a term is worth by fits that are repeated without each fold of fitted blocks."""
    prepared, blocks, noise = model.prepared, model.prepared.judging_fitted, model.model.noise_variance
    before, after, between = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for fold in folds:
        kept = torch.ones(len(blocks), dtype=torch.bool).index_fill(0, torch.tensor(fold), False)
        without, x = (
            fit_model(prepared.training.select(kept), prepared.prior, terms, noise, prepared.states).x
            for terms in ([c for c in model.first.terms if c != term], model.first.terms)
        )
        left_out = blocks.select(~kept)
        before.append(left_out.squared_error(without).numpy())
        after.append(left_out.squared_error(x).numpy())
        between.append(left_out.added(x, without)[1].numpy())
    inside = [b for fold in folds for b in fold]
    errors, samples = map(np.concatenate, (before, after, between)), blocks.torque[inside, :, 0].numpy()
    return elpd_of(*errors, samples, math.nan, term.place)


def assert_alike(one: Elpd, other: Elpd) -> None:
    assert one.value == pytest.approx(other.value, rel=0.01, abs=0.2 * other.se)
    assert one.se == pytest.approx(other.se, rel=0.05)
    assert one.log_evidence == pytest.approx(other.log_evidence, rel=0.05, abs=0.2)
    assert one.share == pytest.approx(other.share, abs=3e-3)


def before_price(one: Elpd, choices: int) -> Elpd:
    """Return the same without the price of a choice."""
    return replace(one, log_evidence=one.log_evidence + math.log(choices))


@pytest.fixture(scope="module")
def drag() -> FinalModel:
    return with_laws([DRAG], with_friction(at_joint(0, dragged)))


@pytest.fixture(scope="module")
def no_drag() -> FinalModel:
    return with_laws([DRAG], with_friction())


def test_elpd_by_hand() -> None:
    """Both joints leave s^2 = 0.5 with the term: gains are those of the squared errors."""
    before = np.array([[3.0, 2.0, 0.0], [5.0, 2.5, 0.0], [4.0, 1.5, 0.0]])
    after = np.array([[1.0, 2.0, 0.0], [2.0, 2.0, 0.0], [3.0, 2.0, 0.0]])
    samples, between = np.array([[4.0, 4.0, 0.0]] * 3), np.zeros((3, 3))
    se = float(np.std([2.0, 3.5, 0.5], ddof=1)) * 3**0.5
    for place, share in ((None, 0.5), (0, 0.5), (1, 0.0)):
        one = elpd_of(before, after, between, samples, 0.3, place)
        assert (one.value, one.se, one.share, one.torque_share) == pytest.approx((6.0, se, share, 0.3))
    assert elpd_of(before, before, between, samples, 0.3) == Elpd(0.0, 0.0, 0.0, 0.0, 0.3)
    assert elpd_of(after, before, between, samples, 0.3).value < 0.0


def of_residuals(without: np.ndarray, given: np.ndarray) -> Elpd:
    """Return what residuals (B, n_dof, M) of a model without a term, and with it, say for the term."""
    squares = ((x**2).sum(2) for x in (without, given, without - given))
    return elpd_of(*squares, np.full(without.shape[:2], without.shape[2]), 0.3)


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_log_evidence_is_that_of_projections_whose_noise_has_any_scale(there: bool, scale: float) -> None:
    """The integral of the likelihood over the scale, by quadrature; units of the torque do not matter."""
    rng = np.random.default_rng(0)
    noise, f = rng.standard_normal((7, 2, 30)), 0.4 * rng.standard_normal((7, 2, 30))
    given = scale * (noise if there else noise - f)
    without = given + scale * f
    variance = (given**2).mean((0, 2))[:, None]
    size = np.sqrt((f**2 / variance).sum((1, 2)))

    def density(e: np.ndarray) -> float:
        c = (f * e / variance).sum((1, 2)) / size
        return quad(lambda log_s: np.exp(norm.logpdf(c, scale=np.exp(log_s)).sum()), -8.0, 8.0, limit=400)[0]

    found = of_residuals(without, given).log_evidence
    assert found == pytest.approx(math.log(density(given) / density(without)), rel=1e-3)
    assert (found > 3.0) is there
    assert (found < -1.0) is not there


def test_noise_that_lasts_for_a_block_makes_a_pattern_less_certain() -> None:
    """A gain of density counts samples as independent; between blocks, projections vary by as much as they do."""
    rng, f = np.random.default_rng(1), np.full((20, 1, 30), 0.2)

    def mean(noise: Callable[[], np.ndarray]) -> tuple[float, float]:
        found = [of_residuals(e + f, e) for e in (noise() for _ in range(300))]
        return float(np.mean([one.value for one in found])), float(np.mean([one.log_evidence for one in found]))

    white = mean(lambda: rng.standard_normal((20, 1, 30)))
    lasting = mean(lambda: np.repeat(rng.standard_normal((20, 1, 1)), 30, 2))
    assert lasting[0] == pytest.approx(white[0], rel=0.2)
    assert white[1] > 5.0 > 1.0 > lasting[1]


def test_elpd_of_rows_is_that_of_blocks_of_a_second() -> None:
    """Rows that are not counted, and joints without torque, have no part in it."""
    t, recording = np.array([0.1, 0.9, 1.2, 1.8, 0.5, 7.0]), np.array([0, 0, 0, 0, 1, 1])
    counted = np.array([True, True, True, True, True, False])
    before = np.array([[3.0, np.nan], [1.0, np.nan], [2.0, np.nan], [2.0, 1.0], [3.0, 1.0], [9.0, 9.0]])
    after = np.array([[1.0, np.nan], [1.0, np.nan], [1.0, np.nan], [1.0, 1.0], [1.0, 1.0], [0.0, 0.0]])
    squares = lambda e: np.array([[e[0] + e[1], 0.0], [e[2] + e[3], 1.0], [e[4], 1.0]])  # noqa: E731
    errors, between = (squares(x[:, 0] ** 2) for x in (before, after)), squares((before - after)[:, 0] ** 2)
    between[:, 1] = 0.0
    expected = elpd_of(*errors, between, np.array([[2.0, 0.0], [2.0, 1.0], [1.0, 1.0]]), 0.3)
    assert elpd_of_rows(before, after, recording, t, counted, 0.3) == expected
    assert expected.value == pytest.approx((8.0 + 6.0 + 8.0) / 2.0)


@pytest.mark.parametrize(
    ("elpd", "certain", "matters"),
    [
        (Elpd(5.0, 4.0, 9.0, 0.06, 0.0011), True, True),
        (Elpd(3.0, 4.0, 9.0, 0.06, 0.0011), False, True),
        (Elpd(5.0, 4.0, 9.0, 0.04, 0.0011), True, False),
        (Elpd(5.0, 4.0, 9.0, 0.06, 0.0009), True, False),
    ],
    ids=["both", "by chance", "little error", "little torque"],
)
def test_a_gain_may_be_certain_and_may_matter(elpd: Elpd, certain: bool, matters: bool) -> None:
    assert (elpd.certain, elpd.matters) == (certain, matters)


def needed(term: Candidate, elpd: Elpd) -> bool:
    """Of what is expected at one place in twenty."""
    return elpd.matters and elpd.log_evidence > math.log(20.0)


def test_what_is_there_is_proven(drag: FinalModel) -> None:
    proof, (term,) = Proof(drag), drag.terms
    one = proof.elpd(term)
    assert one.value > DECISIONS.least_elpd * one.se > 0.0
    assert one.share > 0.9
    assert one.log_evidence > 20.0
    count, _, square = drag.prepared.training.torque.sum(0)[0].tolist()
    expected = torque_rms(term, drag)[FIRST] / math.sqrt(square / count)
    assert one.torque_share == pytest.approx(expected, rel=1e-3)
    assert backward_elimination(proof, drag.terms, needed) == {}
    assert [(f.effect, f.elpd) for f in explain(drag).findings if f.effect == DRAG] == [(DRAG, one)]


def test_what_is_not_there_is_not(no_drag: FinalModel) -> None:
    proof, (term,) = Proof(no_drag), no_drag.terms
    one = proof.elpd(term)
    assert one.share < DECISIONS.least_error
    assert one.log_evidence < 1.0
    assert backward_elimination(proof, no_drag.terms, needed) == {term: one}
    found = explain(no_drag)
    assert found.model.terms == ()
    assert DRAG not in {f.effect for f in found.findings}


def test_the_choice_of_a_shape_is_paid_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A power law has an exponent: of those on its grid, one was chosen."""
    model = with_laws([POWER], with_friction(at_joint(0, dragged)))
    (power,) = model.terms
    one, exponents = Proof(model).elpd(power), list(power.effect.shapes(model.model.columns.scale(power.site)))
    assert len(exponents) > 1
    monkeypatch.setattr(type(power.effect), "shapes", lambda *_: exponents[:1])
    assert Proof(model).elpd(power) == before_price(one, len(exponents))


@pytest.mark.parametrize("there", [True, False])
def test_blocks_are_predicted_as_by_fits_that_are_repeated(there: bool, drag: FinalModel, no_drag: FinalModel) -> None:
    model = drag if there else no_drag
    (term,), n = model.terms, len(model.prepared.training)
    folds = [list(map(int, fold)) for fold in np.array_split(np.arange(n), 8)]
    assert_alike(Proof(model).elpd(term), repeated(model, term, folds))


def test_a_law_with_a_level_is_proven_against_an_offset_and_leaves_one() -> None:
    """Else every constant torque would prove a spring, and a model without one would lack the constant."""
    model = with_laws(["joint_spring"], with_friction(at_joint(0, lambda m: np.full(len(m.t), 2.0))), ["torque_offset"])
    (spring,) = model.terms
    assert all(f.candidate.joint != 0 for f in model.friction if f.candidate.effect.id == "torque_offset")
    elpd = Proof(model).elpd(spring)
    assert elpd.log_evidence < math.log(20.0)
    assert elpd.share < DECISIONS.least_error
    rest = explain(model).model
    assert rest.terms == ()
    (offset,) = (
        f.candidate for f in rest.friction if f.candidate.effect.id == "torque_offset" and f.candidate.joint == 0
    )
    assert rest.model.coefficients(offset)[0].item() == pytest.approx(2.0, rel=0.05)
    judging, name = model.prepared.judging, FIRST
    with_it, without = (judge(judging, one.model.x).nmse[name] for one in (model, rest))
    assert without == pytest.approx(with_it, rel=0.1)


def test_what_carries_next_to_nothing_has_no_name() -> None:
    """It is a quarter of what is left, and half a thousandth of the joint's torque."""
    small = with_laws([DRAG], at_joint(0, lambda m: 0.0005 * dragged(m)), noise=1e-5)
    proof, (term,) = Proof(small), small.terms
    one = proof.elpd(term)
    assert one.log_evidence > 5.0
    assert one.share > 0.2
    assert 0.0004 < one.torque_share < DECISIONS.least_torque
    assert backward_elimination(proof, [term], needed) == {term: one}
    found = explain(small)
    assert DRAG not in {f.effect for f in found.findings}
    assert found.model.terms == ()


def test_of_terms_that_stand_in_for_each_other_one_is_left_out() -> None:
    """Either is worth nothing beside the other; without both a half of the error comes back."""
    model = with_laws([DRAG, POWER], with_friction(at_joint(0, dragged)))
    proof, (drag, power) = Proof(model), model.terms
    assert not needed(power, proof.elpd(power))
    assert list(backward_elimination(proof, [drag, power], needed)) == [power]
    alone = proof.elpd(drag, [power])
    assert needed(drag, alone)
    assert alone.share > 0.9
    assert {f.effect for f in explain(model).findings} >= {DRAG}


@dataclass(frozen=True)
class Named:
    """A term of a name."""

    name: str
    effect: None = None


class Told:
    """What terms are worth, by name, given which of them are gone."""

    def __init__(self, worth: Callable[[str, set[str]], float]) -> None:
        self.worth = worth

    def elpd(self, term: Named, gone: Sequence[Named]) -> Elpd:
        return Elpd(self.worth(term.name, {one.name for one in gone}), 1.0, 1.0, 0.5, 0.5)


def test_what_is_least_useful_goes_first_and_the_others_are_judged_without_it() -> None:
    """A spring is a proxy for a ripple; backlash makes up for a ripple that is not there."""
    terms = [Named(name) for name in ("ripple", "spring", "backlash", "drag")]

    def worth(name: str, gone: set[str]) -> float:
        each = {"ripple": 0.9, "spring": -0.2, "backlash": 0.5, "drag": 40.0}
        if "spring" in gone:
            each |= {"ripple": 30.0, "backlash": -3.0}
        return each[name]

    certain = lambda _, elpd: elpd.certain  # noqa: E731
    gone = backward_elimination(Told(worth), terms, certain)  # type: ignore[arg-type]
    assert {term.name: elpd.value for term, elpd in gone.items()} == {"spring": -0.2, "backlash": -3.0}  # type: ignore[attr-defined]
    assert backward_elimination(Told(lambda *_: 9.0), terms, certain) == {}  # type: ignore[arg-type]


@pytest.mark.parametrize("loaded", [True, False])
def test_what_acts_for_a_time_is_cross_validated_there(loaded: bool) -> None:
    """Each block of its time is left out by itself."""
    found, model_of = searched(payload if loaded else None)
    model = model_of(told(found, Window("first", BEGIN_S)))
    proof, (term,) = Proof(model), model.terms
    blocks = model.prepared.judging_fitted.blocks
    inside = [k for k, block in enumerate(blocks) if acts_in(block, term.site)]
    assert 2 <= len(inside) < len(blocks)
    one = proof.elpd(term)
    # It begins between two blocks and lasts.
    windows = 2 * (sum(block.recording == "first" for block in blocks) - 1)
    assert_alike(before_price(one, windows), repeated(model, term, [[k] for k in inside]))
    assert needed(term, one) is loaded
    assert (one.share > 0.5) is loaded
    if loaded:
        motion = multisine(2, 2, duration_s=OPTIONS["duration_s"], rate_hz=OPTIONS["rate_hz"])
        load = payload(motion)
        torque = inverse_dynamics(URDF, motion) + with_friction(payload)(motion)
        sizes = [np.sqrt(np.mean(x[motion.t >= BEGIN_S] ** 2, axis=0)) for x in (load, torque)]
        assert one.torque_share == pytest.approx((sizes[0] / sizes[1]).max(), rel=0.2)


@pytest.mark.parametrize("everywhere", [False, True])
def test_what_acts_in_one_recording_must_not_make_others_worse(everywhere: bool) -> None:
    """A load that all recordings have at the same time is no load of one: the bodies would lack it in the others."""
    found, model_of = searched(payload, *([payload, payload] if everywhere else [None, None]))
    model = model_of(told(found, Window("first", BEGIN_S)))
    proof, (term,) = Proof(model), model.terms
    blocks = model.prepared.judging_fitted.blocks
    inside = [[k] for k, block in enumerate(blocks) if acts_in(block, term.site)]
    others = [[k for k, block in enumerate(blocks) if block.recording == name] for name in ("more 0", "more 1")]
    one = proof.elpd(term)
    windows = 2 * (sum(block.recording == "first" for block in blocks) - 1)
    assert_alike(before_price(one, windows), replace(repeated(model, term, [*inside, *others]), share=one.share))
    assert one.share > 0.5
    assert needed(term, one) is not everywhere


def test_a_time_of_one_block_proves_nothing() -> None:
    found, model_of = searched(None)
    brief = model_of(told(found, Window("first", 5.1, 5.4)))
    (term,) = brief.terms
    nothing = Elpd(0.0, 0.0, 0.0, 0.0, 0.0)
    assert Proof(brief).elpd(term) == nothing
    assert backward_elimination(Proof(brief), [term], needed) == {term: nothing}


def test_curves_need_only_predict_better() -> None:
    model = diagnosed(at_joint(0, lambda m: 0.3 * np.sin(6.0 * m.q[:, 0])))
    (curve,) = model.terms

    for value in (0.5, 2.0):
        assert _is_needed(model, curve, Elpd(value, 1.0, 0.0, 0.0, 0.0)) is (value > 1.0)
    found = explain(model)
    assert found.curves.keys() == {curve}
    assert found.curves[curve].share > 0.5


def told_of(one: Finding) -> tuple[Any, ...]:
    return one.effect, one.joints, one.links, one.where, one.probability, one.parameters, one.elpd


@pytest.mark.parametrize(
    "more",
    [lambda _, tau: 2.0 * tau, lambda m, _: 5.0 * m.q, lambda m, _: -0.5 * with_friction(at_joint(0, dragged))(m)],
    ids=["three times as much", "a spring", "half of what is found"],
)
def test_findings_do_not_depend_on_held_out_data(more: Callable[[Any, np.ndarray], np.ndarray]) -> None:
    """Held-out torque is told with them; it says nothing of what is there."""
    day, night = (
        recorded(URDF, seed, with_friction(at_joint(0, dragged)), name=name, **OPTIONS)
        for seed, name in ((2, "day.csv"), (3, "night.csv"))
    )
    (chunk,) = night.chunks(10**6)
    qd = np.gradient(chunk.q, chunk.t, axis=0)
    tau = chunk.tau + more(SimpleNamespace(t=chunk.t, q=chunk.q, qd=qd), chunk.tau)
    other = Recording.from_arrays("night.csv", joint_names(URDF), chunk.t, chunk.q, tau)
    given, may = with_wrong_inertials(URDF, 1, 0.1).encode(), (*MAY, "joint_spring", "torque_offset")
    one, two = (torchrbd.diagnose(given, day, holdout=[held_out], effects=may) for held_out in (night, other))
    assert DRAG in {f.effect for f in one.findings}
    for kind in ("findings", "not_confirmed"):
        first, second = ({told_of(f)[:4]: told_of(f)[4:] for f in getattr(each, kind)} for each in (one, two))
        assert first == second
    before, after = (each.identification.fits["extended"].mean_nmse for each in (one, two))
    assert before < 0.01 < after
    assert any(f.nmse_after != g.nmse_after for f, g in zip(one.findings, two.findings, strict=True))
