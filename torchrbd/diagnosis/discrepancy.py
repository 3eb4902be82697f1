"""The discrepancy: torque that the model lacks, whatever it is, as smooth curves; and the noise that these leave.

    tau_j = machine + laws + sum_k a_k f_k(x_k) + noise,   x_k one of the joint's own q, qd, qdd, load, and time

An effect that is left out colours the noise that is learnt without it, and this noise then hides it. It also makes
friction change its sign over another speed, and drift more. So all these are learnt once, with curves of unknown
amplitude a in the model, and held for all hypotheses. Curves that the data do not
need, or that the noise explains as well if it is learnt without them, are dropped: what they took would be missing in
the noise. The others stay in the model: a law has to explain more than they do, and where it does they go.

Source: Kennedy and O'Hagan, "Bayesian calibration of computer models", J. R. Stat. Soc. B 2001, sec. 4.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.calibration import calibrated
from torchrbd.diagnosis.curve_hypotheses import curves_at, has_direction, is_of_time, is_over_own_signal, tones
from torchrbd.diagnosis.hypotheses import Hypothesis, rows_with_load
from torchrbd.diagnosis.posterior import curve_log_odds, needless
from torchrbd.effects import Effect
from torchrbd.likelihood.additions import Additions
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.likelihood import Likelihood

# Steps of amplitudes and noise, and how many while curves are dropped; gain [nats] that is worth another one.
_STEPS, _FEW, _SETTLED = 20, 2, 0.1
# How often curves are dropped: again, if a joint then has another width.
_PASSES = 2


@dataclass(frozen=True)
class Discrepancy:
    """Curves and what is learnt with them.

    Attributes:
        fit: the machine with the noise, drift, widths and dispersion that are learnt with the curves, without these.
        rows: its rows, whose signals carry its load and friction.
        curves: those that the data need.
        extra: their columns.
        tried: the effects of all curves that were tried, but those over time.
    """

    fit: Likelihood
    rows: Rows
    curves: tuple[Hypothesis, ...]
    extra: tuple[Extra, ...]
    tried: tuple[Effect, ...]

    def log_odds(self, present: int) -> float:
        """Return the log prior odds of one more curve where so many are there."""
        return curve_log_odds(present, len(self.tried), len(set(self.tried)))

    def at_widths(self, rest_width: np.ndarray) -> Discrepancy:
        """Return the same, with friction that changes its sign over other speeds (n,) [rad/s, m/s]."""
        new = _friction_curves(self.rows, self.curves, self.extra, rest_width)
        return replace(
            self,
            fit=self.fit.with_(rest_width=rest_width),
            rows=self.rows.at_widths(rest_width),
            extra=tuple(new.get(k, e) for k, e in enumerate(self.extra)),
        )


def learn_discrepancy(base: Likelihood) -> Discrepancy:
    """Learn amplitudes of curves, noise, drift, and the widths of friction's sign change.

    Args:
        base: the machine.
    """
    rows = rows_with_load(base)
    own = [h for h in curves_at(base, rows, range(rows.n_dof)) if is_over_own_signal(h.candidate)]
    curves = [*own, *tones(base, rows)]
    tried = tuple(h.candidate.effect for h in curves if not is_of_time(h.candidate))
    # Before the data, one of all curves is expected.
    before = calibrated(-math.log(max(len(curves), 1)))
    plain = base.with_(noise=tuple(replace(n, tail=None) for n in base.hyper.noise), dispersion=np.ones(rows.n_dof))
    first = plain.extended([h.extra(base, rows) for h in curves]).renoised()
    # Rows are independent, as those of a machine are at first: noise that other widths have left would keep these.
    dry = partial(_friction_curves, rows, curves, first.extra)
    widths = first.least_squares.rewidened(dry).hyper.rest_width
    for _ in range(_PASSES):
        fit, last, needed = _drop_curves(_with_widths(first, rows, curves, widths).renoised(), curves, before)
        last = _compare_widths(base, fit, last, rows, needed)
        if (last.hyper.rest_width == widths).all():
            break
        widths = last.hyper.rest_width
    return Discrepancy(last.extended(()), rows.at_widths(last.hyper.rest_width), tuple(needed), last.extra, tried)


def _drop_curves(
    fit: Likelihood, curves: Sequence[Hypothesis], before: float
) -> tuple[Likelihood, Likelihood, list[Hypothesis]]:
    """Return a model with the curves that it needs: with normal noise, with its tails, and these curves.

    Args:
        fit: the model with all curves.
        curves: all curves.
        before: log odds of each before the data.
    """
    fit, curves, steps = _learn_amplitudes_and_noise(fit, _FEW), [*curves], _FEW
    while True:
        fit = _learn_amplitudes_and_noise(fit, steps)
        last = _with_tails(fit)
        worth = [last.evidence_for(k) + h.paid + before for k, h in enumerate(curves)]
        if min(worth, default=1.0) > 0.0 and steps == _STEPS:
            worth = _more_than_noise(fit, last, curves, before)
            if min(worth, default=1.0) > 0.0:
                return fit, last, curves
        drop = needless(worth)
        curves = [h for k, h in enumerate(curves) if k not in drop]
        fit, steps = _without(fit, drop).renoised(), _FEW if drop else _STEPS


def _friction_curves(
    rows: Rows, curves: Sequence[Hypothesis], extra: Sequence[Extra], widths: np.ndarray
) -> dict[int, Extra]:
    """Return the columns of curves that are friction, by their number, if its sign changes over some speeds (n,)."""
    there = rows.at_widths(widths)
    dry = ((k, h.candidate) for k, h in enumerate(curves) if has_direction(h.candidate))
    return {k: replace(extra[k], features=there.features(c)) for k, c in dry}


def _with_widths(fit: Likelihood, rows: Rows, curves: Sequence[Hypothesis], widths: np.ndarray) -> Likelihood:
    """Return a fit with curves in which friction changes its sign over other speeds (n,)."""
    new = _friction_curves(rows, curves, fit.extra, widths)
    return fit.with_(rest_width=widths).extended([new.get(k, e) for k, e in enumerate(fit.extra)])


def _compare_widths(
    base: Likelihood, fit: Likelihood, last: Likelihood, rows: Rows, curves: Sequence[Hypothesis]
) -> Likelihood:
    """Return a model with the width that the machine has alone, at each joint where that is likelier.

    Args:
        base: the machine alone.
        fit, last: the model with normal noise, and with its tails.
        rows: whose load and friction its curves have.
        curves: its curves.
    """
    for j in np.flatnonzero(last.hyper.rest_width != base.hyper.rest_width).tolist():
        widths = np.where(np.arange(rows.n_dof) == j, base.hyper.rest_width, last.hyper.rest_width)
        other = _learn_noise_of(j, fit, last, _with_widths(last, rows, curves, widths))
        last = max(last, other, key=lambda one: one.log_evidence)
    return last


def _learn_noise_of(joint: int, fit: Likelihood, last: Likelihood, other: Likelihood) -> Likelihood:
    """Return another model with the amplitudes and noise of a joint learnt; all else is as in the last one."""
    own = _learn_amplitudes_and_noise(_with_noise_of(fit, joint, other), _FEW, joint)
    return _with_tails(own, joint).dispersed(last.hyper.dispersion)


def _more_than_noise(fit: Likelihood, last: Likelihood, curves: Sequence[Hypothesis], before: float) -> list[float]:
    """Return the log odds of each curve against noise of its joint that is learnt without it.

    Curves over time are noise.

    Args:
        fit, last: the model with normal noise, and with its tails.
        curves: its curves.
        before: log odds of each before the data.
    """
    worth = []
    for k, h in enumerate(curves):
        if is_of_time(h.candidate):
            worth.append(math.inf)
            continue
        other = _learn_noise_of(h.candidate.joint, fit, last, _without(last, [k]))
        worth.append(last.log_evidence - other.log_evidence + h.paid + before)
    return worth


def _with_noise_of(other: Likelihood, joint: int, fit: Likelihood) -> Likelihood:
    """Return a fit with the noise that another one has at a joint."""
    noise, dispersion = list(fit.hyper.noise), fit.hyper.dispersion.copy()
    noise[joint], dispersion[joint] = other.hyper.noise[joint], other.hyper.dispersion[joint]
    return fit.with_(noise=tuple(noise), dispersion=dispersion)


def _without(fit: Likelihood, drop: Collection[int]) -> Likelihood:
    """Return a fit without some of its additional columns."""
    return fit.extended([e for k, e in enumerate(fit.extra) if k not in drop])


def _with_tails(fit: Likelihood, joint: int | None = None) -> Likelihood:
    """Return a fit with heavy tails where they are likelier, at one joint or all."""
    joints = None if joint is None else [joint]
    return fit.with_heavy_tails(joints).renoised(joints, dispersed=True)


def _learn_amplitudes_and_noise(fit: Likelihood, steps: int, joint: int | None = None) -> Likelihood:
    """Return a fit whose amplitudes and noise, at one joint or all, are learnt one after the other."""
    for _ in range(steps):
        before, fit = fit.log_evidence, _likeliest(fit, joint).renoised(None if joint is None else [joint])
        if abs(fit.log_evidence - before) < _SETTLED:
            break
    return fit


def _likeliest(fit: Likelihood, joint: int | None = None) -> Likelihood:
    """Return a fit whose additional columns, at one joint or all, have the amplitudes of greatest evidence."""
    curves = [k for k, e in enumerate(fit.extra) if joint is None or joint in e.joints]
    if not curves:
        return fit
    before = Additions.of(fit) if joint is None else Additions.of(fit).around(curves)
    after = before.likeliest(curves)
    sizes = ((k, after.std[before.at(k)].max() / before.std[before.at(k)].max()) for k in curves)
    return fit.rescaled({k: float(ratio) for k, ratio in sizes})
