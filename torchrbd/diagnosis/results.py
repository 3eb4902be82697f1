"""The parts of a diagnosis: findings, what is unexplained, where models and robot differ."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.display import Stated, brief, few

HELD_OUT, OWN_TIME = "held-out data", "own window"


@dataclass(frozen=True)
class Quantity:
    """A parameter of a finding with its posterior standard deviation; ``urdf`` is the URDF's value.

    ``at_least`` is a lower bound (95 %) where the data gives no more, as for a spring that may be rigid. Value and
    standard deviation are NaN then.
    """

    value: float
    std: float
    unit: str
    urdf: float = 0.0
    at_least: float | None = None


@dataclass(frozen=True)
class Region:
    """An interval of one signal, e.g. ``q_joint2`` from -0.1 to 0.3 rad."""

    signal: str
    low: float
    high: float


@dataclass(frozen=True)
class Where:
    """Where a mismatch sits; None means everywhere."""

    recordings: tuple[str, ...] | None = None
    time_s: tuple[tuple[float, float], ...] | None = None
    region: tuple[Region, ...] | None = None


@dataclass(frozen=True)
class Alternative:
    """An effect that this data cannot distinguish from the finding; ``depends_on`` as there.

    ``parameters`` are those that it would have in the finding's place, in SI units. ``probability`` is given that one
    of the effects that explain the same is there. Neither counts in comparisons.
    """

    effect: str
    joints: tuple[str, ...] = ()
    links: tuple[str, ...] = ()
    depends_on: tuple[str, ...] = ()
    parameters: dict[str, float] = field(default_factory=dict, compare=False)
    probability: float = field(default=0.0, compare=False)


@dataclass(frozen=True)
class Curve:
    """A torque as a function of one signal: mean and standard deviation at values of it, in the order of drawing."""

    signal: str
    at: tuple[float, ...]
    torque: tuple[float, ...]
    std: tuple[float, ...]


@dataclass(frozen=True)
class Ratio:
    """A ratio with the ends of its interval of 95 %."""

    value: float
    low: float
    high: float

    @property
    def exceeds_one(self) -> bool:
        """Whether it is significantly above one, and by more than cannot be distinguished from no change."""
        return self.low > 1.0 and self.value > 1.0 + DECISIONS.no_change


@dataclass(frozen=True)
class Elpd:
    """What a term is worth on blocks of the fitted time, each predicted by fits without it: cross-validation.

    Attributes:
        value, se: gain of the expected log predictive density by the term, and its standard error over blocks [nats].
        log_evidence: log Bayes factor of these blocks, with noise whose scale they show, see ``proof`` [nats].
        share: part of the squared error that the term removes, at that joint of its own where this is largest.
        torque_share: its torque over that of the joint while it acts, RMS, at that joint where this is largest.
    """

    value: float
    se: float
    log_evidence: float
    share: float
    torque_share: float

    @property
    def certain(self) -> bool:
        """Whether the gain of density is larger than chance allows."""
        return self.value > DECISIONS.least_elpd * self.se

    @property
    def matters(self) -> bool:
        """Whether it is worth a name: whether the term is not practically equivalent to nothing."""
        return self.share >= DECISIONS.least_error and self.torque_share >= DECISIONS.least_torque


@dataclass(frozen=True)
class Law:
    """An effect in the place of a finding, and its probability given that one of them is there."""

    effect: str
    probability: float


@dataclass(frozen=True)
class Deflection(Stated):
    """What the encoder behind one joint's gear shows.

    Attributes:
        joint: which.
        stiffness: of the spring between motor and link; None if there is no evidence of one.
        stiffness_at_least: lower end of its one-sided interval.
        lost_motion: how far the link stays behind when the motor turns back.
        delay: how much later than the motor's the link's encoder is read.
        inertial_share: part of the load that follows the joint's own acceleration and that nothing else absorbs, if the
            model has no rotor inertia there. What of it belongs to the rotor winds no spring.
        rms: of the deflection, less its mean in each recording.
        probability, log_evidence_gain: of the spring, from the deflection.
        nmse_before, nmse_after: NMSE of the deflection on held-out data without the spring and with it; NaN if nothing
            is held out.
        load, deflection, deflection_std: means over parts of the range of the load [N m, N], and of the deflection
            there [rad, m], without delay, lost motion and errors of the encoders, with its scatter.
    """

    joint: str
    stiffness: Quantity | None
    stiffness_at_least: float
    lost_motion: Quantity
    delay: Quantity
    inertial_share: float
    rms: float
    probability: float
    log_evidence_gain: float
    nmse_before: float
    nmse_after: float
    load: tuple[float, ...]
    deflection: tuple[float, ...]
    deflection_std: tuple[float, ...]

    @property
    def held_out(self) -> bool:
        """Whether the spring lowers the error of the deflection on held-out data."""
        return self.nmse_after < DECISIONS.spring_helps * self.nmse_before


@dataclass(frozen=True)
class Variant:
    """A joint origin that is farther off than a description's mistakes are: the URDF may be another variant's.

    Attributes:
        parent: the link to whose origin distances are.
        distance, given: as fitted and by the URDF [m].
    """

    parent: str
    distance: float
    given: float


@dataclass(frozen=True)
class Finding(Stated):
    """One named effect; at no joint and no link if it acts on the whole robot.

    On held-out data ``nmse_after`` is the error that ``Identification.fits["extended"]`` reports, of the same model. It
    is of another one where the reported model also has smooth curves of friction (``Diagnosis.unexplained``) or effects
    that are not confirmed (``Diagnosis.not_confirmed``): these are left out of both errors here. ``nmse_before`` is of
    a fit without this finding. All others are kept, and baseline friction may absorb a part of it: it is no error of a
    row of that table.

    Attributes:
        effect, joints, links: what, and where.
        probability: against none and its rivals in its place.
        log_evidence_gain: against leaving it out [nats].
        parameters: by name, with units.
        where: recordings, times and region in which it acts.
        indistinguishable_from: effects that this data cannot distinguish from it.
        nmse_before, nmse_after: by joint, NMSE without it and with it on the data that ``judged_on`` names, every row
            counting alike.
        depends_on: signals of other joints that it depends on, e.g. "q_joint2".
        curve: the function that shows it best.
        family, family_probability: kind of effect, and the probability of some effect of that kind there.
        class_probability: that it is there, or an effect that this data cannot distinguish from it.
        laws: the effects that explain the same.
        torque_rms: RMS of the torque that it carries, by joint [N m or N].
        elpd: what it is worth on left-out blocks of the fitted time; None where the torque does not show it.
        judged_on: "held-out data"; "own window": cross-validated between two halves of the time in which it acts, as
            held-out data has none of it; or "", where that time is too short.
        held_out_ratio: its torque on held-out data over that fitted (1: the same); None if too little there.
        stability: share of repeated searches that find it again, see ``stability``; None if none were made.
        coulomb_in_motion: Coulomb friction of its joint in motion, if several findings have a part of it: their sum,
            which is better known than the parts.
        adds_to_all: whether it adds to the same effect in all recordings.
        variant: set where a joint origin is so far off that the URDF may be another variant's.
        deflection: what the encoder behind the gear shows of it, for a spring.
    """

    effect: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    probability: float
    log_evidence_gain: float
    parameters: dict[str, Quantity]
    where: Where
    indistinguishable_from: tuple[Alternative, ...]
    nmse_before: dict[str, float]
    nmse_after: dict[str, float]
    depends_on: tuple[str, ...] = ()
    curve: Curve | None = None
    family: str = ""
    family_probability: float = 0.0
    class_probability: float = 0.0
    laws: tuple[Law, ...] = ()
    torque_rms: dict[str, float] = field(default_factory=dict)
    elpd: Elpd | None = None
    judged_on: str = HELD_OUT
    held_out_ratio: Ratio | None = None
    stability: float | None = None
    coulomb_in_motion: Quantity | None = None
    adds_to_all: bool = False
    variant: Variant | None = None
    deflection: Deflection | None = None

    def __repr__(self) -> str:
        values = [f"{name}: {q.value:.3g} ± {q.std:.2g} {q.unit}" for name, q in self.parameters.items()]
        place = ", ".join((*self.joints, *self.links)) or "whole robot"
        return brief(self, effect=self.effect, at=place, probability=self.probability, parameters=few(values))

    @property
    def confirmed(self) -> bool:
        """Whether it, or what cannot be distinguished from it, is likelier than not, and matters on left-out blocks."""
        likely = max(self.probability, self.class_probability) > DECISIONS.likely
        return likely and (self.elpd is None or self.elpd.matters)

    @property
    def share(self) -> float:
        """The part of its joint's squared error that it removes where it is judged, the largest of several joints."""
        shares = [1.0 - self.nmse_after[j] / b for j, b in self.nmse_before.items() if b > 0 and j in self.nmse_after]
        return max(shares, default=0.0)

    @property
    def error_removed(self) -> float:
        """NMSE on held-out data that it removes, summed over the joints; zero where that has none of it."""
        if self.judged_on != HELD_OUT:
            return 0.0
        removed = (b - self.nmse_after[j] for j, b in self.nmse_before.items() if j in self.nmse_after)
        return math.fsum(x for x in removed if math.isfinite(x))

    @property
    def held_out(self) -> bool:
        """Whether held-out data shows it: a joint's NMSE falls, and ``held_out_ratio`` is significantly above zero."""
        if self.deflection is not None and not self.nmse_before:
            return self.deflection.held_out
        seen = self.judged_on == HELD_OUT and self.share >= DECISIONS.no_change
        return seen and (self.held_out_ratio is None or self.held_out_ratio.low > 0.0)


