"""The base classes of all effects: physics that a rigid body lacks.

An effect adds to the torque that the actuators must supply

    tau_j += sum_k w_k phi_jk(q, qd, qdd, ...; shape)

It is linear in its coefficients w, so that block statistics suffice to fit it. It has at most a few nonlinear shape
parameters; each is tried on a grid and refined. Most effects act on one joint and depend on its motion alone: those are
a ``JointEffect``. An ``Effect`` describes the physics and holds no numbers. A ``Term`` is an effect at a site with
numbers, a ``torch.nn.Module``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar, Literal, NamedTuple

import torch
from torch import Tensor, nn

from torchrbd.effects.signals import JointScale, JointState, Signals
from torchrbd.effects.sites import Site, Window
from torchrbd.robot import RobotModel

Shape = Mapping[str, float]
SPEED, DIRECTION, UNEVENNESS, LEVEL, ACCELERATION = "qd", "sign(qd)", "|sign(qd)|", "1", "qdd"
"""Labels of columns that several effects share."""
Mjcf = dict[str, dict[str, float | tuple[float, ...] | str]]
"""MJCF elements and their attributes."""


@dataclass(frozen=True)
class CoefficientPrior:
    """The prior of an effect's coefficients.

    Attributes:
        words: the reason, in one sentence.
        positive: indices of the coefficients that physics keeps non-negative.
        std: standard deviation of each coefficient in its own unit, around zero. Empty: the prior only says that the
            torque of the effect is no larger than the joint's.
        of_any_size: True if ``std`` gives only the proportions of the coefficients, and the torque sets the scale:
            loads and forces.
        sums: weights (K,) of sums of coefficients that physics keeps non-negative as well.
        may_be_none: True if a non-negative coefficient is zero on many machines, or has a value in the URDF. The fit
            then takes its most probable value, which may be zero; the mean of a truncated distribution never is.
        torque_part: standard deviation of the effect's torque, as a fraction of the joint's torque.
    """

    words: str = "Of either sign, with a torque no larger than the joint's."
    positive: tuple[int, ...] = ()
    std: tuple[float, ...] = ()
    of_any_size: bool = False
    sums: tuple[tuple[float, ...], ...] = ()
    may_be_none: bool = False
    torque_part: float = 1.0

    def not_negative(self, n: int) -> list[tuple[float, ...]]:
        """Return the weights (n,) of all sums of n coefficients that cannot be negative, single coefficients first."""
        return [*(tuple(float(i == k) for k in range(n)) for i in self.positive), *self.sums]

    @property
    def proportions(self) -> tuple[float, ...]:
        """Standard deviations of several coefficients; empty for a single one, or if ``std`` is empty."""
        return self.std if len(self.std) > 1 else ()


RESISTS = CoefficientPrior("It resists motion, with a torque no larger than the joint's.", positive=(0,))
FRICTION = replace(RESISTS, may_be_none=True)


class Curve(NamedTuple):
    """An effect as a function: y, in the unit of the torque, over x, the values of a signal."""

    signal: str
    x: Tensor
    y: Tensor


FAMILIES = (
    "friction",
    "inertia and load",
    "spring",
    "transmission",
    "actuator and sensor",
    "gravity and geometry",
    "external force",
    "other",
    "unknown",
)


class Effect(ABC):
    """One kind of missing physics.

    Class attributes:
        id: the name in diagnosis.json.
        family: group of similar effects, see ``FAMILIES``.
        prevalence: "ubiquitous", "common" or "rare" among machines.
        words: the name in a sentence.
        equation: the torque added, in the usual symbols.
        shown_by: the motion that shows it best, and what one sees, in one sentence.
        units: of the physical parameters. ``{tau}`` and ``{q}`` are those of the joint: N m and rad, or N and m.
        dissipative: True if tau qd >= 0 for plausible parameters.
        whole_robot: True if one coefficient adds to the torque of several joints.
        uses_load: True if the features depend on the rigid-body torque, and so on the inertial parameters.
        comes_and_goes: True if it may be in some recordings of a robot and not in others: after service, in the cold,
            with a cable, after a new calibration. False for what a robot is built of.
        of_each_recording: True if each recording of a site has coefficients of its own; the site names the recordings.
        sees_friction: True if the features depend on the friction too (``Signals.supplied``).
        has_memory: True if the features depend on past states, and so need a sequence.
        lasts_s: typical duration of an effect that acts for a time only [s]; a shorter one is less likely.
        prior: of the coefficients.
        plain_columns: labels of its columns, if they are all of a joint's own velocity, direction of motion or
            acceleration, or constant.
        baseline: per coefficient, how much it adds to the joint's viscous friction, Coulomb friction and offset, which
            other effects see as torque that the actuator supplies; empty if nothing.
        friction_part: what it is of its joint's law of friction: the "shape" over velocity, a "modulator" of that, or
            "" for neither. A joint has one law, with one of each at most.
        dry: True if a parameter of it is Coulomb friction in motion, as of other such effects in its place.
        urdf_tag: the attribute of URDF's <dynamics> that is its coefficient.
        acts_on_link: True if it acts behind the gear: it winds up the gear's spring.
        of_drives: True if a machine that has it at one joint has it at others, too: its drives are of one kind.
        of_rotor: True if it is inertia in front of the gear.
        is_gear_spring: True if it is the spring of the gear, which an encoder behind the gear shows too.
        moves_origin: True if its parameters x, y and z move the origin of a joint.
        of_conditions: True if the torque depends on time or temperature as well as on the state.
        other_signal: signal of the other joint on which it depends, if a site has one.
        own_signals: signals of its joint that its equation has, of "q", "qd" and "qdd".
        curve_times: what multiplies its curve, if that is not over a velocity or acceleration: "direction" of motion,
            "speed", or "" for nothing.
        lags: True if the torque follows its command with a lag.
        shifts_clocks: True if, at all joints at once, it equals a clock offset to first order.
        kinds: shape parameters with separate values, such as the side of a stop, and words for these values.
        several: True if a joint may have more than one of them, such as two stops.
        follows: shape parameters that are computed from the coefficients, see ``agreeing``.
        reciprocals: parameters that are one over a coefficient which may be zero, such as a stiffness.
        of_the_data: shape parameters that describe the recordings, not the robot, such as a usable bandwidth.
        needs: what a recording must hold in addition to positions and torques, in words.
        export_note: what ``mjcf`` leaves out, or why MJCF has no element for the effect.
        exported_in_part: True if what ``mjcf`` writes makes only a part of the torque; ``export_note`` says which.
        urdf_note: which part of the torque ``urdf_dynamics`` writes and which it leaves out; empty if it writes all.
    """

    id: ClassVar[str]
    family: ClassVar[str] = "other"
    prevalence: ClassVar[str] = "rare"
    words: ClassVar[str]
    equation: ClassVar[str]
    shown_by: ClassVar[str] = ""
    units: ClassVar[Mapping[str, str]]
    dissipative: ClassVar[bool] = False
    whole_robot: ClassVar[bool] = False
    uses_load: ClassVar[bool] = False
    comes_and_goes: ClassVar[bool] = False
    of_each_recording: ClassVar[bool] = False
    sees_friction: ClassVar[bool] = False
    has_memory: ClassVar[bool] = False
    shifts_clocks: ClassVar[bool] = False
    lags: ClassVar[bool] = False
    lasts_s: ClassVar[float | None] = None
    prior: ClassVar[CoefficientPrior] = CoefficientPrior()
    plain_columns: ClassVar[tuple[str, ...]] = ()
    baseline: ClassVar[tuple[tuple[float, float, float], ...]] = ()
    friction_part: ClassVar[Literal["", "shape", "modulator"]] = ""
    dry: ClassVar[bool] = False
    urdf_tag: ClassVar[str] = ""
    acts_on_link: ClassVar[bool] = False
    of_drives: ClassVar[bool] = False
    of_rotor: ClassVar[bool] = False
    is_gear_spring: ClassVar[bool] = False
    moves_origin: ClassVar[bool] = False
    of_conditions: ClassVar[bool] = False
    other_signal: ClassVar[str] = "q"
    own_signals: ClassVar[tuple[str, ...]] = ()
    curve_times: ClassVar[Literal["", "direction", "speed"]] = ""
    kinds: ClassVar[Mapping[str, Mapping[float, str]]] = MappingProxyType({})
    several: ClassVar[bool] = False
    follows: ClassVar[tuple[str, ...]] = ()
    reciprocals: ClassVar[tuple[str, ...]] = ()
    of_the_data: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[str] = ""
    export_note: ClassVar[str] = ""
    exported_in_part: ClassVar[bool] = False
    urdf_note: ClassVar[str] = ""

    @property
    def is_baseline(self) -> bool:
        """Whether it is baseline friction, or an offset: the columns that every joint may have."""
        return bool(self.plain_columns) and ACCELERATION not in self.plain_columns

    @property
    def is_ubiquitous(self) -> bool:
        """Whether every machine has it."""
        return self.prevalence == "ubiquitous"

    def of_clock_offset(self, delay_s: float) -> dict[str, float] | None:
        """Return the parameters that make all torques so much later than the motion [s]; None if none do."""
        return None

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        """Return the places on a robot where the effect may act; ``windows`` are windows of time in which it may act.

        Without windows: the places where it may act all the time; none for an effect that acts for a time only.
        """
        return tuple(Site(joint) for joint in range(robot.n_dof))

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        """Return the shape parameters to try, given the range that a recording covers."""
        return ({},)

    def agreeing(self, coefficients: Tensor, shape: Shape) -> Shape:
        """Return the shape with the parameters in ``follows`` computed from the coefficients (K,)."""
        return shape

    @abstractmethod
    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        """Return phi_k by label: (*batch) at the site's joint, (n, *batch) if ``whole_robot``.

        Equal labels at one joint must mean equal features, for all effects. With ``whole_robot`` this holds for the
        whole robot, so a label names the site too.
        """

    def features_at(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        """Return ``features``, set to zero in recordings outside the site; labels then name the site's recordings."""
        found = self.features(signals, site, shape)
        if site.recordings is None:
            return found
        inside, names = float(signals.recording in site.recordings), ", ".join(site.recordings)
        return {f"{label} in {names}": phi * inside for label, phi in found.items()}

    @abstractmethod
    def parameters(self, coefficients: Tensor, shape: Shape) -> dict[str, Tensor]:
        """Return the physical parameters, one for each entry of ``units``, differentiable in w (K,)."""

    @abstractmethod
    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        """Return w and the shape for given physical parameters: the inverse of ``parameters``."""

    @abstractmethod
    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        """Return whether physics allows these values: signs, order, and the ranges that the recording covers."""

    def region(self, parameters: Mapping[str, float], scale: JointScale) -> tuple[float, float] | None:
        """Return the joint positions between which the effect acts [rad, m]; None if it acts everywhere."""
        return None

    def urdf_dynamics(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """Return what the term adds to the attributes of URDF's <dynamics>; empty if URDF cannot express it.

        "damping" is viscous friction, "friction" Coulomb friction.
        """
        return {}

    def mjcf(self, parameters: Mapping[str, float]) -> Mjcf:
        """Return the term as MJCF elements and attributes; empty if MJCF cannot express it.

        Elements: "joint", the site's joint; "body", the body that this joint moves (the base, for the whole robot);
        "general" or "dcmotor", the joint's actuator, whose control is the recorded torque; "actuatorfrc", the sensor
        that records it; "fixed", a tendon over the site's joints. Numbers add to those of other terms; a gain
        multiplies. Angles are in radians.
        """
        return {}

    def curve(self, coefficients: Tensor, shape: Shape, scale: JointScale) -> Curve | None:
        """Return the function that shows the effect best, differentiable in w (K,).

        Args:
            coefficients, shape: as in a term.
            scale: the range of the recordings at the joint on whose motion the effect depends.

        Returns:
            None if the torque is not a function of one joint's signal, or the range of that signal is not known.
        """
        return None

    def unit(self, parameter: str, *, prismatic: bool) -> str:
        """Return the SI unit of a physical parameter at a revolute or prismatic joint."""
        return self.units[parameter].format(**({"tau": "N", "q": "m"} if prismatic else {"tau": "N m", "q": "rad"}))


class ShowsBodies(Effect):
    """An effect that makes inertial parameters identifiable which are not identifiable without it."""

    @abstractmethod
    def through_bodies(self, signals: Signals, coefficients: Tensor) -> Tensor:
        """Return the derivative of the torque of the coefficients (K,) by the inertial parameters, (n, n_params, N)."""


class JointEffect(Effect):
    """An effect at one joint that depends on the signals of that joint alone.

    ``drawn_over`` names the signal on the x axis of its curve, a field of ``JointState``.
    """

    drawn_over: ClassVar[str] = "qd"

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, Tensor]:
        found = self.joint_features(signals.joint(site.joint, load=self.uses_load), shape)
        if site.window is None:
            return found
        inside = signals.inside(site.window)
        return {f"{label} {site.window}": phi * inside for label, phi in found.items()}

    def curve(self, coefficients: Tensor, shape: Shape, scale: JointScale) -> Curve | None:
        state = scale.sweep(self.drawn_over)
        if state is None or (self.uses_load and state.load is None):
            return None
        phi = torch.stack(list(self.joint_features(state, shape).values()))
        return Curve(self.drawn_over, getattr(state, self.drawn_over), coefficients.to(phi) @ phi)

    @abstractmethod
    def joint_features(self, state: JointState, shape: Shape) -> dict[str, Tensor]:
        """Return phi_k by label; each has the shape of ``state.q``."""


