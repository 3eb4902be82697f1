"""Moments add only where their columns are the same, whatever their number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from inference.problems import urdf_of
from simulated import joint_names, record

import torchrbd
from torchrbd import InputError, OptionError, write_statistics
from torchrbd.dataset.columns import Columns
from torchrbd.effects import JointScale, known_effects
from torchrbd.inference.statistics import building
from torchrbd.inference.statistics.files import read_statistics
from torchrbd.inference.statistics.results import added

URDF = urdf_of(2, 2)
SHAPED = ("stribeck_friction", "one_sided_spring", "torque_ripple", "presliding_hysteresis", "time_varying_friction")
REFUSED = r"moments of two recordings would be of other columns; leave it out, or identify from the recordings with"


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """arm.urdf, and two recordings, the second of which covers a third of the range of the first."""
    folder = tmp_path_factory.mktemp("case")
    (folder / "arm.urdf").write_text(URDF)
    files = [folder / "arm.urdf"]
    for name, part in (("wide", 1.0), ("narrow", 1.0 / 3.0)):
        (chunk,) = record(URDF, 0, duration_s=10.0).chunks(10**6)
        files.append(folder / f"{name}.npz")
        np.savez(files[-1], t=chunk.t, q=part * chunk.q, tau=chunk.tau, joints=np.array(joint_names(URDF)))
    return files


@pytest.mark.parametrize("effect", SHAPED)
def test_effects_whose_columns_go_with_the_range_are_refused(case: list[Path], tmp_path: Path, effect: str) -> None:
    urdf, *given = case
    with pytest.raises(OptionError, match=f"{effect}: .*{REFUSED}"):
        write_statistics(urdf, given, tmp_path, cutoff_hz=5.0, effects=effect)
    assert not list(tmp_path.iterdir())
    with pytest.raises(OptionError, match=f"{effect}: .*{REFUSED}"):
        torchrbd.identify(urdf, given, estimator="moments", effects=["viscous_friction", effect])


def test_an_effect_is_refused_where_its_shapes_differ_and_nowhere_else() -> None:
    wide = JointScale(1.0, 1e-3, -1.0, 1.0, 10.0, 60.0, (20.0, 30.0))
    narrow = JointScale(0.3, 1e-2, 0.0, 0.4, 3.0, 20.0, (15.0, 20.0))
    differ = {e.id for e in known_effects().values() if e.shapes(wide) != e.shapes(narrow)}
    assert differ > set(SHAPED)
    for e in known_effects().values():
        settings = torchrbd.inference.Settings.from_mapping({"effects": [e.id]}, "test")
        if e.id in differ or e.uses_load:
            with pytest.raises(OptionError, match=f"{e.id}: "):
                building.moment_effects(settings)
        else:
            assert building.moment_effects(settings) == (e,)


def test_columns_of_one_number_that_mean_something_else_do_not_add(
    case: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(building, "moment_effects", lambda settings: settings.chosen_effects())
    urdf, *given = case
    files = write_statistics(urdf, given, tmp_path, cutoff_hz=5.0, effects="one_sided_spring")
    parts = [read_statistics(file) for file in files]
    assert [m.shape[1:] for m in parts[0].moments] == [m.shape[1:] for m in parts[1].moments]
    assert parts[0].labels != parts[1].labels
    with pytest.raises(InputError, match=r"wide.npz.stats has 'max\(q.*' at joint1, .*narrow.npz.stats has 'max\(q"):
        added(parts)
    columns = Columns(torchrbd.RobotModel.from_urdf(urdf), [known_effects()["one_sided_spring"]], parts[0].scales)
    assert len(parts[0].of_columns(columns)) == len(parts[0].blocks)
    with pytest.raises(InputError, match=r"narrow.npz.stats: moments are not of this robot's columns.*; make them"):
        parts[1].of_columns(columns)


def test_columns_are_kept_in_the_file(case: list[Path], tmp_path: Path) -> None:
    urdf, wide, _ = case
    (file,) = write_statistics(urdf, wide, tmp_path, cutoff_hz=5.0, effects=["joint_coupling", "coulomb_friction"])
    found = read_statistics(file)
    assert found.labels[0][:2] == ("qd", "sign(qd)")
    assert [len(own) + 10 * (2 - j) + 1 for j, own in enumerate(found.labels)] == [m.shape[-1] for m in found.moments]
    assert added([found]).labels == found.labels