def strongest_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings that are likelier than not, then the others; what removes most held-out error first in both."""
    least = DECISIONS.likely
    return tuple(sorted(findings, key=lambda f: (f.probability <= least, -f.error_removed, -f.log_evidence_gain)))


@dataclass(frozen=True)
class Unexplained(Stated):
    """A residual that no known effect explains.

    Attributes:
        joints: where.
        depends_on: signals that it follows; "t" if time alone matters, none if no signal explains it.
        where: recordings, times and region.
        share: its part of what the named terms do not explain there.
        curve: how it depends on the first signal.
        kind: "curve", a smooth function of a signal; "tone", one frequency; "drift", slow change with time;
            "error", a large error on held-out data; or "larger error", errors on held-out data above those of the fit.
        sizes: numbers of that kind, by name: torque_rms [``unit``], low and high amplitude [``unit``], frequency [Hz],
            nmse on held-out data, and ratio of the errors there to those of the fit, drift aside; these two, where
            errors have a memory, also of a curve, tone or drift of the joint, which then has no entry of its own for
            its error; states, the part of an error that a random forest of all states predicts on left-out data.
        unit: of torques.
    """

    joints: tuple[str, ...]
    depends_on: tuple[str, ...]
    where: Where
    share: float
    curve: Curve | None = None
    kind: str = "curve"
    sizes: dict[str, float] = field(default_factory=dict)
    unit: str = "N m"


@dataclass(frozen=True)
class NextEffect:
    """What is likelier than not given the findings, where a search has ended: ``terms`` were in the model then."""

    terms: int
    effect: str
    joints: tuple[str, ...] = ()
    links: tuple[str, ...] = ()
    depends_on: tuple[str, ...] = ()
    recording: str = ""


@dataclass(frozen=True)
class Attack:
    """A force on a link: [N] in the base's axes, at a point [m] of the link's frame; each with its standard deviation.

    For a payload the force is its weight, the point its centre of mass.
    """

    force: tuple[float, float, float]
    force_std: tuple[float, float, float]
    point: tuple[float, float, float]
    point_std: tuple[float, float, float]


@dataclass(frozen=True)
class Location(Stated):
    """A place where a model and the robot differ, located without naming an effect.

    Attributes:
        model: whose residual: "rigid_body", re-fitted with an offset and friction at every joint, or "extended".
        joints: where it acts, the joint with the clearest residual first.
        links: the link on which a payload or force explains it best; else none.
        where: recordings, times and region; None where it is not confined.
        depends_on: signals that it follows, e.g. "q_joint2"; "t" if only the time matters.
        form: what acts there: "level" (a torque), "friction" (a torque against the motion), "delay" (the joint's own
            torque, later), "payload" or "force".
        course: "abrupt" (for a time), "slow" (changes gradually), or "" if time does not matter.
        gain: log evidence, given the other locations.
        torque_rms: per joint, RMS of its torque over all samples [N m or N].
        share: per joint, its part of the residual's power.
        curve: how it depends on the first signal, if it does.
        attack: force and point of attack, if it is on a link.
        unit: of its torque.
    """

    model: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    where: Where
    depends_on: tuple[str, ...]
    form: str
    course: str
    gain: float
    torque_rms: dict[str, float]
    share: dict[str, float]
    curve: Curve | None
    attack: Attack | None
    unit: str = "N m"


@dataclass(frozen=True)
class ResidualMap:
    """RMS of a model's residual over the noise, by joint and by bins of a signal; 1 is noise.

    Attributes:
        model: as in ``Location``.
        signal: "t", "q" or "qd" (each joint's own).
        recording: which one, for time; "" for all.
        edges: per joint, B + 1 edges of the bins, [s, rad, m, ...].
        level: per joint, RMS of the residual in each bin over the standard deviation of the noise; NaN where empty.
    """

    model: str
    signal: str
    recording: str
    edges: tuple[tuple[float, ...], ...]
    level: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class DetectionLimit:
    """An effect that was looked for and not found: how large it could be, given the findings, in its best shape.

    Attributes:
        effect, joints, links, depends_on: as of a ``Finding``.
        parameter: the first of its parameters that the data identifies.
        value, std: of that parameter.
        none: its value if the effect is absent: zero, one for a gain, Coulomb friction for a static friction.
        unit: SI unit.
        shape: its nonlinear parameters, at which this holds.
    """

    effect: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    depends_on: tuple[str, ...]
    parameter: str
    value: float
    std: float
    none: float
    unit: str
    shape: dict[str, float]


@dataclass(frozen=True)
class HeldOutCheck:
    """What the extended model is worth at one joint, on torque that no fit has seen.

    Attributes:
        joint: which.
        over: by model to compare with, the part of its squared error that the extended model leaves.
        memory_s: by model, how long its errors stay alike: their integrated autocorrelation time.
        white_s: the same of white noise below the cut-off.
    """

    joint: str
    over: dict[str, Ratio]
    memory_s: dict[str, float]
    white_s: float
