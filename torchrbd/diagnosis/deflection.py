"""What an encoder behind the gear shows: by how much a joint yields to its load.

The motor's position q and the link's q_link, each as its encoder reads it, differ by

    e = q - q_link = tau_load / k + h sign(qd) + T (qd - T/2 qdd) + a sin(q) + b cos(q) + o

- k: the stiffness.
- h: half of the lost motion, or the wind-up by friction behind the spring.
- T: how much later the link's encoder is read.
- a, b: one wave a turn of an eccentric disc; a prismatic joint has a scale, a q, instead.
- o: the zero of an encoder, one for each recording.

Viscous friction makes the torque follow qd, so that without T a delay would look like a soft gear. All terms but the
spring are always fitted. The spring is a hypothesis, as any effect in the torque is: log evidence, in coloured noise
that is learnt with it, and prior odds decide. Before the data, c = 1/k is no larger than makes the whole deflection:

    c >= 0,   c ~ N(0, std(e)^2 / std(tau_load)^2)

tau_load is what acts on the link in the extended model: rigid body, loads, forces, springs. All friction that was found
is taken to act at the motor; the part that acts at the link goes into h and T. The measured torque is not used, as it
holds the motor's friction.

Not guaranteed: gravity's load on a link that only it moves is one wave a turn too. Where the motion is so slow that
gravity is the whole load, a spring cannot be distinguished from an eccentric disc; the interval is wide then. A rotor
inertia that the rigid body absorbs, as at the first joint, counts as load and makes the spring look stiffer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.special import expit

from torchrbd.diagnosis.calibration import calibrated
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.posterior import prior_log_odds
from torchrbd.diagnosis.results import Deflection, Quantity
from torchrbd.effects.registry import known_effects
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.preparation import Prepared
from torchrbd.likelihood.gaussian import Posterior, added
from torchrbd.likelihood.noise import learnt, predicted
from torchrbd.recordings import States, tiles

# Columns of a joint's rows; those of the disc and an offset for each recording follow.
_LOAD, _LOST, _SPEED, _ACCELERATION = range(4)
_ROUNDS, _LEAST_BLOCKS, _POINTS = 4, 4, 24
_RANK, _ONE_SIDED = 1e-11, 1.645


@dataclass(frozen=True)
class _Rows:
    """M band-limited samples of one joint's deflection.

    Attributes:
        A: (M, C) columns.
        e: (M,) deflection.
        recording, block: (M,) numbers.
        held: (M,) bool, held out.
        run: (M,) number of its uninterrupted run.
        AY: (C, n_params) products of columns and regressor over what is not held out.
    """

    A: np.ndarray
    e: np.ndarray
    recording: np.ndarray
    block: np.ndarray
    held: np.ndarray
    run: np.ndarray
    AY: np.ndarray

    def basis(self, delay: float) -> np.ndarray:
        """Return what the fitted columns are made of, (C, K): the load first, the delay third."""
        B = np.delete(np.eye(self.A.shape[1]), _ACCELERATION, axis=1)
        B[_ACCELERATION, _SPEED] = -0.5 * delay
        return B

    def moments(self, B: np.ndarray) -> np.ndarray:
        """Return the moments of columns A B and deflection, (b, K + 1, K + 1), of each block that is not held out."""
        X = np.column_stack((self.A @ B, self.e))
        parts = (X[(self.block == b) & ~self.held] for b in np.unique(self.block[~self.held]))
        return np.stack([x.T @ x for x in parts])

    def centred(self, x: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return x (M,) at some rows (M,), less its mean there in each recording."""
        parts = (x[rows & (self.recording == k)] for k in np.unique(self.recording[rows]))
        return np.concatenate([part - part.mean() for part in parts])


def joint_deflections(prepared: Prepared, model: FittedModel) -> tuple[Deflection, ...]:
    """Return what is to be said of each joint that has an encoder behind the gear in some recording.

    Args:
        prepared: the data.
        model: the extended model, whose load winds the springs up.
    """
    rows = ((joint, _rows(prepared, model, joint)) for joint in range(prepared.robot.n_dof))
    return tuple(
        _deflection(one, model, joint)
        for joint, one in rows
        if one is not None and len(np.unique(one.block[~one.held])) >= _LEAST_BLOCKS
    )


