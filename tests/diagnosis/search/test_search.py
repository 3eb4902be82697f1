"""The search on simulated rows: screening against fits one by one, choices, and functions without a law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import inverse_dynamics, joint_names, record, with_wrong_inertials

import torchrbd
from torchrbd.diagnosis.rows.gain import Gain
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.search import grid
from torchrbd.diagnosis.search.grid import complexity, fresh_columns, refined, refinements
from torchrbd.diagnosis.search.lawless import challenged, lawful
from torchrbd.diagnosis.search.options import BACKGROUND, accepted, clearly_worse, judged, preferred
from torchrbd.diagnosis.search.pruning import pruned
from torchrbd.diagnosis.search.select import Search
from torchrbd.diagnosis.search.unnamed import smooth_candidates
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.likelihood.columns import Candidate
from torchrbd.likelihood.shapes import axes
from torchrbd.physics import Site, effect
from torchrbd.physics.smooth_torque import SMOOTH, SmoothTorque
from torchrbd.robot import RobotModel

EFFECTS = (
    *BACKGROUND,
    "stribeck_friction",
    "joint_spring",
    "quadratic_drag",
    "torque_ripple",
    "encoder_offset",
    "cable_drag",
    "position_dependent_friction",
)


def arm(seed: int) -> str:
    return random_urdf(seed, 3, kinds=("revolute",), branching=0.0, massless=0.0)


def at(urdf: str, joint: str, torque):
    """Return what puts ``torque(q, qd)`` of a joint on that joint."""
    k = joint_names(urdf).index(joint)

    def extra(motion):
        tau = np.zeros_like(motion.q)
        tau[:, k] = torque(motion.q[:, k], motion.qd[:, k])
        return tau

    return extra


def begun(seed: int, torque) -> tuple[Search, Fit]:
    urdf = arm(seed)
    recording = record(urdf, seed, duration_s=20.0, rate_hz=125.0, extra=at(urdf, "joint2", torque))
    prepared = prepare(RobotModel.from_urdf(urdf), [recording], Settings.from_mapping({}, "test"), ())
    search = Search(read_samples(prepared, prepared.fit().pi), [effect(name) for name in EFFECTS], prepared.prior)
    return search, search.start


@pytest.fixture(scope="module")
def dragged() -> tuple[Search, Fit]:
    return begun(5, lambda q, qd: 0.4 * qd * np.abs(qd))


def test_screening_is_fitting_one_by_one(dragged: tuple[Search, Fit]) -> None:
    search, fit = dragged
    for one in search.grid.screened(fit):
        C = fresh_columns(fit, one.candidate)
        assert one.gain == pytest.approx(fit.addition(C)[0], rel=1e-6, abs=1e-6)
        assert one.score == pytest.approx(
            one.gain - 0.5 * np.log(fit.rows.counts.max()) * complexity(fit, one.candidate)
        )


def test_what_acts_is_screened_first_and_chosen(dragged: tuple[Search, Fit]) -> None:
    search, fit = dragged
    first = search.grid.screened(fit)[0].candidate
    assert (first.effect.id, first.joint) == ("quadratic_drag", 1)
    chosen = [(c.effect.id, c.site.joint) for c in search.run().terms]
    assert chosen == [("quadratic_drag", 1)]


def test_of_several_shapes_the_best_that_the_physics_allows_is_screened() -> None:
    """Beside Coulomb friction, drag over the upper part of the range is what pushes over the lower part."""
    search, fit = begun(5, lambda q, qd: 0.4 * np.sign(qd) * (q > q.min() + 0.6 * np.ptp(q)))
    (drag,) = (o for o in search.grid.screened(fit) if o.name == ("cable_drag", Site(1)))
    scale = fit.rows.samples.columns.scale(Site(1))
    assert drag.candidate.shape["start"] > 0.5 * (scale.q_low + scale.q_high)
    (found,) = (c for c in search.run().terms if c not in search.background)
    assert (found.effect.id, found.joint) == ("cable_drag", 1)


def test_shapes_are_refined_from_several_of_the_grids() -> None:
    search, fit = begun(5, lambda q, qd: 0.4 * np.sign(qd) * (q > q.min() + 0.6 * np.ptp(q)))
    (drag,) = (o for o in search.grid.screened(fit) if o.name == ("cable_drag", Site(1)))
    shapes = [c for c in search.grid.candidates if (c.effect.id, c.site) == drag.name]
    assert 0 < len(drag.others) < len(shapes) - 1
    lowest = min(shapes, key=lambda c: c.shape["end"])
    (astray,) = refinements(fit, replace(drag, candidate=lowest, others=()))
    first, second = refinements(fit, replace(drag, candidate=lowest, others=(drag.candidate,)))
    assert (first.shape, second.shape) == (refined(fit, drag.candidate).shape, astray.shape)


def test_what_gains_over_a_narrow_range_is_refined(
    dragged: tuple[Search, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A peak a tenth as wide as the way to the next values on the grid, and a lower one on the other side."""
    search, fit = dragged
    start = next(o for o in search.grid.screened(fit) if o.name == ("position_dependent_friction", Site(1))).candidate
    now = start.shape["centre"]
    low, high = axes(fit.rows.samples.columns, start)["centre"].limits(now)
    peak, lower, width = now + 0.08 * (high - now), low + 0.38 * (high - low), 0.05 * (high - low)

    def gained(_: Fit, c: Candidate) -> float:
        x = c.shape["centre"]
        return 10.0 * np.exp(-(((x - peak) / width) ** 2)) + 2.0 * np.exp(-0.5 * ((x - lower) / width) ** 2)

    monkeypatch.setattr(grid, "_gain", gained)
    assert refined(fit, start).shape["centre"] == pytest.approx(peak, abs=0.4 * width)


