"""What else one could use: sparse regression and a network on the torque that the re-fitted rigid body leaves.

All of them see the same recordings at the same cut-off. SINDy (sequentially thresholded least squares), BIC forward
selection and LASSO choose among the columns of all of torchrbd's effects with all shapes; a network has the states.
Each joint is judged on recordings that none of them has seen, inside and outside of the range of the motion they were
fitted to.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pysindy import STLSQ
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LassoCV
from sklearn.model_selection import KFold
from sklearn.neural_network import MLPRegressor
from sklearn.preprocessing import StandardScaler

from torchrbd.dataset.block_statistics import filtered_rows
from torchrbd.effects import known_effects
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.robot import RobotModel

from .rival_scores import range_errors

FOLDS = 5
# In units of the residual's RMS, for columns of unit RMS.
THRESHOLDS = (0.05, 0.1, 0.2)
RIDGE = 1e-3
MOST_ROUNDS = 10
MOST_TERMS = 12


@dataclass(frozen=True)
class Series:
    """Band-limited samples of a case.

    Attributes:
        joints: names of the n joints.
        features: per joint (M, K_j), columns of the library.
        kinds: per joint and column, ids of the effects that have it.
        residual: (M, n) torque that the re-fitted rigid body leaves.
        measured: (M, n) torque.
        states: (M, 3 n) q, qd, qdd.
        held_out: (M,) bool.
        independent: part of the samples that counts as independent.
    """

    joints: tuple[str, ...]
    features: tuple[np.ndarray, ...]
    kinds: tuple[tuple[tuple[str, ...], ...], ...]
    residual: np.ndarray
    measured: np.ndarray
    states: np.ndarray
    held_out: np.ndarray
    independent: float


def read_series(urdf: Path, fit: Iterable[Path], holdout: Iterable[Path]) -> Series:
    """Fit the rigid body and evaluate the columns of all effects on every sample."""
    robot = RobotModel.from_urdf(urdf)
    settings = Settings.from_mapping({"holdout": list(holdout)}, "rivals")
    prepared = prepare(robot, list(fit), settings, tuple(known_effects().values()))
    x, columns, n = prepared.fit().x, prepared.columns, robot.n_dof
    rows: list[list[np.ndarray]] = [[] for _ in range(n)]
    states, held_out, steps = [], [], 0.0
    for k, recording in enumerate(prepared.recordings):
        for tile in prepared.tiles(k):
            joint_rows, _ = filtered_rows(columns, tile)
            for joint, row in enumerate(joint_rows):
                rows[joint].append(row.T.numpy())
            signals = [tile.decimate(s).T.numpy() for s in (tile.q, tile.qd, tile.qdd)]
            states.append(np.concatenate(signals, axis=1))
            held_out.append(prepared.kept_back(recording.name, tile.t_out).numpy())
            steps = tile.dt_out
    whole = [np.concatenate(parts) for parts in rows]
    rigid = [len(own) for own in columns.inertial]
    pi = [x[own].numpy() for own in columns.inertial]
    left = [r[:, -1] - r[:, :k] @ p for r, k, p in zip(whole, rigid, pi, strict=True)]
    return Series(
        joints=tuple(robot.joint_names),
        features=tuple(r[:, k:-1] for r, k in zip(whole, rigid, strict=True)),
        kinds=tuple(_kinds(prepared, joint) for joint in range(n)),
        residual=np.stack(left, axis=1),
        measured=np.stack([r[:, -1] for r in whole], axis=1),
        states=np.concatenate(states),
        held_out=np.concatenate(held_out),
        independent=min(1.0, prepared.filtering.effective_rate * steps),
    )


def _kinds(prepared: Prepared, joint: int) -> tuple[tuple[str, ...], ...]:
    """Return per feature column of a joint the ids of the effects that have it."""
    columns, found = prepared.columns, {}
    for c in (*columns.urdf_friction, *columns.candidates):
        for k in columns.of(c):
            found.setdefault(k, {})[c.effect.id] = None
    own = columns.of_joint[joint][len(columns.inertial[joint]) :].tolist()
    return tuple(tuple(found[k]) for k in own)


def sindy(X: np.ndarray, y: np.ndarray, independent: float) -> np.ndarray:
    """Return sequentially thresholded least squares' coefficients, the threshold chosen on the last quarter."""

    def fitted(threshold: float, n: int) -> np.ndarray:
        with warnings.catch_warnings():
            # It warns where a threshold leaves no term, or changes stay possible: both are answers.
            warnings.simplefilter("ignore")
            return STLSQ(threshold=threshold, alpha=RIDGE * n, max_iter=MOST_ROUNDS).fit(X[:n], y[:n, None]).coef_[0]

    n = 3 * len(y) // 4
    best = min(THRESHOLDS, key=lambda threshold: float(np.sum((y[n:] - X[n:] @ fitted(threshold, n)) ** 2)))
    return fitted(best, len(y))


