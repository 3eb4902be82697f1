"""Statistics files: what is identified from them is what recordings give, whatever the way that they were made."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from inference.problems import urdf_of
from simulated import joint_names, record

import torchrbd
from torchrbd import InputError, OptionError, merge_statistics, write_statistics
from torchrbd.inference.statistics import building
from torchrbd.inference.statistics import files as files_module
from torchrbd.inference.statistics import folder as folder_module
from torchrbd.inference.statistics.files import read_statistics, write_file
from torchrbd.inference.statistics.results import added

URDF = urdf_of(2, 3)
NAMES = ("monday", "tuesday", "sunday")
CUTOFF_HZ = 5.0


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with arm.urdf and three recordings of unequal length."""
    folder = tmp_path_factory.mktemp("case")
    (folder / "arm.urdf").write_text(URDF)
    for seed, name in enumerate(NAMES):
        (chunk,) = record(URDF, seed, duration_s=10.0 + 4.0 * seed).chunks(10**6)
        np.savez(folder / f"{name}.npz", t=chunk.t, q=chunk.q, tau=chunk.tau, joints=np.array(joint_names(URDF)))
    return folder


def recordings(case: Path) -> list[Path]:
    return [case / f"{name}.npz" for name in NAMES]


@pytest.fixture(scope="module")
def made(case: Path) -> list[Path]:
    return write_statistics(case / "arm.urdf", recordings(case), case / "stats", cutoff_hz=CUTOFF_HZ)


def assert_same(one: torchrbd.Identification, other: torchrbd.Identification) -> None:
    """Compare everything that two identifications say in numbers, to what the order of sums may change."""
    for a, b in zip(one.parameters, other.parameters, strict=True):
        assert a.name == b.name
        np.testing.assert_allclose([a.value, a.std, a.prior_share], [b.value, b.std, b.prior_share], rtol=1e-9)
    assert one.base_covariance is not None
    assert other.base_covariance is not None
    std = np.sqrt(np.diag(other.base_covariance))
    assert np.abs((one.base_covariance - other.base_covariance) / np.outer(std, std)).max() < 1e-9
    for name, fit in one.fits.items():
        np.testing.assert_allclose([*fit.nmse.values()], [*other.fits[name].nmse.values()], rtol=1e-9)
    assert (one.recordings, one.held_out, one.verdict) == (other.recordings, other.held_out, other.verdict)


def test_identify_is_the_same_from_statistics_and_from_recordings(case: Path, made: list[Path]) -> None:
    urdf = case / "arm.urdf"
    of_files = torchrbd.identify(urdf, made)
    merge_statistics(made, case / "all.stats")
    of_merged = torchrbd.identify(urdf, case / "all.stats")
    of_recordings = torchrbd.identify(urdf, recordings(case), estimator="moments", cutoff_hz=CUTOFF_HZ)
    assert_same(of_files, of_recordings)
    assert_same(of_merged, of_recordings)
    assert of_files.recordings == tuple(f"{name}.npz" for name in NAMES)
    assert "Of second moments alone" in of_files.regime.statement


def test_held_out_files_are_held_out(case: Path, made: list[Path]) -> None:
    found = torchrbd.identify(case / "arm.urdf", made[:2], holdout=made[2])
    expected = torchrbd.identify(
        case / "arm.urdf",
        recordings(case)[:2],
        holdout=recordings(case)[2],
        estimator="moments",
        cutoff_hz=CUTOFF_HZ,
    )
    assert found.held_out == "sunday.npz"
    assert_same(found, expected)


def test_moments_say_what_the_default_says_where_nothing_is_amiss(case: Path, made: list[Path]) -> None:
    of_files = torchrbd.identify(case / "arm.urdf", made)
    usual = torchrbd.identify(case / "arm.urdf", recordings(case), cutoff_hz=CUTOFF_HZ)
    assert usual.base_covariance is not None
    std = np.sqrt(np.diag(usual.base_covariance))
    apart = np.array([a.value - b.value for a, b in zip(of_files.base, usual.base, strict=True)]) / std
    assert np.abs(apart).max() < 2.0


