"""Stability: how often a search finds the same where time is sampled anew.

Each repetition gives every block b of time a weight, and searches anew in the noise of the first search:

    w_b = B g_b / sum_c g_c,   g_b ~ Exp(1)

The log density of a block's rows then counts w_b times. A finding's stability is the share of the repetitions whose
model has the same effect at the same place; if it acts for a time, in an overlapping window.

Source: Rubin, "The Bayesian Bootstrap", Annals of Statistics 1981; Meinshausen and Bühlmann, "Stability selection", J.
    R. Stat. Soc. B 2010.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from torchrbd._runtime.deadline import is_over
from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis.curves import driven_by
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.discrepancy import Discrepancy
from torchrbd.diagnosis.explain import places
from torchrbd.diagnosis.friction import ordinary_friction
from torchrbd.diagnosis.outcome import SearchOutcome
from torchrbd.diagnosis.results import Finding
from torchrbd.diagnosis.search import Search
from torchrbd.effects import Effect
from torchrbd.errors import OptionError
from torchrbd.robot import RobotModel


def check_repetitions(count: object) -> None:
    """Check a number of repetitions.

    Raises:
        OptionError: it is no whole number, or negative.
    """
    if not isinstance(count, int) or isinstance(count, bool) or count < 0:
        raise OptionError(f"stability is {count!r}; expected a number of repetitions, e.g. 20, or 0 for none")


def with_stability(
    findings: Sequence[Finding],
    found: SearchOutcome,
    effects: Sequence[Effect],
    count: int,
    seed: int,
    report: Callable[[float], None] = lambda _: None,
) -> tuple[Finding, ...]:
    """Return findings with their stability, in the same order; as they are, if no repetition could be finished.

    Args:
        findings: of the search. What clocks or second encoders show has none.
        found: what the search found.
        effects: what may be there.
        count: number of repetitions.
        seed: of the weights.
        report: called after each step with the part of the work that is done.
    """
    rng, models = np.random.default_rng(seed), list[list[Candidate]]()
    for k in range(count):
        discrepancy = reweight(found, rng)
        search = Search(found.rows, effects, discrepancy, lambda part, _, k=k: report((k + part) / count))
        model = _find_terms(search)
        if is_over():
            break
        models.append(model)
        report((k + 1) / count)
    robot = found.rows.columns.robot

    def share(one: Finding) -> float | None:
        if not models or one.elpd is None:
            return None
        return float(np.mean([any(_is_same(one, c, robot) for c in model) for model in models]))

    return tuple(replace(one, stability=share(one)) for one in findings)


def reweight(found: SearchOutcome, rng: np.random.Generator) -> Discrepancy:
    """Return the discrepancy of a search with noise in which each block of time has another weight."""
    fit, block = found.discrepancy.fit, np.unique(found.rows.block, return_inverse=True)[1]
    weight = rng.exponential(size=int(block.max()) + 1)
    size = np.sqrt(weight.mean() / weight)[block]
    noise = tuple(replace(one, spread=one.spread * size) for one in fit.hyper.noise)
    return replace(found.discrepancy, fit=fit.with_(noise=noise))


def _find_terms(search: Search) -> list[Candidate]:
    """Return the terms of the model that a search finds, with the baseline friction that is likelier than not."""
    chosen, _ = search.improve([], search.rank([]))
    fit, laws = search.fit(chosen), [h.candidate for h in chosen]
    without_curves, may = fit.extended(fit.extra[: len(chosen)]), [e.id for e in search.effects]
    friction = ordinary_friction(without_curves, search.rows.columns, may, laws)
    return [*laws, *(one.candidate for one in friction if one.probability > DECISIONS.likely)]


def _is_same(one: Finding, c: Candidate, robot: RobotModel) -> bool:
    """Say whether a finding and a term are one effect at one place, at times that overlap."""
    if (one.effect, (one.joints, one.links), one.depends_on) != (c.effect.id, places(robot, c), driven_by(c, robot)):
        return False
    window, recordings, times = c.site.window, one.where.recordings, one.where.time_s
    if window is None:
        return recordings == c.site.recordings and times is None
    spans = times or ((-math.inf, math.inf),)
    return recordings == (window.recording,) and any(window.start_s < b and a < window.end_s for a, b in spans)
