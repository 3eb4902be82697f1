"""Real robots. The long proofs leave every recording out in turn; the short ones judge one split."""

from pathlib import Path

import pytest
import real_recordings as real

import torchrbd
from torchrbd import Diagnosis

FOLDER = real.data_folder()
pytestmark = pytest.mark.skipif(FOLDER is None, reason="TORCHRBD_DATA names no folder of real recordings")
FRICTION = {"viscous_friction", "coulomb_friction", "asymmetric_coulomb_friction", "stribeck_friction"}


@pytest.fixture(scope="module")
def folder() -> Path:
    assert FOLDER is not None
    return FOLDER


def joints_with_friction(diagnosis: Diagnosis) -> set[str]:
    return {joint for f in diagnosis.findings if f.effect in FRICTION for joint in f.joints}


def check_kuka(diagnosis: Diagnosis) -> None:
    fits = diagnosis.identification.fits
    assert fits["extended"].mean_nmse < 0.16
    assert fits["extended"].mean_nmse < fits["rigid_body"].mean_nmse / 3
    assert joints_with_friction(diagnosis) == {f"A{k}" for k in range(1, 7)}


def test_kuka_one_split(folder: Path) -> None:
    arm = folder / "kuka_kr300"
    check_kuka(torchrbd.diagnose(arm / "robot.urdf", [arm / "A.csv", arm / "B.csv"], holdout=[arm / "C.csv"]))


@pytest.mark.slow
def test_kuka_all_splits(folder: Path) -> None:
    for diagnosis in real.kuka(folder).diagnoses.values():
        check_kuka(diagnosis)


@pytest.mark.slow
def test_double_pendulum_from_wrong_inertials(folder: Path) -> None:
    result = real.double_pendulum(folder, "A")
    assert result.nmse("extended").mean() < 0.05
    for diagnosis in result.diagnoses.values():
        for name, value in real.first_moments(diagnosis, real.LINK_LENGTH["A"]).items():
            assert value == pytest.approx(real.PUBLISHED_FIRST_MOMENTS[name], rel=0.1)


@pytest.mark.slow
def test_double_pendulum_with_wrong_lengths(folder: Path) -> None:
    right, wrong = real.double_pendulum(folder, "A"), real.double_pendulum(folder, "C")
    assert wrong.nmse("extended").mean() > 1.3 * right.nmse("extended").mean()
    for diagnosis in wrong.diagnoses.values():
        assert diagnosis.verdict != "consistent"
        assert {joint for u in diagnosis.unexplained for joint in u.joints} == {"shoulder", "elbow"}
        assert all(u.where.region for u in diagnosis.unexplained)