def test_a_report_is_written_without_time_series(case: Path, made: list[Path], tmp_path: Path) -> None:
    torchrbd.write_report(torchrbd.identify(case / "arm.urdf", made), tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert text.count("Not drawn: only second moments are available.") == 3
    assert "was not recorded" not in text
    assert "Motion: simulated" not in text


def test_an_interrupted_run_goes_on_and_ends_with_the_same_files(
    case: Path, made: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual, calls = folder_module.statistics_of, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return usual(*arguments)

    monkeypatch.setattr(folder_module, "statistics_of", interrupted)
    urdf, given = case / "arm.urdf", recordings(case)
    with pytest.raises(KeyboardInterrupt):
        write_statistics(urdf, given, tmp_path, cutoff_hz=CUTOFF_HZ)
    assert [path.name for path in tmp_path.iterdir()] == ["monday.npz.stats"]
    (tmp_path / "tuesday.npz.stats").write_bytes(b"torn")
    found = write_statistics(urdf, given, tmp_path, cutoff_hz=CUTOFF_HZ)
    # monday is not made again.
    assert [one[1].name for one in calls] == ["monday.npz", "tuesday.npz", "tuesday.npz", "sunday.npz"]
    assert [path.read_bytes() for path in found] == [path.read_bytes() for path in made]


def test_other_options_and_other_content_are_made_anew(case: Path, tmp_path: Path) -> None:
    given = tmp_path / "monday.npz"
    shutil.copy(case / "monday.npz", given)

    def content(**options: object) -> bytes:
        (file,) = write_statistics(case / "arm.urdf", given, tmp_path / "stats", **{"cutoff_hz": 5.0, **options})
        return file.read_bytes()

    first = content()
    assert content() == first
    narrower = content(cutoff_hz=4.0)
    assert narrower != first
    assert content(time="0:8") not in (first, narrower)
    assert content(payload="monday.npz=0.5,0,0,0.1") != first
    shutil.copy(case / "tuesday.npz", given)
    assert content() != first


def test_merging_adds(made: list[Path], tmp_path: Path) -> None:
    parts = [read_statistics(file) for file in made]
    whole = merge_statistics(made, tmp_path / "all.stats")
    for joint, total in enumerate(whole.moments):
        torch.testing.assert_close(total.sum(0), sum(one.moments[joint].sum(0) for one in parts))
    torch.testing.assert_close(whole.torque.sum(0), sum(one.torque.sum(0) for one in parts))
    assert [one.name for one in whole.origins] == [f"{name}.npz" for name in NAMES]
    again = merge_statistics([tmp_path / "all.stats"], tmp_path / "again.stats")
    assert (tmp_path / "again.stats").read_bytes() == (tmp_path / "all.stats").read_bytes()
    assert again.origins == whole.origins


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"cutoff_hz": 7.0}, "cutoff_hz 5.0 and 7.0; make all with one --cutoff"),
        ({"robot": "other"}, "robot .* and other; they are of different robots"),
        (
            {"kinematics_sha256": "0"},
            "kinematics_sha256 .* and 0; their URDFs differ in joints, axes, placements, rotors",
        ),
        ({"gravity": (0.0, 9.81, 0.0)}, "gravity .*; make all with one --gravity"),
        ({"effects": ()}, r"effects .* and \(\); make all with the same --effects"),
        ({"time": (0.0, 3.0)}, "time None and .*; make all with the same --time"),
    ],
)
def test_what_was_made_differently_does_not_add(made: list[Path], change: dict[str, object], words: str) -> None:
    one, other = read_statistics(made[0]), read_statistics(made[1])
    other = dataclasses.replace(other, conditions=dataclasses.replace(other.conditions, **change))
    with pytest.raises(InputError, match=f"monday.npz.stats and .*tuesday.npz.stats cannot be used together: {words}"):
        added([one, other])


def test_the_same_recording_does_not_count_twice(made: list[Path]) -> None:
    with pytest.raises(InputError, match=r"'monday.npz' is in .*monday.npz.stats and in .*; give it once"):
        added([read_statistics(made[0])] * 2)


def test_files_that_do_not_fit_are_refused(case: Path, made: list[Path], tmp_path: Path) -> None:
    urdf, torn = case / "arm.urdf", tmp_path / "torn.stats"
    with pytest.raises(InputError, match=r"none.stats: no such file"):
        torchrbd.identify(urdf, tmp_path / "none.stats")
    torn.write_bytes(made[0].read_bytes()[:-8])
    with pytest.raises(InputError, match=r"torn.stats: is no statistics file, or is damaged"):
        torchrbd.identify(urdf, torn)
    found = read_statistics(made[0])
    write_file(dataclasses.replace(found, torque=found.torque * torch.nan), torn)
    with pytest.raises(InputError, match=r"torn.stats: is damaged .*not finite.*make it anew with 'torchrbd stats'"):
        torchrbd.identify(urdf, torn)
    torchrbd.save_model(torchrbd.identify(urdf, made).model, tmp_path / "model.stats")
    with pytest.raises(InputError, match=r"model.stats: is no statistics file; give those"):
        torchrbd.identify(urdf, tmp_path / "model.stats")
    scale = dataclasses.replace(found.scales[0], speed_max="fast")
    write_file(dataclasses.replace(found, scales=(scale, *found.scales[1:])), torn)
    with pytest.raises(InputError, match=r"torn.stats: is damaged .*'fast'.*make it anew with 'torchrbd stats'"):
        torchrbd.identify(urdf, torn)
    other = tmp_path / "other.urdf"
    other.write_text(urdf_of(5, 3))
    with pytest.raises(InputError, match=r"monday.npz.stats and what was asked for cannot be used together: "):
        torchrbd.identify(other, made)
    with pytest.raises(InputError, match=r"cutoff_hz 5.0 and 6.0; make all with one --cutoff"):
        torchrbd.identify(urdf, made, cutoff_hz=6.0)


