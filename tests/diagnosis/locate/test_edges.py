"""Normal equations of edges worked out from differences, against those of all columns."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis.locate.field import background, case

from torchrbd.diagnosis.locate.clock import Clock
from torchrbd.diagnosis.locate.edges import edge_equations
from torchrbd.diagnosis.locate.scene import Scene
from torchrbd.diagnosis.rows.regression import Fit


@pytest.fixture(scope="module")
def fit() -> Fit:
    return background(case(61))


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("sought", ["moments", "stretch", "speeds"])
def test_differences_say_the_same(fit: Fit, sought: str, count: int) -> None:
    samples, clock = fit.rows.samples, Clock(Scene.of(fit))
    middle, near = clock.starts[0] + 10.0, np.arange(-1.0, 1.0, 0.1)
    steps = {
        "moments": clock.fine.steps,
        "stretch": clock._steps(np.concatenate((middle + near, middle + 1.3 + near))),
        "speeds": (samples.qd[1] >= np.quantile(samples.qd[1], np.linspace(0, 1, 12))[:, None]).astype(float),
    }[sought]
    phi = {j: samples.rigid[j][:, 12 : 12 + count].T + 1.0 for j in (0, 2)}
    G, alone, score = edge_equations(fit, phi, steps)
    columns = {j: (steps[:, None] * f).reshape(len(steps) * count, -1) for j, f in phi.items()}
    for one, other in zip((G, alone, score), fit.equations(columns), strict=True):
        np.testing.assert_allclose(one.reshape(other.shape), other, rtol=0, atol=1e-9 * np.abs(other).max())
