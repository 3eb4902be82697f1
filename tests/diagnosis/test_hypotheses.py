"""Check the evidence of hypotheses: of injected effects, of none, and of stretches of time against brute force."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from likelihood.arms import arm_urdf, friction, recorded, rows_of, wrong_robot
from likelihood.fits import (
    COULOMB,
    OPTIONS,
    URDF,
    VISCOUS,
    WIDTH,
    at_joint,
    candidate,
    carried,
    fitted,
    with_friction,
)
from scipy.special import logsumexp
from simulated import Motion, inverse_dynamics, joint_names

from torchrbd.diagnosis.hypotheses import Hypothesis, again, averaged, told
from torchrbd.diagnosis.ranking import _ranked
from torchrbd.diagnosis.screening import ORDINARY, refined, screened
from torchrbd.diagnosis.search import sharpened, with_own_noise
from torchrbd.diagnosis.stretches import Stretches, in_recordings, in_stretches
from torchrbd.likelihood.gaussian import added
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.rows import Rows
from torchrbd.likelihood.shapes import axes
from torchrbd.likelihood.sizes import coefficient_std
from torchrbd.physics import JointScale, Shape, Site, Window
from torchrbd.physics.registry import effect, effects
from torchrbd.physics.stribeck_friction import StribeckFriction

ALL = list(effects().values())
FOR_A_TIME, SHIFTS = {"payload", "external_wrench"}, {"time_delay", "actuator_lag"}
BEGIN_S, MASS, CENTRE = 10.3, 0.5, np.array([0.05, 0.1, 0.1])


def rotor(m: Motion) -> np.ndarray:
    return 0.05 * m.qdd[:, 1]


def stribeck(m: Motion) -> np.ndarray:
    return 0.6 * np.tanh(m.qd[:, 0] / WIDTH) * np.exp(-((m.qd[:, 0] / 0.3) ** 2))


def ripple(m: Motion) -> np.ndarray:
    return 0.08 * np.sin(17.4 * m.q[:, 1] + 0.7)


def payload(m: Motion) -> np.ndarray:
    """Return what a point mass on the last link adds from ``BEGIN_S`` on, by Pinocchio."""
    model = pin.buildModelFromXML(URDF)
    model.inertias[2] = model.inertias[2] + pin.Inertia(MASS, CENTRE, np.zeros((3, 3)))
    data = model.createData()
    loaded = np.stack([pin.rnea(model, data, *row).copy() for row in zip(m.q, m.qd, m.qdd, strict=True)])
    return (loaded - inverse_dynamics(URDF, m)) * (m.t >= BEGIN_S)[:, None]


ROTOR, STRIBECK, RIPPLE = at_joint(1, rotor), at_joint(0, stribeck), at_joint(1, ripple)


def leading(torque) -> tuple[Likelihood, Rows, list[Hypothesis]]:
    fit = fitted(torque)
    rows = carried(fit)
    return fit, rows, screened(fit, rows, ALL)


def test_nothing_has_evidence_where_nothing_is() -> None:
    fit, rows, found = leading(None)
    assert len(found) > 40
    assert all(h.log_evidence < 8.0 for h in found)
    assert all(with_own_noise(fit, rows, sharpened(fit, rows, h)).log_evidence < 8.0 for h in found[:5])
    assert [h.log_evidence for h in found] == sorted((h.log_evidence for h in found), reverse=True)
    names = {h.name for h in found}
    assert not {name for name, _ in names} & set(ORDINARY)
    # Every model has an offset of the clocks.
    assert {site for name, site in names if name in SHIFTS} == {Site(0), Site(1)}
    # What comes and goes, and what comes and stays, are two.
    twice = Counter(h.name for h in found)
    assert {name for name, count in twice.items() if count > 1} == {n for n in names if n[0] in FOR_A_TIME}
    assert max(twice.values()) == 2


def test_widths_are_told_anew_where_columns_are_and_elsewhere_those_of_the_other_model() -> None:
    fit = fitted()
    rows = carried(fit)
    h = next(h for h in screened(fit, rows, ALL) if h.candidate.place is not None)
    extra = h.extra(fit, rows)
    assert extra.joints == [h.candidate.place]
    other = fit.with_(rest_width=3.0 * fit.hyper.rest_width)
    found = fit.extended((extra,)).settled_beside(other, extra.joints).hyper.rest_width
    elsewhere = np.arange(len(found)) != h.candidate.place
    np.testing.assert_array_equal(found[elsewhere], other.hyper.rest_width[elsewhere])
    assert found[h.candidate.place] < 0.7 * other.hyper.rest_width[h.candidate.place]


def test_what_shifts_the_only_joint_is_the_clock() -> None:
    urdf = arm_urdf(0, 1)
    recording = recorded(urdf, 2, friction(VISCOUS[:1], COULOMB[:1], WIDTH), **OPTIONS)
    fit = learn(Machine(rows_of(wrong_robot(urdf, 1), [recording])))
    names = {h.candidate.effect.id for h in screened(fit, carried(fit), ALL)}
    assert "torque_offset" in names
    assert not names & SHIFTS


def test_a_noise_that_suits_both_models_is_evidence_for_neither() -> None:
    """A base that has settled with a worse noise has the larger model's as well."""
    fit = fitted()
    rows, worse = carried(fit), fit.extended(fit.extra)
    h = screened(fit, rows, ALL)[0]
    louder = fit.settled.with_(noise=tuple(replace(n, sigma=1.3 * n.sigma) for n in fit.settled.hyper.noise))
    worse.__dict__["settled"] = louder
    assert fit.settled.log_evidence - louder.log_evidence > 20.0
    expected = with_own_noise(fit, rows, h).log_evidence
    assert with_own_noise(worse, rows, h).log_evidence == pytest.approx(expected, abs=1.0)


