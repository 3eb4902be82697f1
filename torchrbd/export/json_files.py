"""parameters.json, diagnosis.json and the rest of what other tools read: keys are added, never renamed."""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torchrbd._runtime.outputs import write_whole
from torchrbd.comparison import Comparison
from torchrbd.diagnosis import Diagnosis, Finding, Ranked, Ranking
from torchrbd.fleet.results import FleetComparison
from torchrbd.inference import EstimatorComparison, Identification
from torchrbd.model.conditions import to_content
from torchrbd.robot import RobotModel
from torchrbd.simulation import MotionError

SCHEMA = 1
# A list of numbers that json.dumps has spread over lines; text has no line breaks in JSON.
_NUMBERS = re.compile(r"\[\n[^\[\]{}\"]*\]")


def write_parameters(result: Identification, path: Path) -> None:
    """Write every parameter with its uncertainty, and what is identified only in combination.

    Keys besides those of all files (see ``_head``):

    parameters: list of name, owner (body or joint), unit, urdf, value, std, prior_share (share of information from the
        prior: 0 the data alone, 1 the URDF alone), status, suggestion, suggested (the same as data, or null). std and
        prior_share are null for an estimator without intervals.
    base_parameters: list of expression (four digits), unit, urdf, value, std, prior_share: the combinations of
        inertial parameters that motion can identify.
    base_combination: the same in full digits: columns (names of inertial parameters) and matrix K, a row per base
        parameter: base parameters = K times inertial parameters.
    base_covariance: of the base parameters, rows and columns in their order, [product of the two units]; or null.
    combinations: what is identified of parameters that are not identified alone, in words; combination_remarks: the
        same as data, see remarks.
    noise: per joint position, from_position, torque: standard deviations of the recorded position [rad, m], of the
        torque predicted from filtered positions for their noise alone, and of the residual torque [N m, N].
    noise_std: the last of these alone.
    states, regime: "filtered" or "smoothed", and why, in words.
    position_noise: the same as data: estimator asked for, states, matters, excess (squared error of parameters fitted
        to filtered states, over what it would be without position noise).
    remarks, facts: the doubts and the notes of the result as data: list of kind, values and recording ("" for all).
    verdict: "identified"; "doubtful", there are ``doubts``; "worse" than the URDF on held-out data; "suspect": the
        recordings seem to mean something else, or the model predicts held-out torque no better than a constant.
    """
    _write(
        path,
        {
            **_head(result),
            "parameters": [{**asdict(p), "suggestion": p.suggestion} for p in result.parameters],
            "combinations": [one.statement for one in result.combinations],
            "combination_remarks": [asdict(one) for one in result.combinations],
            "base_parameters": [asdict(p) for p in result.base],
            "base_combination": {
                "columns": list(result.robot.parameter_names),
                "matrix": result.base_combination.tolist(),
            },
            "base_covariance": None if result.base_covariance is None else result.base_covariance.tolist(),
            "noise_std": {joint: noise.torque for joint, noise in result.noise.items()},
            "noise": {joint: asdict(noise) for joint, noise in result.noise.items()},
            "states": result.states,
            "regime": result.regime.statement,
            "position_noise": asdict(result.regime),
            "remarks": [asdict(one) for one in result.remarks],
            "facts": [asdict(one) for one in result.facts],
            "verdict": result.verdict,
        },
    )


