"""How likely hypotheses are: evidence times prior odds; the rest goes to rivals, laws and families.

    o = odds(effect at a place) B,   p = o / (1 + sum over it and its rivals of o)

with B = exp(log evidence) given all other terms. Prior odds are those of the effect on a machine, by its card, shared
among its places; windows of time and shapes share theirs within the evidence. Evidence is tempered by calibration on
development arms, see ``calibration``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import expit, softmax

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.calibration import calibrated
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.hypotheses import Hypothesis
from torchrbd.diagnosis.results import Elpd
from torchrbd.effects import Effect, Window
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.robot import RobotModel

# At such a precision of the prior, inertial parameters are the URDF's.
_CERTAIN = 1e8
# Standard deviation of the logarithm of how long something is there.
_TIMES_STD = math.log(3.0)
# How many of an effect are expected on a machine, besides baseline friction.
EXPECTED = {"common": 0.1, "rare": 0.03, "unknown": 0.001}


@dataclass(frozen=True)
class Inclusion:
    """How sure a term of a model is.

    Attributes:
        probability: of the effect itself at its place.
        family_probability: that some effect of its family is at its joint, or on the robot.
        class_probability: that it, or one of its rivals, is there.
        laws: effects in its place, the likeliest first, of whatever family, each with its probability given that any is
            there.
    """

    probability: float
    family_probability: float
    class_probability: float
    laws: tuple[tuple[Hypothesis, float], ...] = ()


def log_odds(h: Hypothesis, rows: Rows) -> float:
    """Return the log odds that an effect is at its place, against none."""
    c = h.candidate
    return calibrated(h.log_evidence) + prior_log_odds(c.effect, rows.columns.robot, h.elsewhere) + _so_briefly(c)


def prior_log_odds(effect: Effect, robot: RobotModel, elsewhere: int = 0) -> float:
    """Return the log odds of an effect at one place before any data; what is ubiquitous is as likely there as not.

    Args:
        effect: the effect.
        robot: its robot.
        elsewhere: at how many other joints it is there, if it is one of drives.
    """
    prevalence = "unknown" if effect.family == "unknown" else effect.prevalence
    if prevalence == "ubiquitous":
        return 0.0
    return _another_log_odds(elsewhere, _places(effect, robot), EXPECTED[prevalence])


def curve_log_odds(present: int, tried: int, kinds: int) -> float:
    """Return the log prior odds of one more curve where so many of those that were tried are there.

    On a machine whose laws are all a little wrong a curve is no surprise, on others it is.

    Args:
        present: number of curves that are there, below ``tried``.
        tried: number of curves that may be there.
        kinds: how many effects these are, of which each is as rare as one of family "unknown".
    """
    return _another_log_odds(present, tried, kinds * EXPECTED["unknown"])


def _another_log_odds(present: int, places: int, expected: float) -> float:
    """Return the log prior odds of one more of what is alike, where so many are there.

    Their rate is Beta(a, 1) before the data, and integrated out: the odds are (present + a) / (places - present), where
    a is how many are expected.

    Source: Scott and Berger, "Bayes and empirical-Bayes multiplicity adjustment", Annals of Statistics 2010, sec. 2.
    """
    return math.log((present + expected) / (places - present))


def _so_briefly(c: Candidate) -> float:
    """Return the log prior of the time for which something is there, against one as long as is usual: log-normal."""
    usual, window = c.effect.lasts_s, c.site.window
    if usual is None or window is None:
        return 0.0
    return -0.5 * (min(math.log((window.end_s - window.start_s) / usual), 0.0) / _TIMES_STD) ** 2


def probability_of(log_evidence: float) -> float:
    """Return the probability of what is as likely as not before the data."""
    return float(expit(calibrated(log_evidence)))


@lru_cache(maxsize=1024)
def _places(effect: Effect, robot: RobotModel) -> int:
    return max(len(effect.sites(robot)), len(effect.sites(robot, (Window(""),))), 1)


def excess_evidence(log_evidence: float, left_out: float = math.inf) -> float:
    """Return by how much evidence of rows exceeds that of left-out blocks, see ``proof``; zero without these."""
    return max(calibrated(log_evidence) - left_out, 0.0)


def limit_evidence(
    own: Hypothesis, rivals: Sequence[Hypothesis], elpd: Elpd | None
) -> tuple[Hypothesis, tuple[Hypothesis, ...]]:
    """Return a term and its rivals with no more evidence than left-out blocks give for the term."""
    excess = 0.0 if elpd is None else excess_evidence(own.log_evidence, elpd.log_evidence)
    own, *others = (replace(h, log_evidence=h.log_evidence - excess) for h in (own, *rivals))
    return own, tuple(others)


def refit_matters(base: Likelihood) -> bool:
    """Say whether other inertial parameters than the URDF's are likelier than not."""
    given = base.with_(kappa=_CERTAIN, bodies=np.zeros_like(base.hyper.bodies)).renoised(dispersed=True)
    return probability_of(base.log_evidence - given.dispersed(base.hyper.dispersion).log_evidence) > DECISIONS.likely


def inclusion(own: Hypothesis, rivals: Sequence[Hypothesis], rows: Rows) -> Inclusion:
    """Return how sure a term is, given its rivals' evidence in its place."""
    every = sorted((own, *rivals), key=lambda h: -log_odds(h, rows))
    logs = [log_odds(h, rows) for h in every]
    sure = probabilities(logs)
    return Inclusion(
        probability=float(sure[every.index(own)]),
        family_probability=float(sum(p for h, p in zip(every, sure, strict=True) if _of_family(h, own))),
        class_probability=float(sure.sum()),
        laws=tuple(zip(every, _shares(logs).tolist(), strict=True)),
    )


def _shares(logs: Sequence[float]) -> np.ndarray:
    """Return the probability (K,) of each hypothesis given that one is true; zeros if physics allows none of them."""
    return softmax(logs) if max(logs) > -math.inf else np.zeros(len(logs))


def probabilities(log_odds: Sequence[float]) -> np.ndarray:
    """Return the probabilities (K,) of hypotheses of which one may be true, or none, of log odds against none."""
    return softmax([0.0, *log_odds])[1:]


def needless(log_odds: Sequence[float]) -> list[int]:
    """Return the numbers of the worse half of all terms that are less likely than not, the least likely first.

    The others may be needed where these are gone.
    """
    worse = sorted((k for k, one in enumerate(log_odds) if one <= 0.0), key=log_odds.__getitem__)
    return worse[: (len(worse) + 1) // 2]


def _of_family(h: Hypothesis, own: Hypothesis) -> bool:
    same_place = h.candidate.site.joint == own.candidate.site.joint
    return h.candidate.effect.family == own.candidate.effect.family and same_place