@pytest.mark.parametrize(
    ("name", "joint", "torque"),
    [("rotor_inertia", 1, ROTOR), ("stribeck_friction", 0, STRIBECK), ("torque_ripple", 1, RIPPLE)],
)
def test_injected_effect_is_first_with_large_evidence(name: str, joint: int, torque) -> None:
    fit, rows, found = leading(torque)
    best = [with_own_noise(fit, rows, sharpened(fit, rows, h)) for h in found[:3]]
    assert best[0].name == (name, Site(joint))
    assert best[0].log_evidence > max(30.0, *(h.log_evidence + 20 for h in best[1:]))
    c = best[0]
    match name:
        case "rotor_inertia":
            assert abs(c.coefficients[0] - 0.05) < 4 * c.std[0]
        case "stribeck_friction":
            assert abs(c.coefficients[1] - 0.6) < 4 * c.std[1]
            assert c.candidate.shape["stribeck_speed"] == pytest.approx(0.3, rel=0.15)
        case "torque_ripple":
            assert c.candidate.shape["order"] == pytest.approx(17.4, abs=0.1)
            assert np.hypot(*c.coefficients) == pytest.approx(0.08, rel=0.1)


def test_load_that_is_taken_up_is_found_with_its_time() -> None:
    fit, rows, found = leading(payload)
    assert found[0].name == ("payload", Site(body=1))
    best = with_own_noise(fit, rows, sharpened(fit, rows, found[0]))
    assert best.log_evidence > 30
    window = best.candidate.site.window
    assert window is not None
    assert window.start_s == pytest.approx(BEGIN_S, abs=0.1)
    assert window.end_s > 19.0
    # Edges near the best one share its evidence, and are paid for.
    assert best.tried == found[0].tried
    alone = told(fit, rows, refined(fit, rows, found[0]).candidate)
    assert alone is not None
    assert refined(fit, rows, found[0]).log_evidence < alone.log_evidence - 2.0
    assert abs(best.coefficients[0] - MASS) < 4 * best.std[0]


def test_refining_comes_nearer_to_the_truth_than_the_grid() -> None:
    fit, rows, found = leading(RIPPLE)
    coarse, fine = found[0], refined(fit, rows, found[0])
    assert fine.tried == coarse.tried
    assert abs(fine.candidate.shape["order"] - 17.4) < abs(coarse.candidate.shape["order"] - 17.4)
    assert abs(fine.log_evidence - coarse.log_evidence) < 6.0


