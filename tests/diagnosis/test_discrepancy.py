"""The discrepancy: curves that the data need, the noise that they leave, and none where noise is all there is."""

from __future__ import annotations

import numpy as np
import pytest
from likelihood.fits import Motion, at_joint, carried, fitted

from torchrbd.diagnosis.curve_hypotheses import curvature_directions, is_of_time
from torchrbd.diagnosis.discrepancy import Discrepancy, learn_discrepancy
from torchrbd.effects.smooth_torque import HUM
from torchrbd.likelihood.likelihood import Likelihood


def bump(m: Motion) -> np.ndarray:
    return 1.5 * np.exp(-(((m.q[:, 0] - np.median(m.q[:, 0])) / 0.15) ** 2))


def tone(m: Motion) -> np.ndarray:
    return 0.3 * np.sin(2 * np.pi * 6.3 * m.t)


BUMP, TONE = at_joint(0, bump), at_joint(0, tone)


def learnt(fit: Likelihood) -> Discrepancy:
    return learn_discrepancy(fit, carried(fit))


def places(found: Discrepancy) -> set[tuple[str, int | None]]:
    return {(h.candidate.effect.id, h.candidate.site.joint) for h in found.curves if not is_of_time(h.candidate)}


def test_where_nothing_is_missing_there_are_no_curves_and_the_noise_is_as_before() -> None:
    fit = fitted()
    found = learnt(fit)
    assert places(found) == set()
    for new, old in zip(found.fit.hyper.noise, fit.hyper.noise, strict=True):
        assert new.std == pytest.approx(old.std, rel=0.05)


def test_torque_without_a_law_is_a_curve_and_not_noise() -> None:
    """With the curve in the model the noise is that of a robot that lacks nothing."""
    fit, plain = fitted(BUMP), fitted()
    found = learnt(fit)
    assert places(found) == {("smooth_torque_over_q", 0)}
    assert fit.hyper.noise[0].std > 3.0 * plain.hyper.noise[0].std
    assert found.fit.hyper.noise[0].std == pytest.approx(plain.hyper.noise[0].std, rel=0.15)
    assert found.fit.extra == ()
    whole, base = found.fit.extended(found.extra), found.fit
    assert whole.log_evidence > base.log_evidence + 100.0


def test_a_tone_is_none_of_the_colours_of_the_noise() -> None:
    found = learnt(fitted(TONE))
    tones = [h for h in found.curves if h.candidate.effect is HUM]
    assert {h.candidate.site.joint for h in tones} == {0}
    assert tones[0].candidate.shape["frequency"] == pytest.approx(6.3, abs=0.02)
    assert not is_of_time(tones[0].candidate)


def test_curvature_holds_no_straight_line() -> None:
    """What is linear in the signal has no share of it; line and curvature together are the whole curve."""
    fit = fitted(BUMP)
    found, rows = learnt(fit), carried(fit)
    (curve,) = (h for h in found.curves if h.candidate.effect.id == "smooth_torque_over_q")
    line = np.linspace(-1.0, 1.0, len(curve.coefficients))
    basis = np.concatenate((curvature_directions(curve), line[None] / np.linalg.norm(line)))
    np.testing.assert_allclose(basis @ basis.T, np.eye(len(line)), atol=1e-12)
    q = rows.q[0]
    inside = (q > np.quantile(q, 0.02)) & (q < np.quantile(q, 0.98))
    straight = line @ curve.extra(fit, rows).features
    assert abs(np.corrcoef(straight[inside], q[inside])[0, 1]) > 1.0 - 1e-6
