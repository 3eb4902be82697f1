"""The discrepancy: curves that the data need, the noise that they leave, and none where noise is all there is."""

from __future__ import annotations

import numpy as np
import pytest
from likelihood.arms import Torque
from likelihood.fits import WIDTH, Motion, at_joint, carried, fitted

from torchrbd.diagnosis.curve_hypotheses import curvature_directions, is_of_time
from torchrbd.diagnosis.discrepancy import Discrepancy, learn_discrepancy
from torchrbd.effects.smooth_torque import HUM


def bump(m: Motion) -> np.ndarray:
    return 1.5 * np.exp(-(((m.q[:, 0] - np.median(m.q[:, 0])) / 0.15) ** 2))


def tone(m: Motion) -> np.ndarray:
    return 0.3 * np.sin(2 * np.pi * 6.3 * m.t)


def sticky(m: Motion) -> np.ndarray:
    return 2.0 * np.exp(-(((m.q[:, 0] - 0.2) / 0.15) ** 2)) * np.tanh(m.qd[:, 0] / WIDTH)


def drag(m: Motion) -> np.ndarray:
    return 3.0 * m.qd[:, 0] * np.abs(m.qd[:, 0])


BUMP, TONE, STICKY, DRAG = (at_joint(0, one) for one in (bump, tone, sticky, drag))


def places(found: Discrepancy) -> set[tuple[str, int | None]]:
    return {(h.candidate.effect.id, h.candidate.site.joint) for h in found.curves if not is_of_time(h.candidate)}


def test_where_nothing_is_missing_there_are_no_curves_and_the_noise_is_as_before() -> None:
    fit = fitted()
    found = learn_discrepancy(fit)
    assert places(found) == set()
    for new, old in zip(found.fit.hyper.noise, fit.hyper.noise, strict=True):
        assert new.std == pytest.approx(old.std, rel=0.05)


def test_torque_without_a_law_is_a_curve_and_not_noise() -> None:
    """With the curve in the model the noise is that of a robot that lacks nothing."""
    fit, plain = fitted(BUMP), fitted()
    found = learn_discrepancy(fit)
    assert places(found) == {("smooth_torque_over_q", 0)}
    assert fit.hyper.noise[0].std > 3.0 * plain.hyper.noise[0].std
    assert found.fit.hyper.noise[0].std == pytest.approx(plain.hyper.noise[0].std, rel=0.15)
    assert found.fit.extra == ()
    whole, base = found.fit.extended(found.extra), found.fit
    assert whole.log_evidence > base.log_evidence + 100.0


@pytest.mark.parametrize(("more", "curve"), [(DRAG, "smooth_torque_over_qd"), (STICKY, "smooth_friction_over_q")])
def test_what_is_missing_does_not_change_the_speed_at_which_friction_changes_its_sign(more: Torque, curve: str) -> None:
    """The machine alone explains a part of it by friction that changes its sign earlier, or later."""
    fit = fitted(more)
    found = learn_discrepancy(fit)
    assert (curve, 0) in places(found)
    assert abs(np.log(fit.hyper.rest_width[0] / WIDTH)) > 0.4
    assert found.fit.hyper.rest_width == pytest.approx(WIDTH, rel=0.2), "to a step of the grid"
    assert found.rows.columns.scales[0].rest_width == found.fit.hyper.rest_width[0]


def test_a_tone_is_none_of_the_colours_of_the_noise() -> None:
    found = learn_discrepancy(fitted(TONE))
    tones = [h for h in found.curves if h.candidate.effect is HUM]
    assert {h.candidate.site.joint for h in tones} == {0}
    assert tones[0].candidate.shape["frequency"] == pytest.approx(6.3, abs=0.02)
    assert not is_of_time(tones[0].candidate)


def test_curvature_holds_no_straight_line() -> None:
    """What is linear in the signal has no share of it; line and curvature together are the whole curve."""
    fit = fitted(BUMP)
    found, rows = learn_discrepancy(fit), carried(fit)
    (curve,) = (h for h in found.curves if h.candidate.effect.id == "smooth_torque_over_q")
    line = np.linspace(-1.0, 1.0, len(curve.coefficients))
    basis = np.concatenate((curvature_directions(curve), line[None] / np.linalg.norm(line)))
    np.testing.assert_allclose(basis @ basis.T, np.eye(len(line)), atol=1e-12)
    q = rows.q[0]
    inside = (q > np.quantile(q, 0.02)) & (q < np.quantile(q, 0.98))
    straight = line @ curve.extra(fit, rows).features
    assert abs(np.corrcoef(straight[inside], q[inside])[0, 1]) > 1.0 - 1e-6
