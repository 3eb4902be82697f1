"""Compare estimators on one robot: all see the same blocks of its recordings and are judged on the held-out ones."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from torchrbd._runtime.deadline import is_over, reached_limit_s, time_limited
from torchrbd._runtime.threads import single_threaded
from torchrbd.dataset.reading import Progress
from torchrbd.display import Remark, brief, few
from torchrbd.effects import Effect
from torchrbd.errors import OptionError, TorchRBDError
from torchrbd.estimators import COMPARABLE, check_estimators
from torchrbd.inference.estimators import Estimate, estimate, linear_problem
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.physical.fitting import judge, term_candidates
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.results import NoiseRegime
from torchrbd.inference.settings import Settings
from torchrbd.inference.torque_error import Fit
from torchrbd.inference.verdict import encoder_doubts, regime_of
from torchrbd.options import Names, Payload, given
from torchrbd.recordings import NamedSource, Sources
from torchrbd.robot import RobotModel


@dataclass(frozen=True)
class EstimatorRow:
    """How one estimator did.

    Attributes:
        name: of the estimator; "urdf" for the robot as given.
        raw: torque error of its parameters on held-out blocks; None if it failed.
        physical: that of the physical ones, projected where the raw ones are not physical.
        was_physical: whether the raw ones are; None for the URDF and for what failed.
        seconds: of the estimate, without reading and filtering, except for the smoother, which does its own.
        remark: what a user should know; if it failed, why. None if nothing.
    """

    name: str
    raw: Fit | None
    physical: Fit | None
    was_physical: bool | None
    seconds: float
    remark: Remark | None

    @property
    def note(self) -> str:
        """The remark in words, or nothing."""
        return "" if self.remark is None else self.remark.statement


@dataclass(frozen=True)
class EstimatorComparison:
    """Estimators side by side.

    Attributes:
        robot, joints: the robot's name, and its joints that are judged.
        recordings, held_out: names of the recordings fitted; what was held out, in words.
        cutoff_hz: the one band limit of all torques and features.
        base_parameters: how many combinations of inertial parameters and terms the data identifies.
        condition: condition number of their regressor, joints weighted and columns at unit length: noise of the worst
            combination over that of the best.
        regime: the effect of position noise here.
        noise_matters: whether it biases a fit on filtered states. All are judged on torques that filtered states
            predict; their noise then favours estimates that are biased the same way.
        rows: the URDF as given, then the estimators in the order asked for.
        facts: what the user should know of the input.
        doubts: what looks wrong with the options.
    """

    robot: str
    joints: tuple[str, ...]
    recordings: tuple[str, ...]
    held_out: str
    cutoff_hz: float
    base_parameters: int
    condition: float
    regime: NoiseRegime
    noise_matters: bool
    rows: tuple[EstimatorRow, ...]
    facts: tuple[Remark, ...]
    doubts: tuple[Remark, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """The ``facts`` in words."""
        return tuple(one.statement for one in self.facts)

    def __repr__(self) -> str:
        errors = {row.name: row.physical.mean_nmse for row in self.rows if row.physical is not None}
        best = [f"{name}: {error:.3g}" for name, error in sorted(errors.items(), key=lambda one: one[1])]
        failed = [row.name for row in self.rows if row.physical is None]
        return brief(self, robot=self.robot, mean_nmse=few(best), failed=failed)


@time_limited
@single_threaded()
def compare_estimators(
    robot: RobotModel | str | Path | bytes,
    recordings: Sources,
    *,
    estimators: Sequence[str] = COMPARABLE,
    holdout: Sources = (),
    holdout_fraction: float = 0.25,
    time: str | tuple[float, float] | None = None,
    joints: Names | None = None,
    effects: Names | None = None,
    exclude: Names = (),
    gravity: Sequence[float] | None = None,
    trust: Names = (),
    payload: Sequence[Payload | str] | Payload | str = (),
    simulated: Sources = (),
    mapping: str | Path | None = None,
    cutoff_hz: float | None = None,
    encoder_noise: float | Mapping[str, float] | None = None,
    kappa: float = 3.0,
    seed: int = 0,
    time_limit: float | str | None = None,
    progress: Progress = lambda *_: None,
) -> EstimatorComparison:
    """Estimate a robot's parameters with many estimators and judge each on the same held-out, filtered torques.

    Args:
        robot: a robot or its URDF.
        recordings: files, opened recordings or data in memory, as for ``identify``.
        estimators: names, of ``torchrbd.estimators.COMPARABLE``. One that cannot be used on these recordings is a row
            that says why.
        holdout: recordings that no fit uses; the reported errors are those on them. In Python, files, opened recordings
            or data in memory. Default: none; a part of each recording is held out, see ``holdout_fraction``.
        holdout_fraction: without ``holdout``, the part of each recording that is held out, (0, 0.5]. Default: 0.25.
        time: use only this part of each recording, FROM:TO [s] from its start, e.g. 2:30. In Python, text or a pair of
            numbers. Default: all.
        joints: joints whose torque counts, by name. Default: all.
        effects: effects to fit (``diagnose``: to search among), by id at all their places, or as EFFECT@PLACE. A place
            is a joint, a pair such as joint3_joint1, or a link. EFFECT@PLACE@RECORDING=FROM:TO [s] acts for a time
            only. In Python, ``torchrbd.known_effects()`` lists the ids, and [] is the rigid body alone. Default: of
            ``diagnose`` all, of ``compare_estimators`` none, else viscous and Coulomb friction and a torque offset.
        exclude: effects not to use, by id. Default: none.
        gravity: acceleration in the base's axes, X Y Z [m/s^2], e.g. 0 9.81 0 for an arm on a wall. In Python, only
            with a robot that is given by its URDF. Default: 0 0 -9.81.
        trust: links whose inertia is not fitted again, by name. Default: none.
        payload: known loads, FILE=kg,x,y,z[@LINK]: mass [kg] and centre of mass [m] in the frame of a link. In Python,
            text or ``torchrbd.inference.Payload``. Default: none; of a chain, the link is the last one.
        simulated: recordings of a simulator with the same commands: one for each recording, then one for each of
            ``holdout``, in their order. The robot is compared with them in place of the URDF. Where the simulator has
            other inertials than the URDF, the difference is reported as inertial parameters. Default: none.
        mapping: YAML file with other column names, units, signs, gear ratios or torque constants. Default: columns t,
            q_<joint>, tau_<joint> in SI units.
        cutoff_hz: band limit of torque and features [Hz]. Default: chosen from the data.
        encoder_noise: standard deviation of the positions [rad, m], one number or JOINT=number for each. In Python, a
            number or {joint: number}. Default: estimated.
        kappa: weight of the URDF's inertia against the data, above 0. Default: 3.
        seed: which blocks of time are held out, a whole number. Default: 0.
        time_limit: seconds, or text such as 90s or 2min, after which the search ends; the best model so far is then
            fitted, judged, written and marked as unfinished. Reading, learning the noise and reporting are not cut
            short. Default: none.
        progress: called with the stage and the part of it that is done.

    Raises:
        InputError: a robot, recording or option that cannot be used.
    """
    robot, opened, settings = read_arguments(robot, recordings, given(locals()), "compare_estimators")
    names = tuple(dict.fromkeys(estimators))
    if "auto" in names:
        raise OptionError("'auto' is either 'physical' or 'smoother', by recording; compare these two")
    check_estimators(names, COMPARABLE)
    fitted = settings.chosen_effects() if settings.effects else ()
    prepared = prepare(robot, opened, replace(settings, estimator="physical"), fitted, progress)
    terms = term_candidates(prepared.columns, [e.id for e in fitted])
    urdf = judge(prepared.judging, prepared.prior.reference)
    rows = [EstimatorRow("urdf", urdf, urdf, None, 0.0, None)]
    for k, name in enumerate(names):
        progress(name, k / len(names))
        if is_over():
            late = Remark("not tried", {"limit_s": reached_limit_s()})
            rows.append(EstimatorRow(name, None, None, None, 0.0, late))
            continue
        # An estimator that breaks down, in whatever way, is a result of the comparison and not its end.
        try:
            if name == "smoother":
                found = _smoothed(robot, opened, settings, fitted, progress)
            else:
                found = estimate(prepared, name, terms)
            rows.append(_row(prepared, found))
        except (TorchRBDError, ArithmeticError, ValueError, RuntimeError) as error:
            failed = Remark("estimator failed", {"error": " ".join(str(error).split())})
            rows.append(EstimatorRow(name, None, None, None, 0.0, failed))
    problem = linear_problem(prepared, terms)
    return EstimatorComparison(
        robot=robot.name,
        joints=tuple(urdf.nmse),
        recordings=prepared.fitted,
        held_out=prepared.holdout_words,
        cutoff_hz=prepared.filtering.cutoff_hz,
        base_parameters=len(problem.chosen),
        condition=problem.condition,
        regime=regime_of(prepared, "physical"),
        noise_matters=prepared.input_noise.matters,
        rows=tuple(rows),
        facts=prepared.facts,
        doubts=encoder_doubts(prepared, settings),
    )


def _row(prepared: Prepared, found: Estimate) -> EstimatorRow:
    raw, physical = (judge(prepared.judging, x) for x in (found.raw, found.x))
    return EstimatorRow(found.name, raw, physical, found.was_physical, found.seconds, found.remark)


def _smoothed(
    robot: RobotModel,
    recordings: Sequence[NamedSource],
    settings: Settings,
    effects: Sequence[Effect],
    progress: Progress,
) -> Estimate:
    """Estimate with states that are smoothed together with the parameters, from recordings read anew."""
    start = time.perf_counter()
    prepared = prepare(robot, recordings, replace(settings, estimator="smoother"), effects, progress)
    if prepared.states is None:
        raise OptionError(str(prepared.facts[-1]))
    terms = term_candidates(prepared.columns, [e.id for e in effects])
    x = prepared.fit(terms).x
    return Estimate("smoother", x, True, x, time.perf_counter() - start, None)