def test_refined_cell_replaces_the_grids_best() -> None:
    """The average is over the grid as before, and where its best one was over the values of the cell around it."""
    fit, rows, found = leading(RIPPLE)
    h, c = found[0], found[0].candidate

    def evidence(order: float) -> float:
        one = told(fit, rows, rows.columns.candidate(c.effect, c.site, {"order": order}))
        assert one is not None
        return one.log_evidence

    grid = [s["order"] for s in c.effect.shapes(rows.columns.scale(c.site))]
    low, high = axes(rows.columns, c)["order"].limits(c.shape["order"])
    cell = logsumexp([evidence(v) for v in np.linspace(low, high, 9)]) - np.log(9)
    others = [evidence(v) for v in grid if v != c.shape["order"]]
    expected = logsumexp([*others, cell]) - np.log(len(grid))
    assert refined(fit, rows, h).log_evidence == pytest.approx(expected, abs=1e-6)


def test_refining_what_says_nothing_gains_nothing() -> None:
    """Of two shapes that are alike, and as good as none, a finer cell makes no better hypothesis."""
    fit = fitted()
    rows = carried(fit)
    for h in screened(fit, rows, [effect("one_sided_spring"), effect("stribeck_friction")]):
        if abs(h.log_evidence) < 3:
            assert refined(fit, rows, h).log_evidence < h.log_evidence + 0.3


def test_shapes_that_were_tried_are_paid_for() -> None:
    """log B is that of the mean of B over shapes and sizes, and not more than that of the best shape."""
    fit, rows, found = leading(RIPPLE)
    h, c = found[0], found[0].candidate
    shapes = c.effect.shapes(rows.columns.scale(c.site))
    each = [told(fit, rows, rows.columns.candidate(c.effect, c.site, s)) for s in shapes]
    assert h.tried == len(shapes) == len(each)
    evidence = [one.log_evidence for one in each if one is not None]
    assert h.log_evidence == pytest.approx(logsumexp(evidence) - np.log(len(evidence)), abs=1e-6)
    assert h.log_evidence < max(evidence)


@pytest.mark.parametrize("torque", [RIPPLE, payload], ids=["shapes", "windows"])
def test_what_averaging_has_cost_stays_paid_beside_another_fit(torque) -> None:
    fit, rows, found = leading(torque)
    # Stretches are screened without the edges of what begins and ends in them.
    always = [h for h in found if h.candidate.site.always]
    for h in (*always[:5], refined(fit, rows, found[0])):
        one, alone = again(fit, rows, h), told(fit, rows, h.candidate)
        assert one is not None
        assert alone is not None
        assert one.candidate == h.candidate
        assert (one.tried, one.paid) == (h.tried, h.paid)
        # Beside the fit in which it was averaged, it is what it was.
        assert one.log_evidence == pytest.approx(h.log_evidence, abs=1e-6)
        assert h.paid == pytest.approx(h.log_evidence - alone.log_evidence, abs=1e-6)
    best = found[0]
    # No more than if one of all that were tried had all the evidence; of windows there are two kinds.
    assert -np.log(2 * best.tried) - 1e-9 <= best.paid < 0.0
    left = again(fit.extended([best.extra(fit, rows)]), rows, best)
    assert left is not None
    assert left.log_evidence < 0.0
    assert left.paid == best.paid


def test_what_averaging_has_cost_stays_paid_where_shape_and_noise_are_learnt_anew() -> None:
    fit, rows, found = leading(RIPPLE)
    sharp = sharpened(fit, rows, found[0])
    one = again(fit, rows, sharp)
    assert one is not None
    assert one.log_evidence == pytest.approx(sharp.log_evidence, abs=1e-6)
    # Nine values of the one shape lie in a cell.
    assert -np.log(9 * sharp.tried) - 1e-9 <= sharp.paid < 0.0
    assert with_own_noise(fit, rows, sharp).paid == sharp.paid


def test_what_has_no_torque_beside_another_fit_is_no_hypothesis_there() -> None:
    _, _, found = leading(RIPPLE)
    silent = recorded(URDF, 2, with_friction(), missing=[joint_names(URDF)[1]], **OPTIONS)
    other = learn(Machine(rows_of(wrong_robot(URDF, 1), [silent])))
    assert again(other, carried(other), found[0]) is None