@pytest.mark.parametrize("beyond", [-1.0, 1.0])
def test_a_shape_beyond_the_grids_limits_is_refined(dragged: tuple[Search, Fit], beyond: float) -> None:
    """As one is that stands there from an earlier refinement."""
    search, fit = dragged
    start = next(o for o in search.grid.screened(fit) if o.name == ("position_dependent_friction", Site(1))).candidate
    low, high = axes(fit.rows.samples.columns, start)["centre"].limits(100.0 * beyond)
    far = 0.5 * (low + high) + beyond * (high - low)
    shape = {**start.shape, "centre": far}
    found = refined(fit, fit.rows.samples.columns.candidate(start.effect, start.site, shape))
    assert min(low, far) <= found.shape["centre"] <= max(high, far)


def test_a_shape_that_has_no_features_is_no_refinement(dragged: tuple[Search, Fit]) -> None:
    """A secant over no time, among those that refining tries."""
    _, fit = dragged
    nothing = fit.rows.samples.columns.candidate(effect("time_delay"), Site(1), {"step": 0.0})
    assert not np.isfinite(fit.rows.samples.evaluated(nothing)).all()
    assert refined(fit, nothing).shape["step"] != 0.0


def test_what_seems_best_and_is_refused_keeps_nothing_from_the_list(dragged: tuple[Search, Fit]) -> None:
    search, fit = dragged
    true, *others = search.grid.screened(fit)
    driving = {c.effect.id: c for c in search.grid.candidates if c.site == Site(1)}["stribeck_friction"]
    refused = replace(true, candidate=driving, score=100.0 * true.score)
    listed = [o.candidate.effect.id for o in search.shortlisted(fit, [refused, true, *others])]
    assert "quadratic_drag" in listed


def test_a_term_is_chosen_again_among_what_explains_the_same() -> None:
    search, fit = begun(5, lambda q, qd: 0.4 * q + 0.1 * qd * np.abs(qd))
    spring = fit.rows.samples.columns.candidate(effect("joint_spring"), Site(1), {})
    beside = search.grid.gains(Fit(fit.rows, (*fit.terms, spring)))
    offered, rivals = (
        {o.candidate.effect.id for o in found} for found in (search.options(fit), search.rivals(fit, beside))
    )
    assert {"joint_spring", "quadratic_drag"} <= offered
    assert "joint_spring" in rivals
    assert "quadratic_drag" not in rivals


