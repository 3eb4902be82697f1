"""What ``identify`` returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from torchrbd.display import Displayed, Remark
from torchrbd.inference.posterior.posterior import Posterior
from torchrbd.inference.reading import read_identification
from torchrbd.inference.results import (
    BaseParameterEstimate,
    JointNoise,
    NoiseRegime,
    ParameterEstimate,
    TorqueSeries,
    Verdict,
)
from torchrbd.inference.suspicions.results import NO_SUSPICIONS, Suspicions
from torchrbd.inference.torque_error import Fit
from torchrbd.model import RigidBodyDynamics
from torchrbd.recordings import Gain
from torchrbd.robot import RobotModel
from torchrbd.simulation import ClosedLoop, MotionError


@dataclass(frozen=True, repr=False)
class Identification(Displayed):
    """A fitted robot; a notebook shows it as a card.

    Attributes:
        robot: the robot as its URDF gives it.
        recordings, held_out: names of the recordings fitted; what was held out, in words.
        cutoff_hz: the one band limit of all torques and features.
        fits: "urdf", "baseline" (least squares with friction, see ``inference.baseline``; none of moments alone),
            "rigid_body" and, after a diagnosis or with effects, "extended".
        verdict: the worst that is known of the last model: "identified"; "doubtful", there are ``doubts``; "worse", its
            mean nmse on held-out data is above 1.2 times the URDF's; or "suspect": the recordings seem to mean
            something else, or it predicts held-out torque no better than a constant.
        parameters: every inertial parameter, then the coefficients of the terms.
        combinations: what is identified of the parameters that are not identified alone, and what no motion identifies.
        base: the identifiable combinations, with intervals.
        base_combination: K (n_base, n_params): the base parameters are K times the inertial ones.
        base_covariance: (n_base, n_base) of the base parameters; None for an estimator without intervals.
        covariance: (n_params, n_params) of all inertial parameters, or None.
        noise: per joint whose torque is measured.
        regime: what position noise does to the fit, and whether states are filtered or smoothed.
        series: torques against time.
        model: the fitted module.
        posterior: draws robots, and gives the variance of predicted torques; None for an estimator without intervals.
        remarks: what looks wrong with input or result, but for ``suspicions`` and ``regime``.
        facts: what else the user should know of the input (gaps, duplicates, ignored columns, held links, ...).
        suspicions: what else the recordings may mean, and what was tested.
        simulation: by length of the window, how far models move from the recorded motion; empty where unknown, and for
            robots with drives.
        closed_loop: how far models with drives move from it under the recorded set-points; None without drives.
        gains: of drives and motors, where they were to be estimated; all torques of these joints are in proportion.
        finished: whether the search came to its end; False if a time limit or the user ended it before.
    """

    robot: RobotModel
    recordings: tuple[str, ...]
    held_out: str
    cutoff_hz: float
    fits: dict[str, Fit]
    verdict: Verdict
    parameters: tuple[ParameterEstimate, ...]
    combinations: tuple[Remark, ...]
    base: tuple[BaseParameterEstimate, ...]
    base_combination: np.ndarray
    base_covariance: np.ndarray | None
    covariance: np.ndarray | None
    noise: dict[str, JointNoise]
    regime: NoiseRegime
    series: TorqueSeries
    model: RigidBodyDynamics
    posterior: Posterior | None
    remarks: tuple[Remark, ...] = field(default=())
    facts: tuple[Remark, ...] = field(default=())
    suspicions: Suspicions = NO_SUSPICIONS
    simulation: tuple[MotionError, ...] = field(default=())
    closed_loop: ClosedLoop | None = None
    gains: tuple[Gain, ...] = ()
    finished: bool = True

    @property
    def states(self) -> str:
        """How positions became states: "filtered", or "smoothed" together with the parameters."""
        return self.regime.states

    @property
    def doubts(self) -> tuple[str, ...]:
        """What looks wrong with input or result, and what to do about it, in words; suspicions first."""
        return (
            *(one.words for one in self.suspicions.found if one.spoils),
            *(one.statement for one in self.remarks),
            *([self.regime.statement] if self.regime.biases else []),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What else the user should know, in words: ``facts``, and the suspicions that fits allow for."""
        return (
            *(one.statement for one in self.facts),
            *(one.words for one in self.suspicions.found if not one.spoils),
        )

    @classmethod
    def load(cls, folder: str | Path) -> Identification:
        """Read what ``torchrbd identify -o`` or ``diagnose -o`` wrote.

        ``covariance`` and ``posterior`` are None, ``torchrbd.BayesianDynamics.load(folder)`` has the posterior as a
        module. The files hold no torques against time: ``series`` raises an InputError that says so.

        Raises:
            InputError: a file is missing, or none of ours.
        """
        return cls(**read_identification(cls, folder))

    def __repr__(self) -> str:
        errors = {name: float(f"{fit.mean_nmse:.3g}") for name, fit in self.fits.items()}
        return f"Identification(robot={self.robot.name!r}, verdict={self.verdict!r}, mean_nmse={errors})"
