"""Check windows of time, and recordings, in which something acts against sums over their rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import torch
from likelihood.arms import recorded, rows_of, wrong_robot
from likelihood.fits import BEGIN_S, OPTIONS, URDF, candidate, carried, fitted, payload, with_friction
from scipy.special import logsumexp
from simulated import Motion

from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.edges import Edges
from torchrbd.diagnosis.hypotheses import average_over_shapes, hypothesis_of
from torchrbd.diagnosis.windows import Windows, in_recordings, in_windows, place_window, weigh_windows
from torchrbd.effects import JointScale, Shape, Site, Window
from torchrbd.effects.registry import effect
from torchrbd.effects.stribeck_friction import StribeckFriction
from torchrbd.likelihood.coefficient_prior import coefficient_std
from torchrbd.likelihood.gaussian import added
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine


@pytest.fixture(scope="module")
def two_recordings() -> tuple[Likelihood, Rows]:
    """Return a fit of two recordings, a load in the second one."""
    first = recorded(URDF, 3, with_friction(), name="first", **{**OPTIONS, "duration_s": 8.0})
    second = recorded(URDF, 4, with_friction(payload), name="second", **{**OPTIONS, "duration_s": 14.0})
    fit = learn(Machine(rows_of(wrong_robot(URDF, 1), [first, second])))
    return fit, carried(fit)


def test_windows_are_sums_of_their_blocks(two_recordings: tuple[Likelihood, Rows]) -> None:
    """Each stretch is judged as its whitened columns are, zero outside of it, beside the fit."""
    fit, rows = two_recordings
    c = candidate(rows, "payload", Site(body=1, window=Window("second")))
    windows = Windows.of_blocks(rows, "second")
    F, always = rows.features(c), candidate(rows, "payload", Site(body=1))
    std, scales = coefficient_std(always, rows.rms(always), fit.machine.torque_rms)
    expected, best = [], -np.inf
    for begin, end in windows.times[windows.pairs]:
        inside = (rows.t >= begin) & (rows.t < end) & (rows.recording == 1)
        columns = {j: fit.hyper.noise[j].white(F[:, j]) * inside[i] for j, i in enumerate(fit.index)}
        S, r = fit.gaussian.precision_and_score(columns)
        own = [added(S, r, k * std, c.effect.prior.positive).log_evidence for k in scales]
        expected, best = expected + own, max(best, logsumexp(own) - np.log(len(own)))
    (found,) = weigh_windows(Edges(fit, rows, "second"), c, [windows])
    assert found is not None
    got, one = found
    assert one == pytest.approx(best, abs=1e-6)
    assert got.tried == len(windows.pairs) == len(expected) // len(scales)
    assert got.log_evidence == pytest.approx(logsumexp(expected) - np.log(len(expected)), abs=1e-6)
    window = got.candidate.site.window
    assert window is not None
    assert window.recording == "second"
    assert window.start_s == pytest.approx(BEGIN_S, abs=1.0)
    # A load is believed to be as heavy, however long it is carried.
    np.testing.assert_allclose(got.extra(fit, rows).std, got.scale * std)
    for begin, end in ((1.0, 3.0), (-np.inf, np.inf)):
        one = hypothesis_of(fit, rows, candidate(rows, "payload", Site(body=1, window=Window("second", begin, end))))
        assert one is not None
        np.testing.assert_allclose(one.extra(fit, rows).std, one.scale * std)


@pytest.mark.parametrize("name", ["coulomb_friction", "stribeck_friction"])
def test_recordings_in_which_an_effect_is_are_averaged_over(two_recordings: tuple[Likelihood, Rows], name: str) -> None:
    """Each set of them is judged as whitened columns are, zero in the others, beside the fit."""
    fit, rows = two_recordings
    e, found = effect(name), [h for h in in_recordings(fit, rows, effect(name)) if h is not None]
    assert [(h.candidate.joint, h.candidate.site.recordings) for h in found] == [
        (j, (one,)) for j in (0, 1) for one in ("first", "second")
    ]
    for h in found:
        j, (one,) = h.candidate.joint, h.candidate.site.recordings
        every, shapes = list[float](), e.shapes(rows.columns.scale(Site(j)))
        for shape in shapes:
            always = candidate(rows, name, Site(j), **shape)
            F = rows.features(always)
            std, scales = coefficient_std(always, rows.rms(always), fit.machine.torque_rms)
            inside = (rows.recording == rows.recordings.index(one))[fit.index[j]]
            S, r = fit.gaussian.precision_and_score({j: fit.hyper.noise[j].white(F) * inside})
            every += [added(S, r, k * std, e.prior.positive).log_evidence for k in scales]
        # The other one is another hypothesis, and as likely.
        assert h.log_evidence == pytest.approx(logsumexp(every) - np.log(2 * len(every)), abs=1e-6)
        assert h.tried == len(shapes)
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
    assert average_over_shapes(fit, rows, []) is None


@pytest.mark.parametrize(
    ("name", "at"),
    [
        pytest.param(
            *("payload", Site(body=1)),
            marks=pytest.mark.xfail(strict=True, reason=".14 nats apart since the gain of fast motion has two terms"),
        ),
        ("external_wrench", Site(body=1)),
        ("torque_offset", Site(1)),
    ],
    ids=["payload", "external_wrench", "torque_offset"],
)
def test_what_begins_and_ends_at_once_is_told_as_its_rows_are(
    two_recordings: tuple[Likelihood, Rows], name: str, at: Site
) -> None:
    """Moments of steps that are added to those between edges are those of the features themselves."""
    fit, rows = two_recordings
    edges = Edges(fit, rows, "second")
    t = rows.t[edges.inside]
    times = np.concatenate(([-np.inf], t[[40, 141, 250, 333]], [np.inf]))
    for pair in ((1, 2), (1, 4), (2, 3), (0, 3), (2, 5)):
        one = Windows(times, np.array([pair]), at_once=True)
        (found,) = weigh_windows(edges, candidate(rows, name, replace(at, window=Window("second"))), [one])
        assert found is not None
        exact = hypothesis_of(fit, rows, found[0].candidate)
        assert exact is not None
        assert found[0].log_evidence == pytest.approx(exact.log_evidence, rel=0.02, abs=0.1)
        window = found[0].candidate.site.window
        assert window == Window("second", *times[list(pair)])


def test_step_is_the_low_passed_one(two_recordings: tuple[Likelihood, Rows]) -> None:
    fit, rows = two_recordings
    edges = Edges(fit, rows, "second")
    k = int(np.flatnonzero(edges.inside)[200])
    passed = rows.evaluated(lambda signals: signals.inside(Window("second", -np.inf, float(rows.t[k]))))
    np.testing.assert_allclose(passed[k - edges.reach : k + edges.reach + 1], edges.step, atol=1e-9)
    assert passed[k - edges.reach - 1] == pytest.approx(1.0)
    assert passed[k + edges.reach + 1] == pytest.approx(0.0)
    assert not passed[~edges.inside].any()


PUSHED_S, FORCE = (5.13, 8.02), np.array([8.0, -4.0, 6.0])


def pushes(m: Motion) -> np.ndarray:
    """Return the torques (N, 2) of a force at the origin of the last link, by Pinocchio."""
    model = pin.buildModelFromXML(URDF)
    data, found = model.createData(), np.zeros((len(m.t), 2))
    for k in np.flatnonzero((m.t >= PUSHED_S[0]) & (m.t < PUSHED_S[1])):
        pin.computeJointJacobians(model, data, m.q[k])
        J = pin.getJointJacobian(model, data, 2, pin.LOCAL_WORLD_ALIGNED)
        found[k] = -J[:3].T @ FORCE
    return found


def wandering_and_pushed(m: Motion) -> np.ndarray:
    """Return a random walk (N, 2), and a force for a time, about what the walk goes."""
    return pushes(m) + np.cumsum(np.random.default_rng(0).standard_normal((len(m.t), 2)), axis=0) * 0.03


@pytest.fixture(scope="module")
def wandering() -> tuple[Likelihood, Rows]:
    """Return a fit of a recording with strongly coloured noise, in which something pushes for a time."""
    one = recorded(URDF, 5, with_friction(wandering_and_pushed), noise=1e-3, **{**OPTIONS, "duration_s": 14.0})
    fit = learn(Machine(rows_of(wrong_robot(URDF, 1), [one])))
    return fit, carried(fit)


def test_innovations_jump_where_something_begins_and_ends(wandering: tuple[Likelihood, Rows]) -> None:
    fit, rows = wandering
    edges = Edges(fit, rows, rows.recordings[0])
    np.testing.assert_allclose(rows.t[edges.jumps(2)], PUSHED_S, atol=rows.dt_out)
    many = edges.jumps(20)
    assert len(many) == 20
    assert (np.diff(many) > 3).all()
    assert edges.inside[many].all()
    assert len(edges.jumps(len(rows.t))) < len(rows.t)


def test_push_is_found_by_its_edges_where_noise_is_coloured(wandering: tuple[Likelihood, Rows]) -> None:
    """Between them it is one of the ways in which the noise may have gone."""
    fit, rows = wandering
    fit = fit.with_(noise=tuple(replace(n, tail=None) for n in fit.hyper.noise)).levelled()
    name = rows.recordings[0]
    found = [h for h in in_windows(fit, rows, [effect("external_wrench")]) if h is not None]
    best = max(found, key=lambda h: h.log_evidence)
    window = best.candidate.site.window
    np.testing.assert_allclose((window.start_s, window.end_s), PUSHED_S, atol=rows.dt_out)
    c = candidate(rows, "external_wrench", Site(body=best.candidate.site.body, window=Window(name)))
    (gradually,) = weigh_windows(Edges(fit, rows, name), c, [Windows.of_blocks(rows, name)])
    assert gradually is not None
    assert gradually[0].log_evidence < best.log_evidence - 5.0


def test_edges_on_both_sides_of_what_is_held_out_are_apart_by_rows() -> None:
    """Seconds between them that no fit may see do not part what the rows feel."""

    def kept_back(name: str, t: torch.Tensor) -> torch.Tensor:
        return (t > 4.0) & (t < 8.0)

    one = recorded(URDF, 3, with_friction(payload), **{**OPTIONS, "duration_s": 14.0})
    fit = learn(Machine(rows_of(wrong_robot(URDF, 1), [one], kept_back)))
    rows = carried(fit)
    edges, name = Edges(fit, rows, rows.recordings[0]), rows.recordings[0]
    before, behind = rows.t[rows.t < 6.0][-3], rows.t[rows.t > 6.0][2]
    times = np.array([-np.inf, 1.0, before, behind, 12.0, np.inf])
    pairs = [tuple(p) for p in edges.apart(times, np.array([(1, 2), (2, 3), (1, 3), (3, 4), (2, 4)])).tolist()]
    assert pairs == [(1, 2), (1, 3), (3, 4), (2, 4)]
    near = Windows.near(edges, Window(name, before, behind))
    at = edges.at(near.times)
    assert len(near.pairs)
    assert (np.diff(at[near.pairs], axis=1) > 2 * edges.reach).all()
    (found,) = weigh_windows(edges, candidate(rows, "payload", Site(body=1, window=Window(name))), [near])
    assert found is not None


def test_window_is_told_of_those_that_come_gradually_and_at_once(
    two_recordings: tuple[Likelihood, Rows],
) -> None:
    """Both are as likely, of the latter all that are not looked at have no evidence; one end is as likely as two."""
    fit, rows = two_recordings
    edges = Edges(fit, rows, "second")
    both, one = Windows.at_jumps(edges)
    n = int(edges.inside.sum()) // 2
    gradually = Windows.of_blocks(rows, "second"), Windows.with_one_end(rows, "second")
    every = [h for h in in_windows(fit, rows, [effect("payload")]) if h is not None and h.candidate.site.body == 1]
    in_second = [h for h in every if h.candidate.site.window.recording == "second"]
    c = candidate(rows, "payload", Site(body=1, window=Window("second")))
    for h, kinds, count in zip(
        in_second, zip(gradually, (both, one), strict=True), (n * (n - 1) // 2, 2 * n), strict=True
    ):
        soft, sharp = (found[0] for found in weigh_windows(edges, c, kinds) if found is not None)
        looked_at = np.log(len(kinds[1].pairs) / count)
        expected = np.logaddexp(soft.log_evidence, sharp.log_evidence + looked_at) - np.log(4)
        assert h.log_evidence == pytest.approx(expected, abs=1e-6)
        assert h.tried == count
        best = max(soft.log_evidence - soft.paid, sharp.log_evidence - sharp.paid)
        assert h.log_evidence - h.paid == pytest.approx(best, abs=1e-6)
    # It stays, and its edge is told to some rows.
    found = max(every, key=lambda h: h.log_evidence)
    window = found.candidate.site.window
    assert np.isinf(window.start_s) != np.isinf(window.end_s)
    near = place_window(fit, rows, found)
    assert near.candidate.site.window.start_s == pytest.approx(BEGIN_S, abs=2 * rows.dt_out)


def test_located_window_pays_for_all_that_may_be(two_recordings: tuple[Likelihood, Rows]) -> None:
    """Its evidence is the mean over all moments, of which those nearby have any."""
    fit, rows = two_recordings
    edges = Edges(fit, rows, "second")
    h = max((h for h in in_windows(fit, rows, [effect("payload")]) if h is not None), key=lambda h: h.log_evidence)
    near = Windows.near(edges, h.candidate.site.window)
    found = place_window(fit, rows, h)
    (each,) = weigh_windows(edges, candidate(rows, "payload", Site(body=1, window=Window("second"))), [near])
    assert each is not None
    assert found.tried == h.tried
    assert found.paid == pytest.approx(each[0].paid + np.log(len(near.pairs) / h.tried))
    alone = hypothesis_of(fit, rows, found.candidate)
    assert alone is not None
    assert found.log_evidence == pytest.approx(alone.log_evidence + found.paid)


def test_windows_cover_most_of_a_single_recording_at_most(two_recordings: tuple[Likelihood, Rows]) -> None:
    rows = carried(fitted())
    windows = Windows.of_blocks(rows, rows.recordings[0])
    n = len(windows.times) - 1
    longest = int(0.9 * n)
    # What has one end is of another kind.
    expected = {(a, b) for a in range(1, n) for b in range(a + 1, min(a + longest, n - 1) + 1)}
    assert set(map(tuple, windows.pairs.tolist())) == expected
    assert longest < n
    assert (np.diff(windows.times) > 0).all()
    whole = Windows.of_blocks(two_recordings[1], "second")
    assert (0, len(whole.times) - 1) in set(map(tuple, whole.pairs.tolist()))


def test_window_is_located_between_rows() -> None:
    fit = fitted()
    rows = carried(fit)
    name = rows.recordings[0]
    edges = Edges(fit, rows, name)
    for window in (Window(name, 6.0, 9.0), Window(name, 6.0), Window(name)):
        near = Windows.near(edges, window)
        begin, end = near.times[near.pairs].T
        assert (end > begin).all()
        reach = 2.0 * np.ptp(rows.t) / len(np.unique(rows.block))
        for edge, now in ((begin, window.start_s), (end, window.end_s)):
            assert (edge == now).all() if np.isinf(now) else (np.abs(edge - now) <= reach + 1e-9).all()
        if np.isfinite(window.start_s):
            assert np.diff(np.unique(begin)).max() == pytest.approx(2 * rows.dt_out)
            jumps = rows.t[edges.jumps(16)]
            assert set(jumps[np.abs(jumps - window.start_s) < reach]) <= set(begin)
