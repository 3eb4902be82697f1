"""Whether a residual depends on the states at all: a random forest of them, which knows no law, has to predict it.

Curves are over one signal, or two. Where none is found, errors may still be those of a law of many signals, or they may
be noise that lasts, such as the drift of a sensor. A forest of randomised trees predicts the former on left-out blocks
of the fitted time, and not the latter.

Source: Geurts, Ernst, Wehenkel, "Extremely randomized trees", Machine Learning 2006.
"""

from __future__ import annotations

import numpy as np

from torchrbd.diagnosis.held_out_checks import BLOCK_S
from torchrbd.diagnosis.proof import elpd_of_rows
from torchrbd.diagnosis.results import Elpd
from torchrbd.inference.physical.leave_out import FOLDS, contiguous_folds
from torchrbd.inference.results import TorqueSeries

# Trees, rows of a leaf at least, and rows at most, evenly spaced.
_TREES, _LEAF, _MOST_ROWS = 100, 5, 4000


def state_dependence(series: TorqueSeries, joint: int, model: str) -> Elpd:
    """Return what a forest of all states is worth as a model of a joint's residual, on left-out blocks of fitted time.

    Its inputs are q, qd and qdd of all joints, the direction of this joint, and the torque that is predicted for it.
    It is worth nothing where less than two seconds were fitted.

    Args:
        series: of all recordings.
        joint: its index.
        model: whose residual.
    """
    from sklearn.ensemble import ExtraTreesRegressor

    rows = np.flatnonzero(~series.held_out & np.isfinite(series.measured[:, joint]))
    rows = rows[:: max(1, len(rows) // _MOST_ROWS)]
    places = np.stack((series.recording[rows], np.floor(series.t[rows] / BLOCK_S)), 1)
    block = np.unique(places, axis=0, return_inverse=True)[1].ravel()
    if block.max(initial=0) == 0:
        return Elpd(0.0, 0.0, 0.0, 0.0, 0.0)
    fold = contiguous_folds(int(block.max()) + 1, FOLDS).numpy()[block]
    states = np.concatenate((series.q, series.qd, series.qdd), 1)[rows]
    own = np.stack((np.sign(series.qd[rows, joint]), series.predicted[model][rows, joint]), 1)
    inputs, left = np.concatenate((states, own), 1), series.residual(model)[rows, joint]
    before, after = np.zeros((2, len(rows)))
    for f in np.unique(fold):
        out = fold == f
        level = left[~out].mean()
        forest = ExtraTreesRegressor(_TREES, min_samples_leaf=_LEAF, random_state=0)
        before[out] = left[out] - level
        after[out] = before[out] - forest.fit(inputs[~out], left[~out] - level).predict(inputs[out])
    share = float(np.sqrt(np.mean((before - after) ** 2) / np.mean(series.measured[rows, joint] ** 2)))
    counted = np.ones(len(rows), dtype=bool)
    return elpd_of_rows(before[:, None], after[:, None], series.recording[rows], series.t[rows], counted, share)
