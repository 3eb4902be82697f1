"""The errors of findings are those of the table of models, where the model is the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from diagnosis.test_unexplained import FIRST, MAY, diagnosed
from likelihood.fits import URDF, at_joint
from simulated import Motion, record

import torchrbd
from torchrbd.diagnosis import explain as explaining
from torchrbd.diagnosis.explain import explain
from torchrbd.diagnosis.results import HELD_OUT, Elpd, Finding
from torchrbd.inference.physical.fitting import judge

pytestmark = pytest.mark.usefixtures("fit_alone")

DRAG = "quadratic_drag"


def check(findings: Sequence[Finding], nmse: Mapping[str, float]) -> None:
    assert findings
    for one in findings:
        assert one.judged_on == HELD_OUT
        assert one.nmse_after == pytest.approx({joint: nmse[joint] for joint in one.nmse_after}, rel=1e-3), one.effect


def test_every_finding_has_the_error_of_the_table() -> None:
    """Of joints that stick: rows near rest weigh less in the fit, and count alike in all errors."""

    def extra(motion: Motion) -> np.ndarray:
        return np.sign(motion.qd) * [0.9, 0.7] + motion.q * [0.0, 8.0]

    found = torchrbd.diagnose(URDF, record(URDF, 3, extra=extra, duration_s=20.0), seed=1)
    assert not found.not_confirmed
    assert {"coulomb_friction", "joint_spring"} <= {one.effect for one in found.findings}
    check(found.findings, found.identification.fits["extended"].nmse)


def test_findings_are_judged_in_the_model_that_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a law that is not confirmed, the model is fitted anew."""
    model = diagnosed(at_joint(0, lambda m: 2.0 * m.qd[:, 0] * np.abs(m.qd[:, 0])), (12.0,), MAY)
    (drag,) = model.terms
    assert drag.effect.id == DRAG

    worthless = Elpd(3.0, 4.0, 0.5, 0.01, 0.3)
    monkeypatch.setattr(explaining, "backward_elimination", lambda *_: {drag: worthless})
    found = explain(model)
    assert found.model.terms == ()
    assert [(one.effect, one.elpd) for one in found.not_confirmed if one.effect == DRAG] == [(DRAG, worthless)]
    assert FIRST in {joint for one in found.findings for joint in one.joints}
    check(found.findings, judge(found.model.prepared.judging, found.model.model.x).nmse)