def _rows(prepared: Prepared, model: FittedModel, joint: int) -> _Rows | None:
    """Read a joint's deflection from all recordings that have it, None if there are none."""
    reading = prepared.reading
    surveyed = list(zip(reading.recordings, reading.surveys, strict=True))
    usable = [(r, s) for r, s in surveyed if s.link_differs[joint] and s.link_follows[joint]]
    parts, block_rows = list[tuple[np.ndarray, ...]](), 1.0
    AY = np.zeros(())
    for k, (recording, survey) in enumerate(usable):
        # Not the smoothed states: both positions shall have passed the same filter.
        for states in tiles(recording, survey, reading.filtering):
            columns, e, Y = _columns(prepared, model, states, joint)
            A = np.column_stack((columns, np.tile(np.arange(len(usable)) == k, (len(e), 1))))
            held = prepared.kept_back(states.recording, states.t_out).numpy()
            AY = AY + A[~held].T @ Y[~held]
            parts.append((A, e, np.full(len(e), k), states.t_out.numpy() / states.dt_out, held))
            block_rows = reading.block_s / states.dt_out
    if not parts:
        return None
    A, e, recording, number, held = (np.concatenate(x) for x in zip(*parts, strict=True))
    place = np.column_stack((recording, np.floor(number / block_rows)))
    block = np.unique(place, axis=0, return_inverse=True)[1].ravel()
    # A run ends where a recording ends or rows are missing, and where rows begin to be held out.
    begins = (np.abs(np.diff(number, prepend=-np.inf) - 1.0) > 0.5) | (np.diff(recording, prepend=-1) != 0)
    begins |= np.diff(held, prepend=held[0])
    return _Rows(A, e, recording, block, held, np.cumsum(begins), AY)


