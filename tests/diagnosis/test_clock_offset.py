"""The offset of all joints' clocks as a finding: how sure, how large, what it is worth on held-out time."""

import numpy as np
import pytest
from likelihood.arms import recorded, wrong_robot
from likelihood.fits import OPTIONS, URDF, with_friction

from torchrbd import Diagnosis, diagnose
from torchrbd.export import write_diagnosis

pytestmark = pytest.mark.usefixtures("fit_alone")

LATE_S = 0.021
EFFECTS = ("viscous_friction", "asymmetric_coulomb_friction", "rotor_inertia", "time_delay", "actuator_lag")


def found(**off: float) -> Diagnosis:
    """Diagnose an arm whose torque is off in two recordings; the second one is held out."""
    one, other = (
        recorded(URDF, seed, with_friction(), name=name, **off, **OPTIONS) for seed, name in ((2, "fit"), (5, "other"))
    )
    return diagnose(wrong_robot(URDF, 1), one, holdout=[other], effects=EFFECTS)


def test_late_torque_of_all_joints_is_a_finding(tmp_path) -> None:
    diagnosis = found(delay_s=LATE_S)
    (late,) = (f for f in diagnosis.findings if f.effect == "time_delay")
    assert (late.joints, late.links, late.where.recordings) == ((), (), None)
    assert late.probability > 0.99
    assert late.parameters["delay"].value == pytest.approx(LATE_S, abs=2.0 * late.parameters["delay"].std)
    assert late.parameters["delay"].unit == "s"
    assert late.share > 0.9
    assert "Time delay" in late.statement
    assert "time delay" in diagnosis.statement
    # By first order, d dtau/dt is what is moved.
    series = diagnosis.identification.series
    for j, joint in enumerate(series.joints):
        first = series.recording == 0
        slope = np.gradient(series.measured[first, j], series.t[first])
        assert late.torque_rms[joint] == pytest.approx(LATE_S * np.sqrt(np.mean(slope**2)), rel=0.3)
    write_diagnosis(diagnosis, tmp_path / "diagnosis.json")
    assert '"time_delay"' in (tmp_path / "diagnosis.json").read_text()


def test_clocks_that_agree_are_none() -> None:
    diagnosis = found()
    assert not [f for f in (*diagnosis.findings, *diagnosis.not_confirmed) if f.effect == "time_delay"]


def test_a_command_that_all_actuators_follow_is_a_lag() -> None:
    diagnosis = found(lag_s=2 * LATE_S)
    (lag,) = (f for f in diagnosis.findings if f.family == "actuator and sensor")
    assert (lag.effect, lag.joints) == ("actuator_lag", ())
    assert lag.probability > 0.99
    assert lag.parameters["time_constant"].value == pytest.approx(2 * LATE_S, rel=0.05)
    assert lag.share > 0.9
    assert all(x < 2e-3 for x in diagnosis.identification.fits["extended"].nmse.values())
