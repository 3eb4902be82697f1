"""Sums of statistics files: equal to what all files at once give, with one of them in memory at a time."""

from __future__ import annotations

import dataclasses
import gc
import weakref
from pathlib import Path

import numpy as np
import pytest
from inference.problems import urdf_of
from simulated import joint_names, record

import torchrbd
from torchrbd import InputError, OptionError, merge_statistics, write_statistics
from torchrbd._runtime.ranks import Ranks
from torchrbd.dataset.block_statistics import halvings
from torchrbd.errors import RecordingError
from torchrbd.inference.statistics import building, folder, merging, preparing
from torchrbd.inference.statistics.files import read_head, read_statistics, write_file
from torchrbd.inference.statistics.results import added

URDF = urdf_of(2, 2)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """arm.urdf, and four recordings of unequal length."""
    place = tmp_path_factory.mktemp("case")
    (place / "arm.urdf").write_text(URDF)
    for seed in range(4):
        (chunk,) = record(URDF, seed, duration_s=12.0 + 3.0 * seed).chunks(10**6)
        np.savez(place / f"run{seed}.npz", t=chunk.t, q=chunk.q, tau=chunk.tau, joints=np.array(joint_names(URDF)))
    return place


@pytest.fixture(scope="module")
def made(case: Path) -> list[Path]:
    return write_statistics(case / "arm.urdf", sorted(case.glob("*.npz")), case / "stats", cutoff_hz=5.0)


@pytest.mark.parametrize("most", [256, 50, 20, 7, 1])
def test_the_sum_is_that_of_all_files_at_once(
    made: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int
) -> None:
    whole = added([read_statistics(file) for file in made])
    times = halvings(whole.blocks, most)
    write_file(whole.halved(times), tmp_path / "expected.stats")
    monkeypatch.setattr(merging, "MOST_BLOCKS", most)
    merge_statistics(made, tmp_path / "merged.stats")
    folder.write_merged(made, tmp_path / "written.stats", Ranks())
    for name in ("merged", "written"):
        assert (tmp_path / f"{name}.stats").read_bytes() == (tmp_path / "expected.stats").read_bytes()


def test_what_is_fitted_is_the_sum(case: Path, made: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(merging, "MOST_BLOCKS", 30)
    monkeypatch.setattr(preparing, "MOST_BLOCKS", 30)
    robot = torchrbd.RobotModel.from_urdf(case / "arm.urdf")
    settings = torchrbd.inference.Settings()
    of_files, of_recordings = (
        preparing.prepare_moments(robot, files, options, lambda *_: None).statistics
        for files, options in (
            (made, settings),
            (sorted(case.glob("*.npz")), torchrbd.inference.Settings(cutoff_hz=5.0)),
        )
    )
    assert 10 < len(of_files.blocks) <= 30
    assert of_files.blocks == of_recordings.blocks
    for a, b in zip((*of_files.moments, of_files.torque), (*of_recordings.moments, of_recordings.torque), strict=True):
        assert bool((a == b).all())


@pytest.mark.slow
def test_one_file_is_in_memory_at_a_time(
    case: Path, made: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual, read = merging.read_statistics, []

    def watched(path):
        gc.collect()
        assert [one for one in read if one() is not None] == []
        found = usual(path)
        read.extend(map(weakref.ref, found.moments))
        return found

    monkeypatch.setattr(merging, "read_statistics", watched)
    merge_statistics(made, tmp_path / "all.stats")
    folder.write_merged(made, tmp_path / "all.stats", Ranks())
    torchrbd.identify(case / "arm.urdf", made)
    assert len(read) == 3 * len(made) * 2


def test_heads_have_all_but_the_numbers(made: list[Path]) -> None:
    for file in made:
        head, whole = read_head(file), read_statistics(file)
        assert (head.conditions, head.origins, head.scales, head.labels, head.blocks) == (
            whole.conditions, whole.origins, whole.scales, whole.labels, whole.blocks,
        )  # fmt: skip
        assert [m.shape for m in head.moments] == [(0, *m.shape[1:]) for m in whole.moments]
        assert head.torque.shape == (0, 2, 3)


def test_where_the_sum_goes_is_looked_at_first(
    case: Path, made: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_):
        raise AssertionError

    run = case / "run0.npz"
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.stats").mkdir()
    with monkeypatch.context() as patched:
        patched.setattr(folder, "statistics_of", never)
        patched.setattr(merging, "read_statistics", never)
        for name, words in (
            ("file/all.stats", "its folder cannot be made"),
            ("folder.stats", "is a folder; name a file"),
        ):
            with pytest.raises(OptionError, match=f"output '.*{name}'.*{words}"):
                write_statistics(case / "arm.urdf", run, tmp_path / "made", cutoff_hz=5.0, merged=tmp_path / name)
            with pytest.raises(OptionError, match=f"output '.*{name}'.*{words}"):
                merge_statistics(made, tmp_path / name)
        assert not (tmp_path / "made").exists()
    write_statistics(case / "arm.urdf", run, tmp_path / "made", cutoff_hz=5.0, merged=tmp_path / "no" / "all.stats")
    merge_statistics(made, tmp_path / "new" / "all.stats")
    assert (tmp_path / "no" / "all.stats").read_bytes() == (tmp_path / "made" / "run0.npz.stats").read_bytes()
    assert read_head(tmp_path / "new" / "all.stats").origins == added([read_head(file) for file in made]).origins


def test_a_mapping_that_is_not_there_is_an_error_even_where_files_are(case: Path, made: list[Path]) -> None:
    for given in ("typo.yaml", "."):
        with pytest.raises(RecordingError, match=r"(typo.yaml|\.): cannot read the mapping"):
            write_statistics(case / "arm.urdf", case / "run0.npz", case / "stats", cutoff_hz=5.0, mapping=given)
        with pytest.raises(RecordingError, match="cannot read the mapping"):
            torchrbd.identify(case / "arm.urdf", made, mapping=given)


def test_content_is_looked_at_only_for_files(case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def counted(path):
        seen.append(path)
        return 1, "0"

    monkeypatch.setattr(building, "digest", counted)
    run = case / "run0.npz"
    torchrbd.identify(case / "arm.urdf", run, estimator="moments", cutoff_hz=5.0)
    assert seen == []
    (file,) = write_statistics(case / "arm.urdf", run, tmp_path, cutoff_hz=5.0)
    assert seen == [run]
    assert [(one.size, one.sha256) for one in read_head(file).origins] == [(1, "0")]


def test_damage_is_told_of_heads_too(made: list[Path], tmp_path: Path) -> None:
    found, torn = read_statistics(made[0]), tmp_path / "torn.stats"
    first, *others = found.moments
    for bad in (first[:-1], first[..., :-1], first.float()):
        write_file(dataclasses.replace(found, moments=(bad, *others)), torn)
        with pytest.raises(InputError, match=r"torn.stats: is damaged .*moments are no.*make it anew"):
            merge_statistics([torn], tmp_path / "all.stats")
