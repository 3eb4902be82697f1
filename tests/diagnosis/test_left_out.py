"""What left-out blocks say for the terms of a search is what fits that are repeated without them say."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from likelihood.fits import at_joint, candidate, carried, fitted

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.calibration import calibrated
from torchrbd.diagnosis.hypotheses import prior_std
from torchrbd.diagnosis.left_out import count_choices, left_out_evidence, log_evidence
from torchrbd.diagnosis.search import Search, search_effects
from torchrbd.effects import Site, Window, effect
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.likelihood import Likelihood

DRAG, OFFSET, RIPPLE = "quadratic_drag", "torque_offset", "torque_ripple"
DRAGGED = at_joint(0, lambda m: 0.6 * m.qd[:, 0] * np.abs(m.qd[:, 0]))
# Three blocks of a second and a half.
FROM_S, TO_S = 6.0, 10.5
PULLED = at_joint(0, lambda m: 1.2 * ((m.t >= FROM_S) & (m.t < TO_S)))


def with_terms(fit: Likelihood, rows: Rows, terms: Sequence[Candidate]) -> Likelihood:
    return fit.extended([Extra(c.place, rows.features(c), prior_std(fit, rows, c)[0]) for c in terms])


def repeated(fit: Likelihood, rows: Rows, k: int, fold: np.ndarray) -> float:
    """Return log B of a term by dense fits that are repeated without each fold of blocks (B,), a row at a time."""
    g, columns, blocks = fit.gaussian, fit.further(k), np.unique(rows.block)
    prior, shift = g.H - sum(_placed(b.own, b.X @ b.X.T, len(g.h)) for b in g.blocks), g.h.copy()
    for b in g.blocks:
        shift[b.own] -= b.X @ b.y
    along = np.zeros((3, len(blocks)))
    for f in np.unique(fold):
        H, h = prior.copy(), shift.copy()
        for b, index in zip(g.blocks, fit.index, strict=True):
            kept = ~np.isin(rows.block[index], blocks[fold == f])
            X = b.X[:, kept]
            H += _placed(b.own, X @ X.T, len(h))
            h[b.own] += X @ b.y[kept]
        others = np.setdiff1d(np.arange(len(h)), columns)
        z, without = np.linalg.solve(H, h), np.zeros(len(h))
        without[others] = np.linalg.solve(H[np.ix_(others, others)], h[others])
        for b, index in zip(g.blocks, fit.index, strict=True):
            for i, row in enumerate(index):
                at = int(np.searchsorted(blocks, rows.block[row]))
                if fold[at] != f:
                    continue
                a, e = b.X[:, i] @ without[b.own], b.y[i] - b.X[:, i] @ without[b.own]
                f_row = b.X[:, i] @ z[b.own] - a
                along[:, at] += f_row * e, f_row * (e - f_row), f_row**2
    c = along[:2] / np.sqrt(along[2])
    return 0.5 * len(blocks) * math.log(float((c[0] ** 2).sum() / (c[1] ** 2).sum()))


def _placed(own: np.ndarray, block: np.ndarray, n: int) -> np.ndarray:
    H = np.zeros((n, n))
    H[np.ix_(own, own)] = block
    return H


@pytest.mark.parametrize("there", [True, False])
def test_terms_are_judged_as_by_fits_that_are_repeated(there: bool) -> None:
    fit = fitted(DRAGGED if there else None)
    rows = carried(fit)
    terms = [candidate(rows, DRAG, Site(0)), candidate(rows, "rotor_inertia", Site(1))]
    n = len(np.unique(rows.block))
    extended = with_terms(fit, rows, terms)
    found = left_out_evidence(extended, rows, terms)
    for k, one in enumerate(found):
        white, independent = (
            repeated(each, rows, k, np.arange(n) * 8 // n) for each in (extended, extended.least_squares)
        )
        assert white != independent
        assert one == pytest.approx(max(white, independent), rel=1e-3, abs=1e-3)
    assert (found[0] > 5.0) is there
    assert found[1] < 1.0


def test_what_acts_for_a_time_is_fitted_in_its_other_blocks() -> None:
    """All of its blocks left out together, nothing would be known of it."""
    fit = fitted(PULLED)
    rows = carried(fit)
    window = Window(rows.recordings[0], FROM_S, TO_S)
    pull, elsewhere = (
        candidate(rows, OFFSET, Site(0, window=one)) for one in (window, Window(rows.recordings[0], 12.0, 16.5))
    )
    first, other = left_out_evidence(with_terms(fit, rows, [pull, elsewhere]), rows, [pull, elsewhere])
    assert first > 0.0 > other


def test_the_choice_of_a_shape_and_of_a_window_is_paid_for() -> None:
    fit = fitted(PULLED)
    rows = carried(fit)
    of_blocks, name = [rows.recordings[0]] * 9, rows.recordings[0]
    assert count_choices(candidate(rows, OFFSET, Site(0)), rows.columns, of_blocks) == 1
    for window, count in ((Window(name, 5.0, 9.0), 36), (Window(name, 5.0), 16)):
        assert count_choices(candidate(rows, OFFSET, Site(0, window=window)), rows.columns, of_blocks) == count
    ripple = candidate(rows, RIPPLE, Site(1), order=3.0)
    shapes = len(list(ripple.effect.shapes(rows.columns.scale(Site(1)))))
    assert count_choices(ripple, rows.columns, of_blocks) == shapes > 1


def test_predictions_that_do_not_differ_say_nothing() -> None:
    assert log_evidence(np.zeros(4), np.zeros(4)) == 0.0
    assert log_evidence(np.array([1.0, 1.0, 0.3]), np.array([1.0, 1.0, 1e-30])) == pytest.approx(
        log_evidence(np.ones(2), np.ones(2))
    )


def test_what_left_out_blocks_reject_is_not_tried_again_and_is_an_unlikely_rival() -> None:
    """With the law of a drag rejected, its power law is found; the drag has what blocks gave for it."""
    fit, effects = fitted(DRAGGED), [effect(e) for e in (DRAG, "power_law_friction", "rotor_inertia")]
    found = search_effects(fit, effects, lambda *_: None)
    (drag,) = (t.own for t in found.terms)
    assert drag.name == (DRAG, Site(0))
    search = Search(found.rows, effects, found.discrepancy, rejected={(drag.name, None): -2.0})
    chosen, _ = search.improve([], search.rank([]))
    assert [h.name for h in chosen] == [("power_law_friction", Site(0))]
    (term, *_) = search.terms(chosen)
    (rival,) = (h for h in term.rivals if h.name == drag.name)
    assert calibrated(rival.log_evidence) == pytest.approx(-2.0)
