"""Of every real robot the saved model has the reported error, replayed on the held-out rows."""

from pathlib import Path

import pytest
from real_sets import CASES, data_folder

import torchrbd
from torchrbd.report.files import write_files

FOLDER = data_folder()
pytestmark = [
    pytest.mark.skipif(FOLDER is None, reason="TORCHRBD_DATA names no folder of real recordings"),
    pytest.mark.usefixtures("fit_alone"),
]
QUICK = ("emps", "go2_leg", "pendulum", "ur10")


def by_time(names: list[str], quick: tuple[str, ...]) -> list[object]:
    return [pytest.param(name, marks=[] if name in quick else [pytest.mark.slow]) for name in names]


def replayed(how: str, name: str, into: Path) -> tuple[torchrbd.Identification, dict[str, float]]:
    """Return a result and, by joint, the error of its saved model on the rows that it was judged on."""
    assert FOLDER is not None
    case = CASES[name](FOLDER, into)
    held_out = {"holdout": case.holdout} if case.holdout else {}
    result = getattr(torchrbd, how)(case.robot, case.recordings, **held_out, **case.options)
    write_files(result, into)
    return getattr(result, "identification", result), torchrbd.replay(into, case.holdout or case.recordings).nmse


@pytest.mark.usefixtures("without_joint_figures")
@pytest.mark.parametrize("name", by_time(list(CASES), QUICK))
def test_identified(name: str, tmp_path: Path) -> None:
    result, nmse = replayed("identify", name, tmp_path)
    assert nmse == pytest.approx(result.fits["extended"].nmse, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CASES))
def test_diagnosed(name: str, tmp_path: Path) -> None:
    result, nmse = replayed("diagnose", name, tmp_path)
    assert nmse == pytest.approx(result.fits["extended"].nmse, rel=1e-6)
    # What a finding of clocks moves is in the exports too.
    words = " ".join(torchrbd.not_exported(torchrbd.load_model(tmp_path), "urdf"))
    assert all((c.delay_s == 0) or "the torque is" in words for c in result.model.conditions.values())