def _columns(
    prepared: Prepared, model: FittedModel, states: States, joint: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return of a tile the columns without offsets (M, C'), the deflection (M,) and the regressor (M, n_params)."""
    robot, columns = prepared.robot, model.columns
    signals, x = columns.signals(states), torch.zeros_like(model.x)
    for term in model.proper_terms:
        if term.effect.acts_on_link:
            x[columns.of(term)] = model.x[columns.of(term)]
    pi = model.pi + prepared.reading.payload.get(states.recording, torch.zeros_like(model.pi))
    Y = robot.regressor_batch_last(states.q, states.qd, states.qdd)[joint]
    q = states.q[joint]
    disc = (q,) if bool(robot.prismatic[joint]) else (q.sin(), q.cos())
    load, direction = pi @ Y + columns.term_torque(signals, x)[joint], signals.joint(joint).direction()
    assert states.q_link is not None, "only recordings with an encoder behind this gear are read"
    rows = (load, direction, states.qd[joint], states.qdd[joint], *disc, q - states.q_link[joint])
    found = states.decimate(torch.stack(rows)).T.numpy()
    return found[:, :-1], found[:, -1], states.decimate(Y).T.numpy()


def _deflection(rows: _Rows, model: FittedModel, joint: int) -> Deflection:
    """Fit one joint's deflection with and without a spring, and judge the spring on blocks left out."""
    B = rows.basis(0.0)
    for _ in range(_ROUNDS):
        B = rows.basis(float(_solved(rows.moments(B).sum(0))[_SPEED]))
    parts = rows.moments(B)
    stiff = parts[:, 1:, 1:]
    w, left_out = _solved(parts.sum(0)), _left_out(parts)
    evidence = _log_evidence(rows, B, w)
    (spring,) = (e for e in known_effects().values() if e.is_gear_spring)
    probability = float(expit(calibrated(evidence) + prior_log_odds(spring, model.columns.robot)))
    std = ((len(parts) - 1) * ((left_out - left_out.mean(0)) ** 2).mean(0)) ** 0.5
    std[_LOAD] = np.hypot(std[_LOAD], _load_std(parts.sum(0), rows.AY.T @ B, w, model))
    seen = probability > DECISIONS.likely
    before = _unpredicted(rows, B[:, 1:] @ _solved(stiff.sum(0)))
    prismatic = bool(model.columns.robot.prismatic[joint])
    length, stiffness = ("m", "N/m") if prismatic else ("rad", "N m/rad")
    load = rows.A[~rows.held, _LOAD]
    order = np.array_split(np.argsort(load), min(_POINTS, len(load)))
    yields = (rows.e - rows.A @ B[:, 1:] @ w[1:])[~rows.held]
    return Deflection(
        joint=model.columns.robot.joint_names[joint],
        stiffness=Quantity(float(1 / w[_LOAD]), float(std[_LOAD] / w[_LOAD] ** 2), stiffness) if seen else None,
        stiffness_at_least=float(1 / (max(w[_LOAD], 0.0) + _ONE_SIDED * std[_LOAD])),
        lost_motion=Quantity(float(2 * w[_LOST]), float(2 * std[_LOST]), length),
        delay=Quantity(float(w[_SPEED]), float(std[_SPEED]), "s"),
        inertial_share=_inertial_share(rows, B, model, joint),
        rms=float(np.sqrt(np.mean(rows.centred(rows.e, ~rows.held) ** 2))),
        probability=min(probability, DECISIONS.largest_probability),
        log_evidence_gain=evidence,
        nmse_before=before,
        nmse_after=_unpredicted(rows, B @ w) if seen else before,
        load=tuple(float(load[i].mean()) for i in order),
        deflection=tuple(float(yields[i].mean()) for i in order),
        deflection_std=tuple(float(yields[i].std()) for i in order),
    )


def _log_evidence(rows: _Rows, B: np.ndarray, w: np.ndarray) -> float:
    """Return the log evidence for the spring, whose coefficient is the first of w (K,), given the other columns A B.

    Where blocks of time scatter by more than white rows, rows count less by that.
    """
    kept = ~rows.held
    X, e, run = rows.A[kept] @ B, rows.e[kept], rows.run[kept]
    index, one = predicted(run, np.ones(len(run), dtype=bool)), np.ones(len(run))
    noise = learnt(e - X @ w, index, one, run, len(w), 1.0)
    load, *others = noise.white(X.T)
    # The zero of a recording that is held out is not among the rows.
    Q, _ = np.linalg.qr(np.array([x for x in others if x.any()]).T)
    u, y, left = (x - Q @ (Q.T @ x) for x in (load, noise.white(e), noise.white(e - X @ w)))
    scores = np.bincount(rows.block[kept][index], u * left)
    dispersion = max(float(scores @ scores) / max(float(u @ u), 1e-300), 1.0)
    std = np.array([np.std(rows.centred(rows.e, kept)) / max(float(np.std(X[:, _LOAD])), 1e-300)])
    S, r = u @ u / dispersion, u @ y / dispersion
    return float(added(np.array([[S]]), np.array([r]), std, positive=(0,)).log_evidence)


def _left_out(parts: np.ndarray) -> np.ndarray:
    """Return the coefficients (b, K) without each block."""
    return np.stack([_solved(np.delete(parts, b, axis=0).sum(0)) for b in range(len(parts))])


def _solved(moments: np.ndarray) -> np.ndarray:
    """Return the least-squares coefficients (K,) of moments (K + 1, K + 1), the dependent variable last."""
    return Posterior(moments[:-1, :-1], moments[:-1, -1], _RANK).z


def _errors(parts: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return the squared error of coefficients (b, K) on the moments of each block, (b, 1)."""
    v = np.column_stack((-w, np.ones(len(w))))
    return np.einsum("bi,bij,bj->b", v, parts, v)[:, None].clip(min=0.0)


def _load_std(total: np.ndarray, YX: np.ndarray, w: np.ndarray, model: FittedModel) -> float:
    """Return the standard deviation of c = 1/k for what is not known of the load Y pi.

        dc/dpi = -c Y'l / l'l,   l = what the other columns leave of the load

    Args:
        total: moments of columns and deflection.
        YX: (n_params, K) products of regressor and columns.
        w: (K,) coefficients.
        model: whose inertial parameters make the load.
    """
    order = [*range(_LOAD + 1, len(w)), _LOAD]
    u = np.zeros(len(w))
    u[order] = np.append(-_solved(total[np.ix_(order, order)]), 1.0)
    left = float(u @ total[:-1, :-1] @ u)
    if left <= _RANK * total[_LOAD, _LOAD]:
        return float("inf")
    slope = w[_LOAD] * (YX @ u) / left
    return float(max(slope @ model.inertial_covariance(model.covariance).numpy() @ slope, 0.0)) ** 0.5


def _inertial_share(rows: _Rows, B: np.ndarray, model: FittedModel, joint: int) -> float:
    """Return the part of the load, given other columns, that follows the acceleration; zero with a rotor inertia."""
    if any(c.effect.of_rotor and c.place == joint for c in model.proper_terms):
        return 0.0
    A = rows.A[~rows.held]
    X = np.column_stack((A @ B[:, 1:], A[:, _ACCELERATION], A[:, _LOAD]))
    moments, rigid = X.T @ X, np.r_[: X.shape[1] - 2, X.shape[1] - 1]
    other = moments[np.ix_(rigid, rigid)]
    without, left = (_errors(m[None], _solved(m)[None]).item() for m in (other, moments))
    return 1.0 - left / without if without > _RANK * moments[-1, -1] else 0.0


def _unpredicted(rows: _Rows, w: np.ndarray) -> float:
    """Return the part of the deflection's variance on held-out samples that coefficients (C,) leave; NaN for none."""
    if not rows.held.any():
        return float("nan")
    moved = float(np.sum(rows.centred(rows.e, rows.held) ** 2))
    return float(np.sum(rows.centred(rows.e - rows.A @ w, rows.held) ** 2)) / moved if moved > 0 else float("nan")