class Term(nn.Module):
    """An effect at a site, with numbers: ``term(signals)`` is the torque it adds.

    Args:
        effect: the physics.
        site: where it acts.
        coefficients: w, (K,).
        shape: values of the nonlinear parameters.
    """

    coefficients: nn.Parameter

    def __init__(self, effect: Effect, site: Site, coefficients: Tensor, shape: Shape) -> None:
        super().__init__()
        self.effect, self.site, self.shape = effect, site, dict(shape)
        self.coefficients = nn.Parameter(coefficients.detach().clone())

    def forward(self, signals: Signals) -> Tensor:
        """Return sum_k w_k phi_k, (*batch) or, if the effect is ``whole_robot``, (n, *batch), [N m] or [N]."""
        features = self.effect.features_at(signals, self.site, self.shape)
        w = self.coefficients.to(signals.q.dtype)
        return sum(w_k * phi for w_k, phi in zip(w, features.values(), strict=True))  # type: ignore[return-value]

    def parameters_by_name(self) -> dict[str, float]:
        """Return the physical parameters in SI units."""
        return {k: float(v) for k, v in self.effect.parameters(self.coefficients.detach(), self.shape).items()}

    def extra_repr(self) -> str:
        """Show effect, site and parameters."""
        values = ", ".join(f"{k}={v:.4g}" for k, v in self.parameters_by_name().items())
        return f"{self.effect.id}, {self.site}, {values}"
