"""Shapes of leading hypotheses: Gauss-Newton steps against a search on a dense grid."""

import numpy as np
import pytest
from likelihood.fits import Motion, at_joint, fitted
from scipy.optimize import minimize

from torchrbd.diagnosis.hypotheses import Hypothesis, hypothesis_of, rows_with_load
from torchrbd.diagnosis.screening import screen
from torchrbd.diagnosis.sharpening import best_shape, find_summit, shape_stds
from torchrbd.effects import Site
from torchrbd.effects.registry import effect

DEAD_CENTRE, RATIO = 0.37, 0.68


def spring(m: Motion) -> np.ndarray:
    """The torque of a counterbalance on a crank: a spring's and a constant force's, at the lever of a triangle."""
    angle = m.q[:, 0] - DEAD_CENTRE
    lever = RATIO * np.sin(angle) / np.sqrt(1.0 + RATIO**2 - 2.0 * RATIO * np.cos(angle))
    return 4.0 * RATIO * np.sin(angle) - 1.5 * lever


@pytest.fixture(scope="module")
def case():
    fit = fitted(at_joint(0, spring))
    rows = rows_with_load(fit)
    (coarse,) = (h for h in screen(fit, rows, [effect("counterbalance")]) if h.candidate.site == Site(0))
    return fit, rows, coarse


def best_of(case) -> Hypothesis:
    fit, rows, coarse = case
    return best_shape(fit, rows, coarse)


def test_summit_is_that_of_a_general_optimiser(case) -> None:
    fit, rows, coarse = case
    best = find_summit(fit, rows, coarse)

    def loss(x: np.ndarray) -> float:
        shape = dict(zip(("dead_centre", "crank_ratio"), x.tolist(), strict=True))
        return -hypothesis_of(fit, rows, rows.columns.candidate(coarse.candidate.effect, Site(0), shape)).log_evidence

    start = [best.candidate.shape[name] for name in ("dead_centre", "crank_ratio")]
    found = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-3})
    assert best.log_evidence > -found.fun - 0.5
    assert best.log_evidence > hypothesis_of(fit, rows, coarse.candidate).log_evidence + 1.0
    # What averaging over the grid has cost stays paid.
    assert (best.paid, best.tried) == (coarse.paid, coarse.tried)


def test_best_shape_is_the_true_one_and_has_more_evidence(case) -> None:
    fit, rows, coarse = case
    best = best_of(case)
    assert best.candidate.shape["dead_centre"] == pytest.approx(DEAD_CENTRE, abs=0.05)
    assert best.candidate.shape["crank_ratio"] == pytest.approx(RATIO, abs=0.05)
    at_grid = hypothesis_of(fit, rows, coarse.candidate)
    assert best.log_evidence - best.paid > at_grid.log_evidence + 1.0


def test_hypotheses_without_a_shape_stay(case) -> None:
    fit, rows, _ = case
    (one,) = (h for h in screen(fit, rows, [effect("joint_spring")]) if h.candidate.site == Site(0))
    best = best_shape(fit, rows, one)
    assert best.candidate == one.candidate
    assert best.log_evidence == pytest.approx(one.log_evidence, abs=1e-9)


def test_what_a_fit_tells_of_shapes_holds_the_truth(case) -> None:
    fit, rows, _ = case
    best = best_of(case)
    model = fit.extended([best.extra(fit, rows)]).refit
    (found,) = shape_stds(model, rows, [best.candidate]).values()
    assert set(found) == {"dead_centre", "crank_ratio"}
    for name, truth in (("dead_centre", DEAD_CENTRE), ("crank_ratio", RATIO)):
        assert abs(best.candidate.shape[name] - truth) < 3.0 * found[name]
        assert 0.0 < found[name] < 0.1