def bic(X: np.ndarray, y: np.ndarray, independent: float) -> np.ndarray:
    """Return forward selection's coefficients: columns join while N log(RSS / N) + k log N falls, N independent."""
    n, chosen, w = independent * len(y), [], np.zeros(X.shape[1])
    rest, Q = y.copy(), X.copy()
    best = n * np.log(np.mean(y**2))
    while len(chosen) < MOST_TERMS:
        size = np.linalg.norm(Q, axis=0)
        # What is left of a column that the chosen ones make up is rounding.
        own = size > 1e-3 * len(y) ** 0.5
        gain = np.zeros(len(w))
        gain[own] = (Q[:, own].T @ rest / size[own]) ** 2
        k = int(gain.argmax())
        value = n * np.log(max(np.mean(rest**2) - gain[k] / len(y), 1e-300)) + (len(chosen) + 1) * np.log(n)
        if gain[k] == 0.0 or value >= best:
            break
        axis = Q[:, k] / size[k]
        rest, Q, best = rest - axis * (axis @ rest), Q - np.outer(axis, axis @ Q), value
        chosen.append(k)
    if chosen:
        w[chosen] = np.linalg.lstsq(X[:, chosen], y, rcond=None)[0]
    return w


def lasso(X: np.ndarray, y: np.ndarray, independent: float) -> np.ndarray:
    """Return LASSO's coefficients, the penalty chosen by cross-validation."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return LassoCV(alphas=30, cv=KFold(FOLDS), fit_intercept=False, max_iter=2000, tol=1e-3).fit(X, y).coef_


SPARSE = {"sindy": sindy, "bic": bic, "lasso": lasso}


def run_rivals(urdf: Path, fit: Iterable[Path], holdout: Iterable[Path]) -> dict[str, Any]:
    """Let every rival choose and predict.

    Returns:
        "errors": per method, squared error over variance of the torque per joint, "inside" and "outside"; "terms": per
        method and joint, for each chosen column the ids of the effects that have it.
    """
    s = read_series(urdf, fit, holdout)
    seen = ~s.held_out
    predicted = {"rigid body": np.zeros_like(s.residual), "network": network(s)}
    terms: dict[str, dict[str, list[tuple[str, ...]]]] = {}
    for name, method in SPARSE.items():
        predicted[name] = np.zeros_like(s.residual)
        for j, joint in enumerate(s.joints):
            X, y = s.features[j], s.residual[:, j]
            size, unit = np.sqrt(np.mean(X[seen] ** 2, axis=0)), max(float(np.sqrt(np.mean(y[seen] ** 2))), 1e-300)
            scaled = X / np.where(size > 0, size, 1.0)
            w = method(scaled[seen], y[seen] / unit, s.independent)
            predicted[name][:, j] = unit * (scaled @ w)
            terms.setdefault(name, {})[joint] = [s.kinds[j][k] for k in np.flatnonzero(w)]
    errors = {
        name: range_errors(s.residual - r, s.measured, s.states[:, : 2 * len(s.joints)], s.held_out)
        for name, r in predicted.items()
    }
    return {"errors": errors, "terms": terms}


def network(s: Series) -> np.ndarray:
    """Return a multilayer perceptron's prediction of the residual from the states, (M, n)."""
    seen = ~s.held_out
    states, torque = StandardScaler().fit(s.states[seen]), StandardScaler().fit(s.residual[seen])
    learner = MLPRegressor(hidden_layer_sizes=(64, 64), alpha=1e-2, early_stopping=True, max_iter=500, random_state=0)
    y = np.asarray(torque.transform(s.residual[seen]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        learner.fit(states.transform(s.states[seen]), y if y.shape[1] > 1 else y.ravel())
    told = np.asarray(learner.predict(states.transform(s.states))).reshape(len(s.states), -1)
    return np.asarray(torque.inverse_transform(told))
