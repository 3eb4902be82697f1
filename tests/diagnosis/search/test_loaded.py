"""What features see of a fit: its load and its friction."""

from __future__ import annotations

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


def test_features_see_all_friction_that_is_found(prepared: Prepared) -> None:
    """What the URDF knows of it too."""
    samples = read_samples(prepared, prepared.fit().pi)
    columns = samples.columns
    terms = [columns.candidate(effect(name), Site(joint), {}) for joint in range(3) for name in BACKGROUND]
    search = Search(samples, [effect(name) for name in BACKGROUND], prepared.prior)
    fit = search.loaded(fitted(samples, prepared.prior, terms))
    assert fit.rows.samples is search.grid.samples
    friction = fit.rows.samples.columns.friction
    assert friction is not None
    np.testing.assert_allclose(friction.numpy(), np.tile((VISCOUS, COULOMB, OFFSET), (3, 1)), atol=0.03)