def write_diagnosis(result: Diagnosis, path: Path) -> None:
    """Write verdict, fits, findings and what is left unexplained.

    Keys besides those of all files (see ``_head``):

    findings: a list: those likelier than not, then the others; in both, by the held-out error that they remove. Keys:
        effect, joints, links (both empty: the whole robot), probability, log_evidence_gain [nats];
        parameters: by name: value, std, unit, urdf, at_least (a 95 % lower bound where the data give no more; value
            and std are null then);
        where: recordings, time_s, region; null for everywhere;
        indistinguishable_from: effect, joints, links, depends_on, parameters by name in its place [SI], probability
            given that one of the effects that explain the same is present; the likeliest first;
        nmse_before, nmse_after: by joint;
        statement: a sentence; depends_on: signals of other joints; curve: the function that shows it best, or null;
        family, family_probability; laws: effects that explain the same, each with its probability given one of them;
        class_probability: that one of these laws is there;
        elpd: cross-validation on blocks of the fitted time: value, the gain of expected log predictive density by the
            finding [nats], se, its standard error over blocks, log_evidence, the log Bayes factor of these blocks
            [nats], share, the part of the squared error that it removes, and torque_share, its part of the joint's
            torque while it acts; null where the torque does not show it;
        torque_rms: by joint; share: of its joint's squared error that it removes;
        judged_on: the data of nmse and share. "held-out data"; "own window": each half of the effect's window is
            predicted by a fit to the other half, as held-out data has none of it; "": too short, nmse is empty;
        held_out_ratio: torque of the effect on held-out data over that fitted: value, low and high (95 %). 1: the same.
            null if held-out data has too little of it;
        stability: share of repeated searches that find it again, or null if none were made.
    held_out_ratio: the same of all that the extended model adds to a rigid body with baseline friction.
    not_confirmed: effects that the search found and cross-validation does not confirm, in the same form.
    unexplained: list of joints, depends_on, where, share, statement, curve.
    curve: signal ("q_joint2", "t", ...), at, torque and std, lists of one length in the order of drawing.
    locations: where models and robot differ, named or not: list of model ("rigid_body": re-fitted, with friction and an
        offset at every joint; or "extended"), joints, links, where (as in findings), depends_on, form ("level",
        "friction", "delay", "payload", "force"), course ("abrupt", "slow", ""), gain (log evidence), torque_rms and
        share by joint, curve or null, attack (force [N] in the base's axes, point [m] in the link's frame, a standard
        deviation for each) or null, statement.
    residual_maps: RMS of a model's residual over the noise, by bins: list of model, signal ("t", "q", "qd"),
        recording, edges and level, a row per joint.
    detection_limits: effects that were looked for and not found: list of effect, joints, links, depends_on, parameter
        (the first that the data identify), its value and std given the findings, none (its value if the effect is
        absent), unit, and shape (nonlinear parameters for which this holds). Effects that act for a time only are left
        out, and those that the model absorbs.
    joint_deflections: what encoders behind the gears show: list of joint, stiffness (value, std, unit) or null,
        stiffness_at_least, lost_motion, delay, inertial_share of the load, rms of the deflection, probability and
        log_evidence_gain of the spring, nmse_before and nmse_after of the deflection on held-out data, load, deflection
        and deflection_std (lists of one length), statement.
    simulated: recordings of a simulator that replaced the URDF's prediction, in the order of the recordings, or empty.
    held_out_checks: how the extended model predicts held-out torque, by joint: over (by model, squared error relative
        to it: value, low and high of 95 % by a bootstrap over blocks), memory_s (by model, integrated autocorrelation
        time of the errors) and white_s (that of white noise).
    decisions: the limits that decided what is reported, by name, see ``torchrbd/diagnosis/decisions.py``.
    ranking: hypotheses by their evidence, or null if that could not be computed: band_hz, up to which torques were
        compared; considered, the number of effects at their places; delay_s, by recording, how much later the torque is
        than the motion (value, std); misfit, by joint, whether whitened rows and plain least squares agree on its
        friction (Hausman's test: statistic, dof, p_value); and four lists of hypotheses: ordinary (baseline friction of
        each joint), first (the best 30 given rigid body and baseline friction), adopted (those taken into the model,
        in order), last (the best 30 given these, adopted ones included).
        A hypothesis: effect, joints and links (both empty: the whole robot), log_evidence (against leaving it out,
        in nats), parameters by name (SI units), other (the joint on whose motion it depends) or null, window
        (recording, from_s, to_s) or null, and shape, its nonlinear parameters.
    """
    _write(
        path,
        {
            **_head(result.identification),
            "verdict": result.verdict,
            "statement": result.statement,
            "findings": [_finding(f) for f in result.findings],
            "held_out_ratio": None if result.held_out_ratio is None else asdict(result.held_out_ratio),
            "not_confirmed": [_finding(f) for f in result.not_confirmed],
            "unexplained": [_stated(u) for u in result.unexplained],
            "locations": [_stated(x) for x in result.locations],
            "residual_maps": [asdict(m) for m in result.maps],
            "detection_limits": [asdict(x) for x in result.detection_limits],
            "joint_deflections": [_stated(x) for x in result.joint_deflections],
            "simulated": list(result.simulated),
            "held_out_checks": [asdict(x) for x in result.held_out_checks],
            "next_effect": None if result.next_effect is None else asdict(result.next_effect),
            "decisions": asdict(result.decisions),
            "ranking": None if result.ranking is None else _ranking(result.ranking),
        },
    )


def _finding(found: Finding) -> dict[str, Any]:
    return {**_stated(found), "share": found.share, "confirmed_on_held_out": found.held_out}


def _stated(result: Any) -> dict[str, Any]:
    """Return a result's data and its sentence."""
    return {**asdict(result), "statement": result.statement}


def _ranking(found: Ranking) -> dict[str, Any]:
    lists = {"ordinary": found.ordinary, "first": found.first, "adopted": found.adopted, "last": found.last}
    return {
        "band_hz": found.band_hz,
        "considered": found.considered,
        "delay_s": {name: {"value": value, "std": std} for name, (value, std) in found.delay_s.items()},
        "misfit": {name: asdict(one) for name, one in found.misfit.items()},
        **{name: [_hypothesis(one) for one in hypotheses] for name, hypotheses in lists.items()},
    }


def _hypothesis(one: Ranked) -> dict[str, Any]:
    window = None if one.window is None else dict(zip(("recording", "from_s", "to_s"), one.window, strict=True))
    return {**asdict(one), "window": window}


def write_comparison(result: EstimatorComparison, path: Path) -> None:
    """Write the errors of every estimator; "raw" of its parameters as found, "physical" of those made physical."""
    words = {
        "regime": result.regime.statement,
        "position_noise": asdict(result.regime),
        "rows": [{**asdict(row), "note": row.note} for row in result.rows],
        "notes": result.notes,
        "doubts": [one.statement for one in result.doubts],
    }
    _write(path, {"schema": SCHEMA, **asdict(result), **words})


