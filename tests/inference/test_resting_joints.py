"""Joints that rest, turn one way only, or have no torque: never a friction that drives, nor one made of noise."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import real_recordings as real
from lxml import etree
from rest_motions import CASES, COULOMB, DEMO, JOINTS, VISCOUS, recorded, sines
from shortened import slow_but

import torchrbd
from torchrbd import RobotModel
from torchrbd.errors import RecordingError
from torchrbd.inference.identification import Identification

pytestmark = pytest.mark.usefixtures("fit_alone")

# The URDF's friction, off by a fifth: what joints at rest are to keep.
GIVEN = {name: {"damping": 1.2 * d, "friction": 0.8 * c} for name, d, c in zip(JOINTS, VISCOUS, COULOMB, strict=True)}
# Frictions that no data tell apart are as wide as their prior; those that are told err by chance and by the filter.
STDS = 4.0
# What motion in one direction cannot tell, friction from an offset, is so small a part of the torque's variance here.
UNKNOWN = 0.02


def urdf() -> bytes:
    root = etree.fromstring(DEMO.read_bytes())
    for joint in root.findall("joint"):
        if joint.get("name") in GIVEN:
            etree.SubElement(joint, "dynamics", {k: repr(float(v)) for k, v in GIVEN[joint.get("name")].items()})
    return etree.tostring(root)


def no_file_drives_a_joint(found: Identification) -> None:
    root = etree.fromstring(torchrbd.to_urdf(found.model))
    for one in root.iter("dynamics"):
        assert all(float(value) >= 0.0 for value in one.attrib.values()), dict(one.attrib)
    mjcf = etree.fromstring(torchrbd.to_mjcf(found.model))
    for one in (*mjcf.iter("joint"), *mjcf.iter("fixed")):
        for name in ("damping", "frictionloss", "armature"):
            assert all(float(x) >= 0.0 for x in one.get(name, "0").split()), dict(one.attrib)
    for p in found.parameters:
        if re.search(r"viscous$|coulomb|rotor_inertia", p.name):
            assert not p.value < 0.0, p


@pytest.mark.parametrize("case", CASES)
def test_friction_is_what_the_motion_tells(case: str) -> None:
    make, resting, silent = CASES[case]
    fitted, judged = make()
    found = torchrbd.identify(urdf(), fitted, holdout=judged)
    no_file_drives_a_joint(found)
    for joint, nmse in found.fits["extended"].nmse.items():
        assert nmse <= max(1.02 * found.fits["urdf"].nmse[joint], UNKNOWN) or joint in resting, joint
    at_rest = {note.split()[0] for note in found.notes if "does not move in these recordings" in note}
    assert at_rest == set(resting)
    parameters = {p.name: p for p in found.parameters}
    for name, viscous, coulomb in zip(JOINTS, VISCOUS, COULOMB, strict=True):
        d, c = parameters[f"viscous_friction_{name}.viscous"], parameters[f"coulomb_friction_{name}.coulomb"]
        if name in resting or name in silent:
            dynamics = etree.fromstring(torchrbd.to_urdf(found.model)).find(f"joint[@name='{name}']/dynamics")
            assert {k: float(v) for k, v in dynamics.attrib.items()} == pytest.approx(GIVEN[name], rel=1e-3)
        if name in resting:
            assert min(d.prior_share, c.prior_share) > 0.9
            assert c.std > GIVEN[name]["friction"]
        elif name not in silent:
            assert abs(d.value - viscous) < STDS * d.std + 0.01 * viscous, d
            assert abs(c.value - coulomb) < STDS * c.std + 0.01 * coulomb, c


def test_two_seconds_are_too_few() -> None:
    with pytest.raises(RecordingError, match=r"record about .* s more"):
        torchrbd.identify(urdf(), recorded(sines(1, 2.0), 0))


def test_a_constant_torque_is_no_friction() -> None:
    """An offset larger than friction, which pushes in one direction, is a term of its own."""
    table = recorded(sines(1, 20.0), 0)
    table["tau_joint4"] = table["tau_joint4"] + 2.0
    found = torchrbd.identify(urdf(), table)
    no_file_drives_a_joint(found)
    values = {p.name: p.value for p in found.parameters}
    assert values["coulomb_friction_joint4.coulomb"] == pytest.approx(COULOMB[3], rel=0.05)
    assert values["torque_offset_joint4.offset"] == pytest.approx(2.0, rel=0.05)


def test_uneven_friction_resists_in_both_directions() -> None:
    """Asked for by name, without an offset beside it: each direction has a friction of its own, and none pushes."""
    table = recorded(sines(1, 20.0), 0)
    table["tau_joint4"] = table["tau_joint4"] + 2.0
    found = torchrbd.identify(urdf(), table, effects=["viscous_friction", "asymmetric_coulomb_friction"])
    no_file_drives_a_joint(found)
    values = {p.name: p.value for p in found.parameters}
    assert values["asymmetric_coulomb_friction_joint4.coulomb_minus"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("estimator", slow_but(("ols",), ("ols", "ridge", "moments")))
def test_estimators_have_no_friction_that_drives_either(estimator: str) -> None:
    table = recorded(sines(1, 20.0).locked(2), 0)
    for j, name in enumerate(JOINTS):
        table[f"tau_{name}"] = table[f"tau_{name}"] - 2.0 * VISCOUS[j] * np.gradient(table[f"q_{name}"], table["t"])
    no_file_drives_a_joint(torchrbd.identify(urdf(), table, estimator=estimator))


REAL = {
    "emps": ("robot.urdf", ["train.csv"], ["pulses.csv"], {"cutoff_hz": 20.0}),
    "kuka_kr300": ("robot.urdf", ["A.csv", "B.csv"], ["C.csv"], {}),
    "panda": ("robot.urdf", ["exciting_traj.csv"], [], {}),
    "dfki_pendulum": ("robot.urdf", ["energy_shaping.csv"], [], {}),
    "ur10": ("robot.urdf", ["fit.csv"], ["holdout.csv"], {}),
}
# It is pushed by hand: no model of its torque predicts it.
PUSHED = ("dfki_pendulum",)
FOLDER = real.data_folder()


@pytest.mark.skipif(FOLDER is None, reason="TORCHRBD_DATA names no folder of real recordings")
@pytest.mark.parametrize("name", slow_but(("emps", "ur10"), REAL))
def test_real_robots_have_no_friction_that_drives(name: str) -> None:
    assert FOLDER is not None
    folder: Path = FOLDER / name
    robot, fitted, judged, options = REAL[name]
    holdout = {"holdout": [folder / one for one in judged]} if judged else {}
    found = torchrbd.identify(
        RobotModel.from_urdf(folder / robot), [folder / one for one in fitted], **holdout, **options
    )
    no_file_drives_a_joint(found)
    urdf_nmse, nmse = found.fits["urdf"].nmse, found.fits["extended"].nmse
    assert name in PUSHED or all(x < max(1.02 * urdf_nmse[joint], 1e-3) for joint, x in nmse.items())
