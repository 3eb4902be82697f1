"""A base that leans shows what a level one hides: where the first body has its centre of mass.

A first joint that turns about the vertical does not feel gravity. On a base that leans it does, and of its body's first
moment nothing but the URDF tells: what that has wrong stands beside the tilt as a torque of its own.
"""

from __future__ import annotations

import pytest
from shortened import slow_but
from simulated import record

import torchrbd

pytestmark = pytest.mark.usefixtures("fit_alone")

# What a tilt may be taken for.
RIVALS = [
    "base_tilt", "viscous_friction", "coulomb_friction", "torque_offset", "torque_scale", "joint_spring", "payload",
    "encoder_offset", "geometry_error",
]  # fmt: skip
TILT = {"tilt_x": 0.004, "tilt_y": -0.006}


def upright_arm(first_centre: float, tilt: dict[str, float] | None = None) -> str:
    """Return an arm of three links on a vertical axis; that of the first body's mass is so far [m] off its axis."""
    lean = f"{tilt['tilt_x']} {tilt['tilt_y']} 0" if tilt else "0 0 0"
    origins, axes, centres = (f"0 0 .2|{lean}", "0 0 .3|0 0 0", "0 0 .4|0 0 0"), "zyy", (first_centre, 0.02, 0.01)
    joints, links = [], ['<link name="l0"/>']
    for k, (origin, axis, centre) in enumerate(zip(origins, axes, centres, strict=True)):
        xyz, rpy = origin.split("|")
        turns = " ".join(str(int(axis == name)) for name in "xyz")
        joints.append(
            f'<joint name="j{k}" type="revolute"><origin xyz="{xyz}" rpy="{rpy}"/><parent link="l{k}"/>'
            f'<child link="l{k + 1}"/><axis xyz="{turns}"/>'
            '<limit lower="-3" upper="3" effort="99" velocity="9"/></joint>'
        )
        links.append(
            f'<link name="l{k + 1}"><inertial><origin xyz="{centre} 0 .15"/><mass value="{4 - k}"/>'
            '<inertia ixx=".05" ixy="0" ixz="0" iyy=".05" iyz="0" izz=".02"/></inertial></link>'
        )
    return f'<robot name="upright">{"".join(links + joints)}</robot>'


@pytest.mark.parametrize("effects", slow_but((RIVALS,), (RIVALS, None)), ids=["rivals", "all"])
def test_the_first_bodys_centre_of_mass_is_no_torque_of_its_own(effects: list[str] | None) -> None:
    recording = record(upright_arm(0.06, TILT), 4, duration_s=20.0, rate_hz=125.0, torque_noise=2e-3)
    result = torchrbd.diagnose(upright_arm(0.02), recording, effects=effects)
    (found,) = result.findings
    assert found.effect == "base_tilt"
    for name, true in TILT.items():
        q = found.parameters[name]
        assert q.std is not None
        assert q.value == pytest.approx(true, abs=3 * q.std + 0.01 * abs(true))
