"""The parts of an identification: frozen, complete, and free of any computation that a report would need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from torchrbd.display import Remark, Stated, brief, few
from torchrbd.inference.torque_error import Fit, torque_fit

Verdict = Literal["identified", "doubtful", "worse", "suspect"]


@dataclass(frozen=True)
class TorqueSeries:
    """Band-limited torques of all recordings on the decimated clock, and what each model predicts for them.

    Torques are as they were recorded: late or early, commands, with known loads. Models predict them so, see
    ``RigidBodyDynamics.conditions``. States are filtered, even where a fit has smoothed them.

    Attributes:
        joints: names of the n joints.
        recordings: names of the recordings.
        recording: (M,) index into ``recordings``.
        t: (M,) seconds from that recording's start.
        held_out: (M,) True where no fit has seen the sample.
        q, qd, qdd: (M, n) band-limited states, [rad, m], per second, per second squared.
        measured: (M, n) band-limited torque, NaN where a joint's torque was not recorded.
        predicted: "urdf", "baseline", "rigid_body" and, after a diagnosis, "extended": (M, n) each.
    """

    joints: tuple[str, ...]
    recordings: tuple[str, ...]
    recording: np.ndarray
    t: np.ndarray
    held_out: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    measured: np.ndarray
    predicted: dict[str, np.ndarray]

    def __repr__(self) -> str:
        return brief(
            self,
            joints=few(self.joints),
            recordings=few(self.recordings),
            samples=len(self.t),
            models=list(self.predicted),
        )

    def residual(self, model: str) -> np.ndarray:
        """Return measured minus predicted torque, (M, n)."""
        return self.measured - self.predicted[model]

    def fit(self, model: str, *, held_out: bool = True) -> Fit:
        """Return how well a model predicts the held-out rows, or the fitted ones, every row counting alike."""
        rows = self.held_out if held_out else ~self.held_out
        return torque_fit(self.joints, self.measured[rows], self.predicted[model][rows])


@dataclass(frozen=True)
class ParameterEstimate:
    """One inertial parameter or one coefficient of a term.

    Attributes:
        name: e.g. ``mcx_link2``.
        owner: the body or joint it belongs to.
        unit: SI unit.
        urdf: the value the URDF gives.
        value, std: posterior mean and standard deviation; std is NaN for an estimator without intervals.
        prior_share: share of information from the prior, 0 (the data alone) to 1 (the URDF alone); NaN where std is.
        status: "identified"; "combination" (only a sum with others is identified); "unexcited" (other motions would
            identify it); "not identifiable" (by no motion of this robot); "held" (zero-mass or trusted link, kept as
            the URDF has it); "term"; "not judged" (an estimator without intervals).
        suggested: a short motion that would identify it, if it is "unexcited" and there is one.
    """

    name: str
    owner: str
    unit: str
    urdf: float
    value: float
    std: float
    prior_share: float
    status: str
    suggested: Remark | None = None

    @property
    def suggestion(self) -> str:
        """That motion in words, or nothing."""
        return "" if self.suggested is None else self.suggested.statement


@dataclass(frozen=True)
class BaseParameterEstimate:
    """A combination of inertial parameters that motion of this robot can identify.

    Attributes:
        expression: in terms of the inertial parameters, e.g. "Iyy_link2 - 0.3 mcx_link3".
        unit: SI unit.
        urdf: its value by the URDF.
        value, std: posterior mean and standard deviation; std is NaN for an estimator without intervals.
        prior_share: share of information from the prior, 0 (the data alone) to 1 (the URDF alone); NaN where std is.
    """

    expression: str
    unit: str
    urdf: float
    value: float
    std: float
    prior_share: float


@dataclass(frozen=True)
class JointNoise:
    """Noise at one joint, standard deviations.

    Attributes:
        position: of the recorded position, [rad] or [m].
        from_position: of the torque that a model predicts from filtered positions, for their noise alone, [N m] or [N].
        torque: of the band-limited torque that the fitted model leaves where it was fitted, [N m] or [N].
    """

    position: float
    from_position: float
    torque: float


@dataclass(frozen=True)
class NoiseRegime(Stated):
    """What position noise does to a fit, and what was done about it.

    Attributes:
        estimator: that the user asked for.
        states: "filtered", or "smoothed" together with the parameters.
        matters: whether it biases a fit to filtered states.
        excess: squared error of the parameters of such a fit, over what it would be without position noise.
    """

    estimator: str
    states: str
    matters: bool
    excess: float

    @property
    def biases(self) -> bool:
        """Whether the reported parameters are biased by position noise."""
        return self.matters and self.states == "filtered"