def test_what_leads_back_to_where_it_was_ends(dragged: tuple[Search, Fit], monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect that goes again once the load is known with it, and a function without a law whose names go with it."""
    search, fit = dragged
    rounds: list[str] = []
    drag = judged(fit, next(c for c in search.grid.candidates if c.effect.id == "quadratic_drag"))
    monkeypatch.setattr(search, "acceptable", lambda _: rounds.append("name") or [drag])
    monkeypatch.setattr(search, "settled", lambda grown: grown)
    monkeypatch.setattr(search, "loaded", lambda _: fit)
    assert search.named(fit) is fit
    assert rounds == ["name"]
    monkeypatch.setattr(search, "smooth", lambda _: rounds.append("smooth") or drag)
    monkeypatch.setattr(search, "named", lambda _: fit)
    search._completed(fit)
    assert rounds == ["name", "smooth"]


def test_the_limit_of_a_saturation_follows_the_load_as_it_becomes_known() -> None:
    urdf, limits = arm(8), []

    def saturated(motion):
        tau = inverse_dynamics(urdf, motion)
        limits.append(0.35 * np.abs(tau[:, 1]).max())
        return (np.clip(tau, -limits[0], limits[0]) - tau) * (np.arange(3) == 1)

    recording = record(urdf, 7, duration_s=20.0, rate_hz=125.0, extra=saturated)
    prepared = prepare(RobotModel.from_urdf(with_wrong_inertials(urdf, 1)), [recording], Settings(), ())
    effects = [effect(name) for name in (*BACKGROUND, "torque_saturation")]
    search = Search(read_samples(prepared, prepared.fit().pi), effects, prepared.prior)
    (found,) = (c for c in search.named(search.start).terms if c not in search.background)
    assert found.shape["limit"] == pytest.approx(limits[0], rel=0.05)


def test_nothing_is_chosen_instead_of_plain_friction() -> None:
    search, _ = begun(5, lambda q, qd: 0.3 * np.sign(qd))
    found = search.run()
    (coulomb,) = (c for c in found.terms if c.effect.id == "coulomb_friction" and c.joint == 1)
    assert search.without(found, [coulomb]).terms == tuple(c for c in found.terms if c is not coulomb)


def test_a_name_is_worth_more_than_plain_friction() -> None:
    search, fit = begun(5, lambda q, qd: 0.4 * qd + 0.3 * np.sign(qd))
    drag = fit.rows.samples.columns.candidate(effect("quadratic_drag"), Site(1), {})
    alone = Fit(fit.rows, (*(c for c in fit.terms if c.effect.id != "viscous_friction" or c.joint != 1), drag))
    left = [(c.effect.id, c.joint) for c in pruned(search, alone).terms]
    assert sorted(left) == [("coulomb_friction", 1), ("viscous_friction", 1)]


def test_a_shape_is_found_between_the_points_of_its_grid() -> None:
    _, fit = begun(6, lambda q, qd: 0.5 * np.sin(11.37 * q))
    near = fit.rows.samples.columns.candidate(effect("torque_ripple"), Site(1), {"order": 11.0})
    found = refined(fit, near)
    assert found.shape["order"] == pytest.approx(11.37, abs=0.05)
    assert judged(fit, found).worth.total > judged(fit, near).worth.total


def test_the_simpler_of_equals_is_preferred(dragged: tuple[Search, Fit]) -> None:
    _, fit = dragged
    columns = fit.rows.samples.columns
    options = [
        judged(fit, columns.candidate(effect("power_law_friction"), Site(1), {"exponent": 1.99})),
        judged(fit, columns.candidate(effect("quadratic_drag"), Site(1), {})),
    ]
    assert preferred(fit, options).candidate.effect.id == "quadratic_drag"


def test_options_are_compared_with_each_other_whatever_view_they_gained_over(dragged: tuple[Search, Fit]) -> None:
    _, fit = dragged
    columns = fit.rows.samples.columns
    true = judged(fit, columns.candidate(effect("power_law_friction"), Site(1), {"exponent": 1.99}))
    simple = judged(fit, columns.candidate(effect("quadratic_drag"), Site(0), {}))
    assert complexity(fit, simple.candidate) < complexity(fit, true.candidate)
    praised = replace(simple, worth=replace(true.worth, total=2.0 * true.worth.total))
    assert preferred(fit, [praised, true]) is true


def test_one_lucky_block_is_not_accepted_and_a_rare_effect_is() -> None:
    assert accepted(Gain(total=40.0, std=10.0, repeated=30.0))
    assert accepted(Gain(total=100.0, std=60.0, repeated=40.0))
    assert not accepted(Gain(total=100.0, std=60.0, repeated=5.0))
    assert not accepted(Gain(total=10.0, std=1.0, repeated=9.0))
    assert clearly_worse(Gain(20.0, 5.0, 15.0), 100.0)
    assert not clearly_worse(Gain(2.0, 0.1, 1.9), 100.0)
    assert not clearly_worse(Gain(20.0, 15.0, 1.0), 100.0)


def test_smooth_functions_cover_what_the_samples_cover(dragged: tuple[Search, Fit]) -> None:
    samples = dragged[1].rows.samples
    found = list(smooth_candidates(samples, samples.seen))
    assert len({c.effect.id for c in found}) == len(SMOOTH)
    for c in found:
        assert isinstance(c.effect, SmoothTorque)
        total = samples.features(c).sum(0)
        plain = not c.effect.friction and not c.effect.times_own
        assert not plain or np.abs(total - 1.0).max() < 1e-6


def test_a_bump_is_unexplained_and_drawn_as_it_is() -> None:
    urdf = arm(9)
    bump = lambda q: 1.5 * np.exp(-(((q - q.mean()) / 0.25) ** 2))  # noqa: E731
    recording = record(urdf, 9, duration_s=40.0, extra=at(urdf, "joint2", lambda q, qd: bump(q)))
    (left,) = torchrbd.diagnose(urdf, recording).unexplained
    assert (left.joints, left.depends_on) == (("joint2",), ("q_joint2",))
    assert left.share > 0.5
    assert left.curve is not None
    height = np.ptp(left.curve.torque)
    assert height == pytest.approx(1.5, rel=0.25)
    (region,) = left.where.region or ()
    q = next(iter(recording.chunks(10**6))).q[:, 1]
    assert region.low < q.mean() < region.high
    assert region.high - region.low < 1.2


def test_a_function_without_a_law_takes_the_place_of_a_name_of_its_signal() -> None:
    """A narrow bump looks a little like ripple."""
    search, fit = begun(9, lambda q, qd: 1.5 * np.exp(-(((q - q.mean()) / 0.12) ** 2)))
    columns = fit.rows.samples.columns
    ripple = refined(fit, columns.candidate(effect("torque_ripple"), Site(1), {"order": 6.0}))
    smooth = search.smooth(fit, 1)
    assert smooth is not None
    both = Fit(fit.rows, (*fit.terms, ripple, smooth.candidate))
    for changed in (lawful(search, both), challenged(search, Fit(fit.rows, (*fit.terms, ripple)))):
        left = {c.effect.id for c in changed.terms}
        assert "torque_ripple" not in left
        assert "smooth_torque_over_q" in left


@pytest.mark.parametrize(
    ("torque", "order", "stand"),
    [
        (lambda q: 1.5 * np.exp(-(((q - q.mean()) / 0.25) ** 2)), 6.0, False),
        (lambda q: 0.5 * q + 0.5 * np.sin(20.0 * q), 20.0, True),
    ],
)
def test_two_laws_of_one_signal_stand_where_no_smooth_function_does_as_well(torque, order: float, stand: bool) -> None:
    search, fit = begun(9, lambda q, qd: torque(q))
    columns = fit.rows.samples.columns
    spring = columns.candidate(effect("joint_spring"), Site(1), {})
    ripple = refined(fit, columns.candidate(effect("torque_ripple"), Site(1), {"order": order}))
    changed = lawful(search, Fit(fit.rows, (*fit.terms, spring, ripple)))
    found = {c.effect.id for c in changed.terms} - set(BACKGROUND)
    assert found == ({"joint_spring", "torque_ripple"} if stand else {"smooth_torque_over_q"})


def test_a_law_stands_where_it_acts(dragged: tuple[Search, Fit]) -> None:
    search, fit = dragged
    columns = fit.rows.samples.columns
    drag = columns.candidate(effect("quadratic_drag"), Site(1), {})
    smooth = next(c for c in smooth_candidates(fit.rows.samples, [False, True, False]) if c.effect.id.endswith("_qd"))
    both = Fit(fit.rows, (*fit.terms, drag, smooth))
    assert {c.effect.id for c in lawful(search, both).terms} - set(BACKGROUND) >= {"quadratic_drag"}


def test_a_hum_stands_in_the_model_from_the_start() -> None:
    urdf = arm(7)

    def extra(motion):
        return 0.4 * np.sin(2 * np.pi * 2.9 * motion.t)[:, None] * (np.arange(3) == 1)

    files = ("first.csv", "second.csv")
    recordings = [record(urdf, 7 + k, name=n, duration_s=16.0, rate_hz=125.0, extra=extra) for k, n in enumerate(files)]
    diagnosis = torchrbd.diagnose(urdf, recordings, effects=[*BACKGROUND, "time_delay", "torque_ripple"])
    assert [f.effect for f in diagnosis.findings] == []
    assert [hum.where.recordings for hum in diagnosis.unexplained] == [(name,) for name in files]
    for hum, name in zip(diagnosis.unexplained, files, strict=True):
        assert hum.joints == (joint_names(urdf)[1],)
        assert hum.where.region is not None
        (band,) = hum.where.region
        assert band.signal == "frequency"
        assert 0.5 * (band.low + band.high) == pytest.approx(2.9, abs=0.01)
        assert hum.share > 0.4
        assert hum.statement.startswith(("joint2: a hum of 2.90 Hz, 0.39", "joint2: a hum of 2.90 Hz, 0.40"))
        assert hum.statement.endswith(f" high in {name}, is not explained.")
