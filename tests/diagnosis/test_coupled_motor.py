"""A wrist whose last motor moves two joints is named, with its ratio, friction and rotor; uncoupled ones are not."""

import numpy as np
import pytest
from robot.random_robots import random_urdf
from shortened import slow_but
from simulated import inverse_dynamics, multisine, record, with_wrong_inertials

import torchrbd
from torchrbd.recordings import Recording

pytestmark = pytest.mark.usefixtures("fit_alone")

JOINTS, OWN, OTHER = 4, 3, 2
# What such a motor may be taken for.
RIVALS = [
    "coupled_motor", "viscous_friction", "coulomb_friction", "stribeck_friction", "rotor_inertia", "joint_coupling",
    "joint_spring", "torque_offset",
]  # fmt: skip
MOTION = {"duration_s": 20.0, "rate_hz": 125.0}


def recorded(urdf: str, seed: int, ratio: float | None) -> tuple[Recording, dict[str, float]]:
    """Record an arm with friction at all joints, that of the last one its motor's, and say how large that is."""
    rms = np.sqrt(np.mean(inverse_dynamics(urdf, multisine(JOINTS, seed, duration_s=10.0, rate_hz=50.0)) ** 2, 0))
    viscous, coulomb, inertia = 0.1 * rms[OWN], 0.1 * rms[OWN], 0.03 * rms[OWN]

    def extra(motion) -> np.ndarray:
        tau = 0.05 * rms * (np.sign(motion.qd) + motion.qd)
        if ratio is not None:
            omega, change = (x[:, OWN] + ratio * x[:, OTHER] for x in (motion.qd, motion.qdd))
            force = viscous * omega + coulomb * np.sign(omega) + inertia * change
            tau[:, OWN] = force
            tau[:, OTHER] += ratio * force
        return tau

    noise = {"torque_noise": 0.02, "encoder_noise": 5e-5}
    return record(urdf, seed, extra=extra, **noise, **MOTION), {
        "viscous": viscous, "coulomb": coulomb, "rotor_inertia": inertia
    }  # fmt: skip


@pytest.mark.parametrize(
    ("seed", "ratio", "effects"),
    slow_but([(72, -1.0, RIVALS)], [(72, -1.0, RIVALS), (71, 1.0, None), (72, -1.0, None), (73, 1.0, None)]),
)
def test_a_motor_of_two_joints_is_named_with_its_numbers(seed: int, ratio: float, effects: list[str] | None) -> None:
    urdf = random_urdf(seed, JOINTS, kinds=("revolute",), branching=0.0, massless=0.0)
    recording, truth = recorded(urdf, seed, ratio)
    found = torchrbd.diagnose(with_wrong_inertials(urdf, seed), recording, effects=effects)
    (one,) = [f for f in found.findings if f.effect == "coupled_motor"]
    assert one.joints == ("joint4", "joint3")
    assert one.parameters["ratio"].value == pytest.approx(ratio)
    for name, value in truth.items():
        assert one.parameters[name].value == pytest.approx(value, rel=0.1)
