"""Check stretches of time, and recordings, in which something acts against sums over their rows."""

from __future__ import annotations

import numpy as np
import pytest
from likelihood.arms import recorded, rows_of, wrong_robot
from likelihood.fits import BEGIN_S, OPTIONS, URDF, candidate, carried, fitted, payload, with_friction
from scipy.special import logsumexp

from torchrbd.diagnosis.hypotheses import averaged, told
from torchrbd.diagnosis.stretches import Stretches, in_recordings, in_stretches
from torchrbd.effects import JointScale, Shape, Site, Window
from torchrbd.effects.registry import effect
from torchrbd.effects.stribeck_friction import StribeckFriction
from torchrbd.likelihood.gaussian import added
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.rows import Rows
from torchrbd.likelihood.sizes import coefficient_std


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
    (found,) = in_stretches(fit, rows, c, [stretches])
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
    assert [(h.candidate.joint, h.candidate.site.recordings) for h in found] == [
        (j, (one,)) for j in (0, 1) for one in ("first", "second")
    ]
    for h in found:
        j, (one,) = h.candidate.joint, h.candidate.site.recordings
        every, shapes = list[float](), e.shapes(rows.columns.scale(Site(j)))
        for shape in shapes:
            always = candidate(rows, name, Site(j), **shape)
            F = rows.features(always)
            std, scales = coefficient_std(always, F, fit.machine.torque_rms)
            inside = (rows.recording == rows.recordings.index(one))[fit.index[j]]
            S, r = fit.gaussian.beside({j: fit.hyper.noise[j].white(F) * inside})
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
