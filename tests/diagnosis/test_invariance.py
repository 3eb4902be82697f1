"""What is told does not depend on how it is written: units of force, the sense of an axis, how long a second is.

tau = M(q) qdd + c + g + f(q, sign(qd)):   t -> c t, g -> g / c^2, masses -> c^2 masses leaves tau as it is
"""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from robot.random_robots import random_urdf
from shortened import fit_alone
from simulated import record, with_wrong_inertials

import torchrbd
from torchrbd import Diagnosis

pytestmark = pytest.mark.usefixtures("fit_alone")

SEED, JOINT = 5, "joint2"
TRUE = random_urdf(SEED, 3, kinds=("revolute",), branching=0.0, massless=0.0)
URDF = with_wrong_inertials(TRUE, SEED)
G = 9.81
Table = dict[str, np.ndarray]


def recorded() -> Table:
    """Record the arm with friction at all joints, and a spring at one."""
    found = record(
        TRUE, SEED, duration_s=20.0, rate_hz=125.0,
        extra=lambda m: 0.4 * np.sign(m.qd) + 0.5 * m.qd + np.array([0.0, 1.0, 0.0]) * (3.0 * m.q - 1.0),
    )  # fmt: skip
    chunk = next(iter(found.chunks(10**6)))
    columns = {"q": np.asarray(chunk.q), "tau": np.asarray(chunk.tau)}
    table = {f"{key}_{name}": x[:, j] for key, x in columns.items() for j, name in enumerate(found.joints)}
    return {"t": np.asarray(chunk.t), **table}


def with_inertia(factor: float) -> bytes:
    root = ElementTree.fromstring(URDF)
    for element in (*root.iter("mass"), *root.iter("inertia")):
        element.attrib.update({key: repr(factor * float(value)) for key, value in element.attrib.items()})
    return ElementTree.tostring(root)


def told(diagnosis: Diagnosis) -> dict[tuple[str, tuple[str, ...]], dict[str, tuple[float, float]]]:
    """Return the sizes of the findings, with standard deviations."""
    return {
        (f.effect, f.joints): {name: (value.value, value.std) for name, value in f.parameters.items()}
        for f in diagnosis.findings
    }


@pytest.fixture(scope="module")
def plain() -> Diagnosis:
    with fit_alone():
        return torchrbd.diagnose(URDF.encode(), recorded())


def assert_alike(found: Diagnosis, plain: Diagnosis, factors: dict[str, float], tolerance: float) -> None:
    """Expect the same findings, sizes by name so many times as large, to so many standard deviations."""
    expected, seen = told(plain), told(found)
    assert ("joint_spring", (JOINT,)) in expected
    assert seen.keys() == expected.keys()
    for place, parameters in expected.items():
        for name, (value, std) in parameters.items():
            factor = factors.get(name, 1.0)
            assert abs(seen[place][name][0] - factor * value) < tolerance * abs(factor) * std, (place, name)


@pytest.mark.slow
def test_units_of_force(plain: Diagnosis) -> None:
    table = {key: x * (1000.0 if key.startswith("tau") else 1.0) for key, x in recorded().items()}
    found = torchrbd.diagnose(with_inertia(1000.0), table)
    names = ("viscous", "coulomb", "stiffness", "offset", "coulomb_plus", "coulomb_minus")
    assert_alike(found, plain, dict.fromkeys(names, 1000.0), 0.02)


def test_the_sense_of_an_axis(plain: Diagnosis) -> None:
    root = ElementTree.fromstring(URDF)
    (joint,) = (one for one in root.iter("joint") if one.get("name") == JOINT)
    axis = joint.find("axis")
    assert axis is not None
    axis.set("xyz", " ".join(repr(-float(v)) for v in axis.get("xyz", "").split()))
    table = {key: -x if key.endswith(JOINT) else x for key, x in recorded().items()}
    assert_alike(torchrbd.diagnose(ElementTree.tostring(root), table), plain, {"rest_position": -1.0}, 0.02)


@pytest.mark.slow
def test_how_long_a_second_is(plain: Diagnosis) -> None:
    c = 3.0
    table = {key: c * x if key == "t" else x for key, x in recorded().items()}
    found = torchrbd.diagnose(with_inertia(c**2), table, gravity=[0.0, 0.0, -G / c**2])
    assert_alike(found, plain, {"viscous": c}, 1.5)


@pytest.mark.slow
def test_the_torque_of_a_joint_that_does_not_count(plain: Diagnosis) -> None:
    found = told(torchrbd.diagnose(URDF.encode(), recorded(), joints=["joint1", JOINT]))
    expected = {place: value for place, value in told(plain).items() if "joint3" not in place[1]}
    assert found.keys() == expected.keys()
    for place, parameters in expected.items():
        for name, (value, std) in parameters.items():
            assert abs(found[place][name][0] - value) < 2.0 * max(std, found[place][name][1]), (place, name)