def test_size_is_averaged_over() -> None:
    fit, rows, found = leading(ROTOR)
    c = found[0].candidate
    F = rows.features(c)
    std, scales = coefficient_std(c, F, fit.machine.torque_rms)
    each = [added(*fit.beside(1, F), std * k, positive=(0,)).log_evidence for k in scales]
    assert found[0].log_evidence == pytest.approx(logsumexp(each) - np.log(len(scales)), abs=1e-6)
    assert found[0].scale == scales[int(np.argmax(each))]


@pytest.fixture(scope="module")
def two_recordings() -> tuple[Likelihood, Rows]:
    """Return a fit of two recordings, a load in the second one."""
    first = recorded(URDF, 3, with_friction(), name="first", **{**OPTIONS, "duration_s": 8.0})
    second = recorded(URDF, 4, with_friction(payload), name="second", **{**OPTIONS, "duration_s": 14.0})
    fit = learn(Machine(rows_of(wrong_robot(URDF, 1), [first, second])))
    return fit, carried(fit)


def test_stretches_are_sums_of_their_blocks(two_recordings: tuple[Likelihood, Rows]) -> None:
    """Each stretch is judged as its whitened columns are, zero outside of it, beside the fit."""
    fit, rows = two_recordings
    c = candidate(rows, "payload", Site(body=1, window=Window("second")))
    stretches = Stretches.of_blocks(rows, "second")
    F, always = rows.features(c), candidate(rows, "payload", Site(body=1))
    std, scales = coefficient_std(always, rows.features(always), fit.machine.torque_rms)
    expected, best = [], -np.inf
    for begin, end in stretches.times[stretches.pairs]:
        inside = (rows.t >= begin) & (rows.t < end) & (rows.recording == 1)
        columns = {j: fit.hyper.noise[j].white(F[:, j]) * inside[i] for j, i in enumerate(fit.index)}
        S, r = fit.gaussian.beside(columns)
        own = [added(S, r, k * std, c.effect.prior.positive).log_evidence for k in scales]
        expected, best = expected + own, max(best, logsumexp(own) - np.log(len(own)))
    found = in_stretches(fit, rows, c, stretches)
    assert found is not None
    got, one = found
    assert one == pytest.approx(best, abs=1e-6)
    assert got.tried == len(stretches.pairs) == len(expected) // len(scales)
    assert got.log_evidence == pytest.approx(logsumexp(expected) - np.log(len(expected)), abs=1e-6)
    window = got.candidate.site.window
    assert window is not None
    assert window.recording == "second"
    assert window.start_s == pytest.approx(BEGIN_S, abs=1.0)
    # A load is believed to be as heavy, however long it is carried.
    np.testing.assert_allclose(got.extra(fit, rows).std, got.scale * std)
    for begin, end in ((1.0, 3.0), (-np.inf, np.inf)):
        one = told(fit, rows, candidate(rows, "payload", Site(body=1, window=Window("second", begin, end))))
        assert one is not None
        np.testing.assert_allclose(one.extra(fit, rows).std, one.scale * std)


@pytest.mark.parametrize("name", ["coulomb_friction", "stribeck_friction"])
def test_recordings_in_which_an_effect_is_are_averaged_over(two_recordings: tuple[Likelihood, Rows], name: str) -> None:
    """Each set of them is judged as whitened columns are, zero in the others, beside the fit."""
    fit, rows = two_recordings
    e, found = effect(name), [h for h in in_recordings(fit, rows, effect(name)) if h is not None]
    assert [h.candidate.site.joint for h in found] == [0, 1]
    for h in found:
        j = h.candidate.joint
        each: dict[str, list[float]] = {"first": [], "second": []}
        shapes = e.shapes(rows.columns.scale(Site(j)))
        for shape in shapes:
            always = candidate(rows, name, Site(j), **shape)
            F = rows.features(always)
            std, scales = coefficient_std(always, F, fit.machine.torque_rms)
            for one, evidence in each.items():
                inside = (rows.recording == rows.recordings.index(one))[fit.index[j]]
                S, r = fit.gaussian.beside({j: fit.hyper.noise[j].white(F) * inside})
                evidence += [added(S, r, k * std, e.prior.positive).log_evidence for k in scales]
        every = [x for evidence in each.values() for x in evidence]
        assert h.log_evidence == pytest.approx(logsumexp(every) - np.log(len(every)), abs=1e-6)
        assert h.tried == 2 * len(shapes)
        assert h.candidate.site.recordings == (max(each, key=lambda one: max(each[one])),)
        # Its columns are the effect's there, and zero elsewhere.
        features, elsewhere = rows.features(h.candidate), rows.recordings.index(h.candidate.site.recordings[0])
        assert features[:, rows.recording == elsewhere].any()
        assert not features[:, rows.recording != elsewhere].any()


