"""What features see of a fit: its load, and friction where a term that sees it is in the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import joint_names, record

from torchrbd.diagnosis.rows.regression import fitted
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.search.options import BACKGROUND
from torchrbd.diagnosis.search.select import Search
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.physics import Site, effect
from torchrbd.robot import RobotModel

VISCOUS, COULOMB, OFFSET = 0.3, 0.6, -0.2
KNOWN = {"damping": 0.1, "friction": 0.4}


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    """An arm with the same friction at every joint, of which the URDF knows some at the second."""
    urdf = random_urdf(5, 3, kinds=("revolute",), branching=0.0, massless=0.0)
    known = "".join(f' {name}="{value}"' for name, value in KNOWN.items())
    joints = urdf.split("</joint>")
    (where,) = (k for k, text in enumerate(joints) if 'name="joint2"' in text)
    joints[where] += f"<dynamics{known}/>"
    assert joint_names(urdf) == ["joint1", "joint2", "joint3"]

    def friction(motion) -> np.ndarray:
        return VISCOUS * motion.qd + COULOMB * np.sign(motion.qd) + OFFSET

    recording = record(urdf, 5, duration_s=20.0, rate_hz=125.0, extra=friction, torque_noise=1e-3)
    robot = RobotModel.from_urdf("</joint>".join(joints))
    return prepare(robot, [recording], Settings.from_mapping({}, "test"), ())


def seen(prepared: Prepared, more: Sequence[tuple[str, Site, dict[str, float]]]) -> np.ndarray:
    """Return the friction (n, 3) that features see beside the background and more terms."""
    samples = read_samples(prepared, prepared.fit().pi)
    columns, joints = samples.columns, range(3)
    background = [columns.candidate(effect(name), Site(joint), {}) for joint in joints for name in BACKGROUND]
    terms = (*background, *(columns.candidate(effect(name), *place) for name, *place in more))
    search = Search(samples, [effect(name) for name in BACKGROUND], prepared.prior)
    fit = search.loaded(fitted(samples, prepared.prior, terms))
    assert fit.rows.samples is search.grid.samples
    found = fit.rows.samples.columns.friction
    return np.zeros((3, 3)) if found is None else found.numpy()


@pytest.mark.parametrize(
    ("name", "site", "shape", "joints"),
    [
        ("torque_saturation", Site(1), {"limit": 2.0}, [1]),
        ("actuator_lag", Site(2), {}, [2]),
        ("time_delay", Site(), {"step": 0.02}, [0, 1, 2]),
    ],
)
def test_friction_is_seen_where_a_term_sees_it(
    name: str, site: Site, shape: dict[str, float], joints: list[int], prepared: Prepared
) -> None:
    """All of it, what the URDF knows too."""
    found = seen(prepared, [(name, site, shape)])
    expected = np.zeros((3, 3))
    expected[joints] = VISCOUS, COULOMB, OFFSET
    np.testing.assert_allclose(found, expected, atol=0.03)


def test_friction_is_no_evidence_elsewhere(prepared: Prepared) -> None:
    assert not seen(prepared, []).any()
    assert not seen(prepared, [("load_dependent_friction", Site(1), {})]).any()