def write_changes(result: Comparison, path: Path) -> None:
    """Write what changed between two diagnoses.

    before, after: what they are called, a path.
    statement: in a sentence or two.
    changes: most certain first: list of kind ("finding", "inertia", "unexplained"), effect, joints, links, depends_on,
        found ("both", "before", "after": in which of the two), verdict ("changed", "unchanged", "open"), probability
        of a change (null where nobody knows), parameters by name (before and after: value, std, unit, urdf;
        difference, std, probability), statement.
    notes: what else to know of the two.
    """
    content = _stated(result) | {"changes": [_stated(one) for one in result.changes]}
    _write(path, {"schema": SCHEMA, **content, "notes": [str(note) for note in result.notes]})


def write_fleet(result: FleetComparison, path: Path) -> None:
    """Write what a comparison of a fleet found.

    statement: in a sentence.
    earlier: folder of the earlier time, empty without one.
    finished: false if the user ended the run before all robots were identified.
    members: in the order given: list of name, verdict of the identification ("failed" or "unfinished" where there is
        none), nmse (held out, mean over the joints), error (why there is none), sisters (robots it was compared with,
        itself among them), deviations (most certain first: parameter, kind, value with std, median, spread, z, chance:
        the number of such differences in a fleet of equal robots), load (links, mass, std: what would explain a
        difference in inertia) or null, changes by parameter (before, after, difference, std, probability; null without
        an earlier time), statement, doubts.
    """
    content = _stated(result) | {"finished": result.finished, "members": [_stated(one) for one in result.members]}
    _write(path, {"schema": SCHEMA, **content})


def _head(result: Identification) -> dict[str, Any]:
    """Return what both files begin with.

    fit: by model nmse and rmse by joint on held-out rows, as ``torchrbd.replay`` has them.
    conditions: how recordings were made, by name, and under "" those that are not among them: delay_s (how much later
        the torque is than the motion), lag_s (of actuators that follow the torque as their command), load (inertial
        parameters of a known load) or null, simulated (the simulator's recording that it was compared with), held_out_s
        (spans of time, from and to, that no fit has seen).
    finished: false if a time limit or the user ended the search: it holds the best model so far.
    notes: holds the ``doubts`` too, and these the ``suspicions`` in words.
    suspicions: what the recordings seem to mean instead of what they say: list of kind, joints, log_odds, times (by
        which the squared error on time left out of the fit falls, or null), statement, remedy (option or mapping
        entry), settles (whether nothing can be concluded before it is settled), spoils (whether fits are to be doubted
        where it is so), alternatives.
    suspicions_tested: what was looked for.
    simulation: how far models, rolled forward from recorded states under recorded torque, move from the recorded
        positions: list, by length, of window_s, held_out (whether the windows are held-out data; where too
        little is held out, they lie anywhere), windows (their number by joint), and errors by model
        (those of fit, and "constant_velocity") and joint: root mean square over a window, its median, low and high
        quartile over the windows, null where motions are lost, [rad] or [m] by unit. Empty where it is not known.
    closed_loop: the same for drives that follow the recorded set-points, over whole motions: seconds, held_out, errors
        by model and joint (root mean square distance from the recorded positions), tracking by joint (root mean square
        of the recorded difference of set-point and position). Null without drives.
    gains: estimated stiffness of drives (kind kp) and torque constants of motors: list of joint, kind, value, low, high
        (95 % interval). Empty where they are given.
    """
    return {
        "schema": SCHEMA,
        "robot": result.robot.name,
        "joints": list(result.series.joints),
        "recordings": list(result.recordings),
        "held_out": result.held_out,
        "conditions": to_content(result.model.conditions),
        "cutoff_hz": result.cutoff_hz,
        "finished": result.finished,
        "fit": {name: asdict(fit) for name, fit in result.fits.items()},
        "doubts": list(result.doubts),
        "suspicions": [_stated(one) | {"remedy": one.remedy} for one in result.suspicions.found],
        "suspicions_tested": list(result.suspicions.tested),
        "notes": [*result.doubts, *result.notes],
        "simulation": [_motion(one, result.robot) for one in result.simulation],
        "closed_loop": None if result.closed_loop is None else asdict(result.closed_loop),
        "gains": [asdict(one) for one in result.gains],
    }


def _motion(found: MotionError, robot: RobotModel) -> dict[str, Any]:
    sliding = dict(zip(robot.joint_names, robot.prismatic.tolist(), strict=True))
    return {**asdict(found), "unit": {joint: "m" if sliding[joint] else "rad" for joint in found.windows}}


def _write(path: Path, content: dict[str, Any]) -> None:
    text = json.dumps(_finite(content), indent=1, ensure_ascii=False)
    text = _NUMBERS.sub(lambda row: " ".join(row[0].split()), text)
    write_whole(path, f"{text}\n".encode())


def _finite(value: Any) -> Any:
    """Replace numbers that JSON has no word for by null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    return value