def test_one_recording_has_no_parts_and_what_robots_are_built_of_is_in_all(
    two_recordings: tuple[Likelihood, Rows],
) -> None:
    fit = fitted()
    assert list(in_recordings(fit, carried(fit), effect("coulomb_friction"))) == []
    assert list(in_recordings(*two_recordings, effect("rotor_inertia"))) == []


def test_effect_without_shapes_is_no_hypothesis_in_some_recordings(two_recordings: tuple[Likelihood, Rows]) -> None:
    """Motion may be too slow for any bump at rest, or a temperature not recorded."""

    class Slow(StribeckFriction):
        def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
            return ()

    fit, rows = two_recordings
    assert [h for h in in_recordings(fit, rows, Slow()) if h is not None] == []
    assert averaged(fit, rows, []) is None


def test_stretches_cover_most_of_a_single_recording_at_most(two_recordings: tuple[Likelihood, Rows]) -> None:
    rows = carried(fitted())
    stretches = Stretches.of_blocks(rows, rows.recordings[0])
    n = len(stretches.times) - 1
    longest = int(0.9 * n)
    expected = {(a, b) for a in range(n) for b in range(a + 1, min(a + longest, n) + 1)}
    assert set(map(tuple, stretches.pairs.tolist())) == expected
    assert longest < n
    assert (np.diff(stretches.times) > 0).all()
    whole = Stretches.of_blocks(two_recordings[1], "second")
    assert (0, len(whole.times) - 1) in set(map(tuple, whole.pairs.tolist()))


def test_window_is_located_between_rows() -> None:
    rows = carried(fitted())
    name = rows.recordings[0]
    for window in (Window(name, 6.0, 9.0), Window(name, 6.0), Window(name)):
        near = Stretches.near(rows, window)
        begin, end = near.times[near.pairs].T
        assert (end > begin).all()
        reach = 2.0 * np.ptp(rows.t) / len(np.unique(rows.block))
        for edge, now in ((begin, window.start_s), (end, window.end_s)):
            assert (edge == now).all() if np.isinf(now) else (np.abs(edge - now) <= reach + 1e-9).all()
        if np.isfinite(window.start_s):
            assert np.diff(np.unique(begin)).max() == pytest.approx(2 * rows.dt_out)


def test_joint_without_torque_has_no_hypotheses() -> None:
    silent = joint_names(URDF)[1]
    recording = recorded(URDF, 2, with_friction(), missing=[silent], **OPTIONS)
    fit = learn(Machine(rows_of(wrong_robot(URDF, 1), [recording])))
    rows = carried(fit)
    found = screened(fit, rows, ALL)
    assert len(found) > 15
    own = [h for h in found if h.candidate.site.joint == 1 and not h.candidate.effect.whole_robot]
    assert not own
    assert all(np.isfinite(h.log_evidence) for h in found)
    for h in found:
        F = rows.features(h.candidate)
        j = 0 if h.candidate.place is None else h.candidate.place
        assert np.any(F[:, j] if h.candidate.place is None else F), h.name
        assert np.isfinite(list(_ranked(h, fit, rows.columns.robot).parameters.values())).all()
    assert ("time_delay", Site(1)) not in {h.name for h in found}
    assert ("time_delay", Site(0)) in {h.name for h in found}
    assert all(h.log_evidence < 8.0 for h in found)


def test_effect_without_features_is_no_hypothesis() -> None:
    fit = fitted()
    rows = carried(fit)
    c = candidate(
        rows,
        "thermal_viscosity",
        Site(0),
        **dict(effect("thermal_viscosity").shapes(replace(rows.columns.scales[0], temperature=(20.0, 30.0)))[0]),
    )
    assert told(fit, rows, c) is None