@pytest.mark.parametrize("written", [files_module.FORMAT - 1, files_module.FORMAT + 1, "torchrbd-statistics-2"])
def test_files_of_another_format_are_refused_with_what_to_do(
    case: Path, made: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: object
) -> None:
    found, other = read_statistics(made[0]), tmp_path / "other.stats"
    with monkeypatch.context() as patched:
        patched.setattr(files_module, "FORMAT", written)
        write_file(found, other)
    words = (
        rf"other.stats: has format '?{written}'?, and this torchrbd reads format {files_module.FORMAT}; make it anew "
        r"with 'torchrbd stats', or use the torchrbd that made it"
    )
    for call in (lambda: torchrbd.identify(case / "arm.urdf", other), lambda: merge_statistics([*made, other], other)):
        with pytest.raises(InputError, match=words):
            call()


def test_files_of_one_format_add_whichever_version_of_the_package_made_them(
    case: Path, made: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torchrbd, "__version__", "9.9.dev1")
    for module in (files_module, building):
        monkeypatch.setattr(module, "__version__", "9.9.dev1", raising=False)
    (newer,) = write_statistics(case / "arm.urdf", recordings(case)[2], tmp_path, cutoff_hz=CUTOFF_HZ)
    whole = merge_statistics([*made[:2], newer], tmp_path / "all.stats")
    assert [one.name for one in whole.origins] == [f"{name}.npz" for name in NAMES]
    assert newer.read_bytes() == made[2].read_bytes()


def test_what_moments_cannot_do_is_said(case: Path, made: list[Path], tmp_path: Path) -> None:
    urdf, (monday, *_) = case / "arm.urdf", recordings(case)
    with pytest.raises(InputError, match=r"holds second moments, not rows; only 'torchrbd identify' takes them"):
        torchrbd.diagnose(urdf, made)
    with pytest.raises(OptionError, match=r"diagnose: estimator 'moments' has no intervals"):
        torchrbd.diagnose(urdf, monday, estimator="moments")
    with pytest.raises(OptionError, match=r"holds statistics, .*monday.npz does not; give either"):
        torchrbd.identify(urdf, [made[1], monday])
    with pytest.raises(OptionError, match=r"'ridge' needs recordings"):
        torchrbd.identify(urdf, made, estimator="ridge")
    with pytest.raises(OptionError, match=r"known loads are subtracted when statistics are made"):
        torchrbd.identify(urdf, made, payload="monday.npz=1,0,0,0")
    with pytest.raises(OptionError, match=r"statistics need --cutoff HZ, the same for all"):
        write_statistics(urdf, monday, tmp_path)
    with pytest.raises(OptionError, match=r"load_dependent_friction: depends on the load"):
        write_statistics(urdf, monday, tmp_path, cutoff_hz=5.0, effects="load_dependent_friction")
    with pytest.raises(OptionError, match=r"name the effect without a place"):
        write_statistics(urdf, monday, tmp_path, cutoff_hz=5.0, effects="viscous_friction@joint1")
    with pytest.raises(OptionError, match=r"is given twice; give it once"):
        write_statistics(urdf, [monday, monday], tmp_path, cutoff_hz=5.0)
    with pytest.raises(OptionError, match=r"stats: no recording; give at least one"):
        write_statistics(urdf, [], tmp_path, cutoff_hz=5.0)
    with pytest.raises(InputError, match=r"no statistics to add; give at least one file"):
        merge_statistics([], tmp_path / "all.stats")
    with pytest.raises(OptionError, match=r"payload for 'friday.npz', which is no recording here"):
        write_statistics(urdf, monday, tmp_path, cutoff_hz=5.0, payload="friday.npz=1,0,0,0")
    with pytest.raises(OptionError, match=r"holds statistics already"):
        write_statistics(urdf, made[0], tmp_path, cutoff_hz=5.0)
    with pytest.raises(OptionError, match=r"none.csv: no such file"):
        write_statistics(urdf, tmp_path / "none.csv", tmp_path, cutoff_hz=5.0)
