"""Torque without a law, from the search to a person: where, over what and how large; none where nothing is left."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from likelihood.arms import recorded
from likelihood.fits import COULOMB, OPTIONS, URDF, VISCOUS, at_joint, with_friction
from report import fabricated
from report.rendered import Text, render
from shortened import slow_but
from simulated import Motion, inverse_dynamics, joint_names, with_wrong_inertials

from torchrbd.diagnosis.curve_hypotheses import is_curve
from torchrbd.diagnosis.curves import loudest_part
from torchrbd.diagnosis.explain import explain
from torchrbd.diagnosis.final_model import FinalModel, fit_final_model
from torchrbd.diagnosis.friction import COULOMB as EVEN
from torchrbd.diagnosis.friction import UNEVEN
from torchrbd.diagnosis.ranking import run_search
from torchrbd.diagnosis.results import HeldOutCheck, Unexplained, Where
from torchrbd.diagnosis.state_dependence import state_dependence
from torchrbd.diagnosis.unexplained import drifts, large_errors, merge_errors, unexplained
from torchrbd.effects.smooth_torque import HUM
from torchrbd.inference.identify import summarise
from torchrbd.inference.ordinary import with_friction as friction_of
from torchrbd.inference.ordinary import with_machine
from torchrbd.inference.preparation import prepare
from torchrbd.inference.results import TorqueSeries
from torchrbd.inference.settings import Settings
from torchrbd.robot import RobotModel

FIRST, SECOND = joint_names(URDF)
SIZE, WIDTH = 2.0, 0.15
TONE, TONE_HZ = 0.1, 2.73
WALK, STEP = 0.3, 6.0
MAY = ("viscous_friction", "coulomb_friction", UNEVEN.id, "quadratic_drag")


def centre(m: Motion) -> float:
    return float(np.median(m.q[:, 0]))


def bump(m: Motion) -> np.ndarray:
    return SIZE * np.exp(-(((m.q[:, 0] - centre(m)) / WIDTH) ** 2))


def quiet(*_: object) -> None:
    """Tell nobody how far the work is."""


def diagnosed(torque: Callable | None, seconds: Sequence[float] = (30.0,), may: Sequence[str] = MAY) -> FinalModel:
    """Return the model with what the search finds of few laws in recordings that last so long."""
    recordings = [
        recorded(URDF, 2 + k, with_friction(torque), name=f"run{k + 1}", **{**OPTIONS, "duration_s": length})
        for k, length in enumerate(seconds)
    ]
    settings = Settings.from_mapping({"effects": may}, "test")
    prepared = prepare(RobotModel.from_urdf(with_wrong_inertials(URDF, 1, 0.1)), recordings, settings, ())
    ranked = run_search(prepared.reading, settings, prepared.kept_back, quiet)
    prepared = with_machine(prepared, settings, friction_of(settings), quiet, ranked.clocks)
    return fit_final_model(prepared, ranked.explanation, may, quiet)


@pytest.fixture(scope="module")
def bumped() -> FinalModel:
    return diagnosed(at_joint(0, bump))


def left(model: FinalModel) -> tuple[Unexplained, ...]:
    """Return what a diagnosis says that no law explains."""
    found = explain(model)
    return unexplained(found.model, found.curves)


@pytest.fixture(scope="module")
def told(bumped: FinalModel) -> Unexplained:
    return left(bumped)[0]


def test_a_curve_is_no_larger_than_it_is_believed_to_be(bumped: FinalModel) -> None:
    found, model = bumped.found, bumped
    curves = [(t.own, c) for t, c in zip(found.terms, model.terms, strict=True) if is_curve(c)]
    assert curves
    for own, c in curves:
        at = model.model.columns.of(c)
        scale = np.asarray(model.prepared.prior.scale.diagonal())[at]
        assert (scale <= own.extra(found.fit, found.rows).std * (1 + 1e-9)).all()
        assert (scale > 0).all()


def test_curves_leave_ordinary_friction_its_place(bumped: FinalModel) -> None:
    model = bumped
    for f, c in zip(model.friction, model.model.terms, strict=False):
        w, _ = model.model.coefficients(c)
        joint = f.candidate.joint
        true = VISCOUS[joint] if c.effect.id == "viscous_friction" else COULOMB[joint]
        assert float(w[0]) == pytest.approx(true, rel=0.1)


def test_torque_without_a_law_is_told_with_its_place_signal_and_shape(told: Unexplained) -> None:
    assert (told.joints, told.depends_on) == ((FIRST,), (f"q_{FIRST}",))
    assert told.share > 0.5
    assert f" RMS at {FIRST} is unexplained" in told.statement
    assert told.where.recordings is None
    assert told.where.region is not None
    (region,) = told.where.region
    recording = recorded(URDF, 2, **{**OPTIONS, "duration_s": 30.0})
    q0 = float(np.median(next(iter(recording.chunks(10**6))).q[:, 0]))
    assert region.signal == f"q_{FIRST}"
    assert region.low < q0 < region.high
    assert region.high - region.low < 6 * WIDTH
    assert told.curve is not None
    x, y = np.array(told.curve.at), np.array(told.curve.torque)
    true = SIZE * np.exp(-(((x - q0) / WIDTH) ** 2))
    # A constant, and what a body may weigh, are not told from it.
    assert np.ptp(y) == pytest.approx(SIZE, rel=0.35)
    assert np.corrcoef(y, true)[0, 1] > 0.9
    assert (np.array(told.curve.std) > 0).all()


def test_a_share_of_the_error_is_said_where_left_out_data_has_one() -> None:
    sizes = {"torque_rms": 3.0}
    everywhere = Unexplained((FIRST,), (f"q_{FIRST}",), Where(), 0.25, sizes=sizes)
    assert everywhere.statement == (
        f"A torque of 3.00 N m RMS at {FIRST} is unexplained. It is 25 % of the residual of left-out data. "
        f"It depends on the position of {FIRST}."
    )
    one = Unexplained((FIRST,), (), Where(("B.csv",)), 0.0, sizes=sizes)
    assert one.statement == f"A torque of 3.00 N m RMS at {FIRST} is unexplained in B.csv."


@pytest.mark.parametrize("seconds", [(30.0,), (15.0, 20.0)])
def test_a_tone_is_told_by_its_joint_and_frequency(seconds: tuple[float, ...]) -> None:
    """In all recordings, each at a phase of its own: what one of them is without, another would leave to the noise."""

    def tone(m: Motion) -> np.ndarray:
        return TONE * np.sin(2 * np.pi * TONE_HZ * m.t + len(m.t))

    model = diagnosed(at_joint(1, tone), seconds)
    found = model.found
    (one,) = (u for u in left(model) if u.depends_on == ("t",))
    assert one.joints == (SECOND,)
    assert one.where.recordings is None, "it is in all of them"
    assert len(found.rows.seen_recordings) == len(seconds)
    (hum,) = (t.own for t in found.terms if t.own.candidate.effect is HUM)
    assert np.hypot(hum.coefficients[::2], hum.coefficients[1::2]) == pytest.approx(TONE, rel=0.1)
    assert one.where.region is not None
    (band,) = one.where.region
    assert 0.5 * (band.low + band.high) == pytest.approx(TONE_HZ, abs=0.02)
    assert f"{TONE_HZ:.2f} Hz" in one.statement
    assert one.share > 0.5


def test_a_torque_that_wanders_is_told_though_noise_could_pass_for_it() -> None:
    def walk(m: Motion) -> np.ndarray:
        steps = np.cumsum(np.random.default_rng(0).standard_normal(60))
        return WALK * np.interp(m.t, 0.5 * np.arange(60), (steps - steps.mean()) / steps.std())

    model = diagnosed(at_joint(0, walk))
    assert left(model) == ()
    series = summarise(model.prepared, {"extended": model.model}, Settings.from_mapping({}, "test"), quiet).series
    (one,) = drifts(series, model.prepared.robot)
    assert (one.joints, one.depends_on) == ((FIRST,), ("t",))
    assert one.sizes["torque_rms"] == pytest.approx(WALK, rel=0.3)
    assert 0.5 < one.share < 1.0


def test_a_function_that_the_noise_has_the_colour_of_is_told() -> None:
    """Steps where the load changes its sign look like slow noise until noise is learnt beside them."""

    def dead_zone(m: Motion) -> np.ndarray:
        return STEP * np.sign(inverse_dynamics(URDF, m)[:, 0])

    model = diagnosed(at_joint(0, dead_zone))
    (one,) = (u for u in left(model) if u.joints == (FIRST,))
    assert one.depends_on == (f"tau_{FIRST}",)


@pytest.mark.parametrize("size", slow_but((0.3,), (0.3, 3.0)))
def test_a_dead_zone_has_a_name_though_it_hides_what_the_load_is(size: float) -> None:
    """Three N m are more than the load: what is fitted without them has its sign wrong for a twentieth of the time."""

    def dead_zone(m: Motion) -> np.ndarray:
        return size * np.sign((inverse_dynamics(URDF, m) + with_friction()(m))[:, 0])

    may = *MAY, "torque_scale", "torque_saturation", "torque_dead_zone"
    model = diagnosed(at_joint(0, dead_zone), may=may)
    found = model.found
    (term,) = found.terms
    assert (term.own.candidate.effect.id, term.own.candidate.place) == ("torque_dead_zone", 0)
    assert term.own.coefficients == pytest.approx([size], rel=0.02)
    assert left(model) == ()


@pytest.mark.parametrize(("uneven", "told", "other"), [(0.022, EVEN.id, UNEVEN.id), (0.03, UNEVEN.id, EVEN.id)])
def test_coulomb_friction_whose_directions_may_differ_is_told_with_both_laws(
    uneven: float, told: str, other: str
) -> None:
    """That there is friction is certain; its laws share that, and what is told has the level that both have."""
    model = diagnosed(at_joint(0, lambda m: uneven * np.tanh(m.qd[:, 0] / 0.01) ** 2), may=MAY[:3])
    (one,) = (f for f in explain(model).findings if f.joints == (FIRST,) and "coulomb" in f.effect)
    assert (one.effect, [law.effect for law in one.laws]) == (told, [told, other])
    assert one.family_probability > 0.99 > one.probability > 0.5
    assert sum(law.probability for law in one.laws) == pytest.approx(1.0)
    alike = one.indistinguishable_from[0]
    level = [np.mean(list(p.values())) for p in (alike.parameters, {k: q.value for k, q in one.parameters.items()})]
    assert alike.effect == other
    assert level == pytest.approx([COULOMB[0]] * 2, rel=0.02)


def test_where_nothing_is_left_nothing_is_told() -> None:
    model = diagnosed(None)
    assert model.terms == ()
    assert left(model) == ()


@pytest.mark.parametrize(
    ("torque", "expected"),
    [([0, 0, 0, 5, 6, 4, 0, 0], (3.0, 5.0)), ([0, 0, 0, -5, -6, 0, 0, 0], (3.0, 4.0)), ([9, 1, 1, 1, 1], (0.0, 0.0))],
)
def test_a_curve_is_loud_around_its_largest_departure(torque: list[float], expected: tuple[float, float]) -> None:
    assert loudest_part(np.arange(float(len(torque))), np.array(torque, dtype=float)) == expected


@pytest.mark.parametrize(
    ("torque", "told"),
    [
        (lambda t: 0.5 * np.cos(0.1 * np.pi * t), True),
        (lambda t: 0.02 * np.cos(0.1 * np.pi * t), False),
        (lambda t: 2.0 * (np.arange(len(t)) % 25 < 2) * (-1.0) ** np.arange(len(t)), False),
        (lambda t: 0.5 + 0.0 * t, False),
    ],
    ids=["drifts", "next to nothing", "spikes", "a level"],
)
def test_drift_is_slow_in_the_residual_that_is_reported(torque: Callable[[np.ndarray], np.ndarray], told: bool) -> None:
    """Where it is measured: the other recording lacks this torque."""
    rng, t = np.random.default_rng(0), np.tile(0.1 * np.arange(200), 2)
    recording, none = np.repeat([0, 1], 200), np.zeros((400, 1))
    left = (torque(t) + 0.1 * rng.standard_normal(400))[:, None]
    measured = np.where(recording[:, None] == 0, left + 4.0 * np.sin(3.0 * t)[:, None], np.nan)
    series = TorqueSeries(
        (FIRST,), ("a", "b"), recording, t, np.zeros(400, bool), none, none, none, measured,
        {"extended": measured - left},
    )  # fmt: skip
    found = list(drifts(series, RobotModel.from_urdf(URDF)))
    assert len(found) == told
    assert all(one.sizes["torque_rms"] == pytest.approx(0.5 / math.sqrt(2.0), rel=0.1) for one in found)


@pytest.mark.parametrize(
    ("nmse", "times", "lasts", "named", "of_states", "says"),
    [
        (
            0.02,
            1.0,
            True,
            True,
            True,
            "(2 % of the torque variance), with correlated errors",
        ),
        (0.02, 1.0, True, True, True, "A random forest of all states predicts"),
        (0.02, 1.0, True, True, False, ""),
        (0.02, 2.0, True, True, False, "times that of the fitted data"),
        (0.005, 2.0, True, False, True, "times that of the fitted data"),
        (0.005, 2.0, True, True, True, ""),
        (0.005, 1.2, True, False, True, ""),
        (0.02, 2.0, False, False, True, ""),
    ],
    ids=["much", "in words", "noise", "more, and much", "more than elsewhere", "and named", "as elsewhere", "white"],
)
def test_a_joint_that_is_predicted_badly_is_reported(
    nmse: float, times: float, lasts: bool, named: bool, of_states: bool, says: str
) -> None:
    """Errors of one size, whose sign depends on two positions, or on none."""
    rows, rng = 400, np.random.default_rng(0)
    t, held_out = 0.1 * np.tile(np.arange(rows), 2), np.repeat([False, True], rows)
    q = np.sin(2.0 * np.pi * np.outer(t + 7.0 * held_out, [0.23, 0.31]))
    sign = np.sign(q[:, 0] * q[:, 1]) if of_states else rng.choice([-1.0, 1.0], 2 * rows)
    error = np.where(held_out, 0.5 * times, 0.5) * sign
    predicted = 0.5 * times * math.sqrt(1.0 / nmse - 1.0) * np.tile([1.0, -1.0], rows)
    measured, none = predicted + error, np.full(2 * rows, np.nan)
    series = TorqueSeries(
        (FIRST, SECOND), ("day", "night"), held_out.astype(int), t, held_out, q, 0.0 * q, 0.0 * q,
        np.stack((measured, none), 1), {"extended": np.stack((predicted, none), 1)},
    )  # fmt: skip
    assert series.fit("extended").nmse[FIRST] == pytest.approx(nmse, rel=0.05)
    check = HeldOutCheck(FIRST, {}, {"extended": 0.3 if lasts else 0.1}, 0.1)
    told = [one.statement for one in large_errors(series, [check], {FIRST} if named else set())]
    assert len(told) == bool(says)
    assert all(says in one for one in told)


def test_a_joint_without_fitted_rows_has_no_errors_that_depend_on_states() -> None:
    t, ones = 0.1 * np.arange(100), np.ones((100, 1))
    series = TorqueSeries(
        (FIRST,), ("day",), np.zeros(100, int), t, np.ones(100, bool), ones, ones, ones, ones, {"extended": 0.0 * ones}
    )
    assert not state_dependence(series, 0, "extended").certain


def test_the_error_of_a_joint_is_said_where_its_residual_is() -> None:
    """Alone it says how large the error is, and that nothing explains it, which a curve of the joint contradicts."""
    curve = Unexplained((FIRST,), (f"q_{FIRST}",), Where(), 0.4, sizes={"torque_rms": 3.0})
    tone = Unexplained((FIRST,), ("t",), Where(), 0.1, kind="tone", sizes={"low": 1.0, "high": 2.0, "frequency": 3.0})
    error = Unexplained((FIRST,), (), Where(), 1.0, kind="error", sizes={"nmse": 0.05})
    larger = Unexplained((SECOND,), (), Where(), 0.5, kind="larger error", sizes={"ratio": 2.0})
    first, second, third = merge_errors((curve, tone, error, larger))
    assert (second, third) == (tone, larger)
    assert first == replace(curve, sizes={"torque_rms": 3.0, "nmse": 0.05})
    assert first.statement == (
        f"{curve.statement} The NMSE of {FIRST} on held-out data is 0.0500 (5 % of the torque variance), with "
        "correlated errors."
    )
    drift = Unexplained((SECOND,), ("t",), Where(), 0.3, kind="drift", sizes={"torque_rms": 0.3})
    (only,) = merge_errors((larger, drift))
    assert only.statement == (
        f"{drift.statement} The error of {SECOND} on held-out data is 2.00 times that of the fitted data."
    )
    assert merge_errors((error, larger)) == (error, larger)
    assert "No known effect and no function" in error.statement


def test_a_joint_with_a_curve_has_one_card_and_its_error(tmp_path: Path) -> None:
    result = fabricated.diagnosis((FIRST, SECOND))
    (curve,) = result.unexplained
    error = Unexplained(curve.joints, (), Where(), 1.0, kind="error", sizes={"nmse": 0.05})
    page = render(replace(result, unexplained=merge_errors((curve, error))), tmp_path)
    assert page.count(f"<h3>Unexplained at {curve.joints[0]}") == 1
    assert "5 % of the torque variance" in " ".join(Text(page).words)
