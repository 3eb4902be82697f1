"""What the fit takes as known and the likelihood leaves open is in the intervals: friction that may be uneven."""

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import inverse_dynamics, multisine, record, with_wrong_inertials

import torchrbd

pytestmark = pytest.mark.usefixtures("fit_alone")

EFFECTS = ["viscous_friction", "coulomb_friction", "asymmetric_coulomb_friction", "joint_spring", "torque_offset"]
SEED, JOINT, REST, STIFFNESS, UNEVEN = 92, 1, 0.3, 0.15, 0.02


def test_where_a_spring_rests_is_as_open_as_whether_friction_differs_by_direction() -> None:
    urdf = random_urdf(SEED, 3, kinds=("revolute",), branching=0.0, massless=0.0)
    rms = np.sqrt(np.mean(inverse_dynamics(urdf, multisine(3, SEED, duration_s=10.0, rate_hz=50.0)) ** 2, 0))

    def extra(motion) -> np.ndarray:
        tau = 0.1 * rms * (np.sign(motion.qd) + motion.qd)
        tau[:, JOINT] += rms[JOINT] * (STIFFNESS * (motion.q[:, JOINT] - REST) + UNEVEN * (motion.qd[:, JOINT] > 0))
        return tau

    noise = {"torque_noise": 0.02, "encoder_noise": 5e-5}
    recording = record(urdf, SEED, extra=extra, duration_s=20.0, rate_hz=125.0, **noise)
    found = torchrbd.diagnose(with_wrong_inertials(urdf, SEED), recording, effects=EFFECTS)
    (spring,) = [f for f in found.findings if f.effect == "joint_spring"]
    stiffness, rest = (spring.parameters[name] for name in ("stiffness", "rest_position"))
    assert abs(stiffness.value - STIFFNESS * rms[JOINT]) < 1.96 * stiffness.std < 0.1 * stiffness.value
    assert abs(rest.value - REST) < 1.96 * rest.std
    # Half of what differs by direction is a constant torque, which moves the rest by as much.
    assert rest.std > 0.5 * UNEVEN / STIFFNESS
