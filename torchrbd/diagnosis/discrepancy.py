"""The discrepancy: torque that the model lacks, whatever it is, as smooth curves; and the noise that these leave.

    tau_j = machine + laws + sum_k a_k f_k(x_k) + noise,   x_k one of the joint's own q, qd, qdd, load, and time

An effect that is left out colours the noise that is learnt without it, and this noise then hides it. So the noise is
learnt once, with curves of unknown amplitude a in the model, and held for all hypotheses. Curves that the data do not
need, or that the noise explains as well if it is learnt without them, are dropped: what they took would be missing in
the noise. The others stay in the model: a law has to explain more than they do, and where it does they go.

Source: Kennedy and O'Hagan, "Bayesian calibration of computer models", J. R. Stat. Soc. B 2001, sec. 4.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.calibration import calibrated
from torchrbd.diagnosis.curve_hypotheses import curves_at, is_of_time, is_over_own_signal, tones
from torchrbd.diagnosis.hypotheses import Hypothesis
from torchrbd.diagnosis.posterior import curve_log_odds, needless
from torchrbd.effects import Effect
from torchrbd.likelihood.additions import Additions
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.likelihood import Likelihood

# Steps of amplitudes and noise, and how many while curves are dropped; gain [nats] that is worth another one.
_STEPS, _FEW, _SETTLED = 20, 2, 0.1


@dataclass(frozen=True)
class Discrepancy:
    """Curves and what is learnt with them.

    Attributes:
        fit: the machine with noise and dispersion that are learnt with the curves, without these.
        curves: those that the data need.
        extra: their columns.
        tried: the effects of all curves that were tried, but those over time.
    """

    fit: Likelihood
    curves: tuple[Hypothesis, ...]
    extra: tuple[Extra, ...]
    tried: tuple[Effect, ...]

    def log_odds(self, present: int) -> float:
        """Return the log prior odds of one more curve where so many are there."""
        return curve_log_odds(present, len(self.tried), len(set(self.tried)))


def learn_discrepancy(base: Likelihood, rows: Rows) -> Discrepancy:
    """Learn amplitudes of curves, and noise.

    Args:
        base: the machine.
        rows: its rows, whose signals carry its load and friction.
    """
    own = [h for h in curves_at(base, rows, range(rows.n_dof)) if is_over_own_signal(h.candidate)]
    curves = [*own, *tones(base, rows)]
    tried = tuple(h.candidate.effect for h in curves if not is_of_time(h.candidate))
    # Before the data, one of all curves is expected.
    before = calibrated(-math.log(max(len(curves), 1)))
    plain = base.with_(noise=tuple(replace(n, tail=None) for n in base.hyper.noise), dispersion=np.ones(rows.n_dof))
    fit, steps = plain.extended([h.extra(base, rows) for h in curves]).renoised(), _FEW
    while True:
        fit = _learn_amplitudes_and_noise(fit, steps)
        last = _with_tails(fit)
        worth = [last.evidence_for(k) + h.paid + before for k, h in enumerate(curves)]
        if min(worth, default=1.0) > 0.0 and steps == _STEPS:
            worth = _more_than_noise(fit, last, curves, before)
            if min(worth, default=1.0) > 0.0:
                break
        drop = needless(worth)
        curves = [h for k, h in enumerate(curves) if k not in drop]
        fit, steps = _without(fit, drop).renoised(), _FEW if drop else _STEPS
    held = base.with_(noise=last.hyper.noise, dispersion=last.hyper.dispersion)
    return Discrepancy(held, tuple(curves), last.extra, tried)


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
        joint = h.candidate.joint
        own = _learn_amplitudes_and_noise(_with_noise_of(fit, joint, _without(last, [k])), _FEW, joint)
        other = _with_tails(own, joint).dispersed(last.hyper.dispersion)
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
        before, fit = fit.log_evidence, _likeliest(fit).renoised(None if joint is None else [joint])
        if abs(fit.log_evidence - before) < _SETTLED:
            break
    return fit


def _likeliest(fit: Likelihood) -> Likelihood:
    """Return a fit whose additional columns have the amplitudes of greatest evidence."""
    before, curves = Additions(fit, fit.extra), range(len(fit.extra))
    after = before.likeliest(curves)
    sizes = ((k, after.std[before.at(k)].max() / before.std[before.at(k)].max()) for k in curves)
    return fit.rescaled({k: float(ratio) for k, ratio in sizes})
