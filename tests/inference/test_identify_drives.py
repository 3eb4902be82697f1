"""Robots whose torque is that of position drives: friction, rotors and the delay of their set-points."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from likelihood.arms import Torque, arm_urdf, driven_columns, wrong_robot
from simulated import joint_names

import torchrbd

pytestmark = pytest.mark.usefixtures("fit_alone")

URDF = arm_urdf(0, 2)
VISCOUS, COULOMB, ROTOR, WIDTH = np.array([0.4, 0.2]), np.array([1.0, 0.3]), np.array([0.2, 0.05]), 0.02
KP, KD = np.array([60.0, 25.0]), np.array([2.0, 0.8])
OPTIONS = {"duration_s": 20.0, "rate_hz": 200.0}


def friction_and_rotors(m) -> np.ndarray:
    return VISCOUS * m.qd + COULOMB * np.tanh(m.qd / WIDTH) + ROTOR * m.qdd


def case(folder: Path, delay_s: float, extra: Torque = friction_and_rotors, **drives: Mapping[str, float]) -> Path:
    """Write robot.urdf, map.yaml, fit.csv and test.csv; the URDF's inertias are wrong by a tenth."""
    names = joint_names(URDF)
    for name, seed in (("fit.csv", 2), ("test.csv", 5)):
        columns = driven_columns(URDF, seed, extra, KP, KD, delay_s=delay_s, **OPTIONS)
        pd.DataFrame(columns).to_csv(folder / name, index=False)
    given = {n: {"kp": p, "kd": d} | drives.get(n, {}) for n, p, d in zip(names, KP, KD, strict=True)}
    lines = [f"  {n}: {{drive: {{{', '.join(f'{k}: {v}' for k, v in keys.items())}}}}}" for n, keys in given.items()]
    (folder / "map.yaml").write_text("\n".join([f"set_point_delay: {delay_s}", "joints:", *lines]))
    return folder


@pytest.mark.parametrize("delay_s", [0.0, 0.012])
def test_friction_rotors_and_delay_are_identified_without_a_torque(tmp_path, delay_s):
    folder = case(tmp_path, delay_s)
    robot = wrong_robot(URDF, 1)
    found = torchrbd.identify(robot, folder / "fit.csv", holdout=folder / "test.csv", mapping=folder / "map.yaml")
    assert max(found.fits["extended"].nmse.values()) < 1e-3
    values = {p.name: p for p in found.parameters}
    for k, joint in enumerate(joint_names(URDF)):
        for name, truth in (
            (f"viscous_friction_{joint}.viscous", VISCOUS[k]),
            (f"coulomb_friction_{joint}.coulomb", COULOMB[k]),
        ):
            assert values[name].value == pytest.approx(truth, abs=max(4 * values[name].std, 0.02))
    # At the first joint a rotor and the inertia of the link are one.
    last = values[f"rotor_inertia_{joint_names(URDF)[1]}.rotor_inertia"]
    assert last.value == pytest.approx(ROTOR[1], abs=4 * last.std)


def test_a_saved_model_predicts_the_torque_that_was_reported(tmp_path):
    folder = case(tmp_path, 0.012)
    robot = wrong_robot(URDF, 1)
    found = torchrbd.identify(robot, folder / "fit.csv", holdout=folder / "test.csv", mapping=folder / "map.yaml")
    found.model.save(folder / "model.safetensors")
    again = torchrbd.replay(folder / "model.safetensors", folder / "test.csv", mapping=folder / "map.yaml")
    assert again.nmse == pytest.approx(found.fits["extended"].nmse, rel=1e-6)


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory):
    folder = case(tmp_path_factory.mktemp("driven"), 0.012)
    robot = wrong_robot(URDF, 1)
    return torchrbd.diagnose(robot, folder / "fit.csv", holdout=folder / "test.csv", mapping=folder / "map.yaml")


def test_rotors_of_drives_are_estimated_with_friction(diagnosis):
    found = {(f.effect, f.joints[0]): f for f in diagnosis.findings if f.joints}
    last = joint_names(URDF)[1]
    rotor = found["rotor_inertia", last].parameters["rotor_inertia"]
    assert rotor.value == pytest.approx(ROTOR[1], abs=4 * rotor.std)
    assert {e for e, _ in found} <= {"viscous_friction", "coulomb_friction", "rotor_inertia"}
    assert not diagnosis.unexplained
