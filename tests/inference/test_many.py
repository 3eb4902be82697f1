"""Many identifications at once are those of a loop, whichever process does them, and a bad one is told as such."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from inference.problems import urdf_of
from simulated import record, with_wrong_inertials

import torchrbd
from torchrbd.effects import registry
from torchrbd.effects.viscous_friction import ViscousFriction
from torchrbd.errors import OptionError, RecordingError, RobotError
from torchrbd.inference.identification import Identification
from torchrbd.inference.many import Outcome, identify_and, identify_many
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

URDF = urdf_of(2, 2)
GIVEN = with_wrong_inertials(URDF, 1).encode()
OPTIONS = {"effects": [], "cutoff_hz": 5.0}
pytestmark = pytest.mark.usefixtures("without_simulation")


class OwnFriction(ViscousFriction):
    """An effect that torchrbd does not bring along."""

    id = "own_friction"


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    return [record(URDF, seed, name=f"day{seed}", duration_s=12.0) for seed in range(3)]


@pytest.fixture
def own_friction() -> Iterator[str]:
    torchrbd.register(OwnFriction())
    yield OwnFriction.id
    del registry._EFFECTS[OwnFriction.id]


def numbers(found: Identification) -> np.ndarray:
    told = [[p.value, p.std, p.prior_share] for p in (*found.parameters, *found.base)]
    errors = [[*fit.nmse.values(), *fit.rmse.values()] for fit in found.fits.values()]
    series = [found.series.measured, *found.series.predicted.values(), found.model.pi.detach().numpy()]
    return np.concatenate([np.ravel(part) for part in (told, errors, *series)])


def same(one: Identification, other: Identification) -> bool:
    """Say whether two identifications agree; sums depend in the last digit on where in memory their terms lie."""
    assert [p.name for p in one.parameters] == [p.name for p in other.parameters]
    return np.allclose(numbers(one), numbers(other), rtol=1e-12, atol=1e-12, equal_nan=True)


def met(folder: Path, found: Identification, _: object) -> tuple[int, Identification]:
    """Return the process too, once two have identified something."""
    (folder / str(os.getpid())).touch()
    end = time.monotonic() + 120.0
    while len(list(folder.iterdir())) < 2:
        assert time.monotonic() < end
        time.sleep(0.01)
    return os.getpid(), found


def test_another_process_finds_the_same(recordings: list[Recording], own_friction: str, tmp_path: Path) -> None:
    options = OPTIONS | {"effects": ["coulomb_friction", own_friction]}
    loop = [torchrbd.identify(GIVEN, recording, **options) for recording in recordings]
    found = identify_and(partial(met, tmp_path), GIVEN, recordings, "identify", options, jobs=2)
    assert [one.error for one in found] == [None] * 3
    values = [one.value for one in found if one.value is not None]
    assert len({process for process, _ in values}) == 2
    assert all(same(one, other) for one, (_, other) in zip(loop, values, strict=True))
    assert not any(same(one, other) for one, (_, other) in zip(loop, [*values[1:], values[0]], strict=True))


def test_a_bad_recording_does_not_stop_the_others(recordings: list[Recording], tmp_path: Path) -> None:
    first, second, third = recordings
    given = [first, tmp_path / "none.csv", [second, third]]
    told: list[tuple[str, float]] = []
    good, bad, both = identify_many(
        GIVEN, given, jobs=1, progress=lambda words, part: told.append((words, part)), **OPTIONS
    )
    assert [one.name for one in (good, bad, both)] == ["day0", "none.csv", "day1, day2"]
    assert same(good.result(), torchrbd.identify(GIVEN, first, **OPTIONS))
    assert both.result().recordings == ("day1", "day2")
    assert bad.identification is None
    assert isinstance(bad.error, RecordingError)
    with pytest.raises(RecordingError, match=r"none\.csv: no such file"):
        bad.result()
    assert good.error is None
    assert 0 < good.seconds < both.seconds + 60
    assert [part for _, part in told] == pytest.approx([0, 1 / 3, 2 / 3, 1])
    assert told[0][0] == "identified 0 of 3"
    assert told[-1][0] == "identified 2 of 3, 1 failed"


@pytest.mark.slow
def test_each_recording_may_have_its_robot(recordings: list[Recording], tmp_path: Path) -> None:
    other = RobotModel.from_urdf(with_wrong_inertials(URDF, 2).encode(), gravity=(0.0, 0.0, -9.81))
    robots = [GIVEN, other, tmp_path / "leg.urdf"]
    found = identify_many(robots, recordings, jobs=1, **OPTIONS)
    assert isinstance(found[2].error, RobotError)
    for robot, recording, one in zip(robots[:2], recordings, found, strict=False):
        assert same(one.result(), torchrbd.identify(robot, recording, **OPTIONS))


@pytest.mark.slow
def test_gravity_is_that_of_every_robot_given_by_its_urdf(recordings: list[Recording]) -> None:
    options = OPTIONS | {"gravity": (0.0, 9.81, 0.0)}
    (found,) = identify_many(GIVEN, recordings[0], **options)
    assert found.result().robot.gravity.tolist() == [0.0, 9.81, 0.0]
    (again,) = identify_many([GIVEN], recordings[:1], **options)
    assert same(found.result(), again.result())


def test_no_recording_is_no_outcome() -> None:
    assert identify_many(GIVEN, []) == []


ROBOT = RobotModel.from_urdf(GIVEN)
BAD: dict[str, tuple[object, object, dict[str, object], type[Exception], str]] = {
    "robot": (b"<robot", ["a.csv"], {}, RobotError, "XML"),
    "numbers": ([GIVEN, GIVEN], ["a.csv"], {}, OptionError, "2 robots for 1 recordings; give one for all"),
    "option of several": ([GIVEN], ["a.csv"], {"kappa": -1}, OptionError, "kappa is -1"),
    "joint": (GIVEN, ["a.csv"], {"joints": ["jointX"]}, OptionError, "no moving joint 'jointX'"),
    "link": (GIVEN, ["a.csv"], {"trust": ["linkX"]}, OptionError, "no moving link 'linkX'"),
    "noise": (GIVEN, ["a.csv"], {"encoder_noise": {"jointX": 1}}, OptionError, "no moving joint 'jointX'"),
    "effect": (GIVEN, ["a.csv"], {"effects": ["friction"]}, OptionError, "unknown effect 'friction'"),
    "gravity": (ROBOT, ["a.csv"], {"gravity": (0, 0, -9.81)}, OptionError, "identify_many: a RobotModel has its own"),
    "jobs": (GIVEN, ["a.csv"], {"jobs": 0}, OptionError, "jobs is 0"),
    "entry": (
        GIVEN,
        ["a.csv", 5],
        {},
        OptionError,
        "recording 1 is of type int; expected a file",
    ),
    "entry of entry": (
        GIVEN,
        [["a.csv", None]],
        {},
        OptionError,
        "entry 0 of .*2 is of type NoneType",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_fails_for_all_is_told_at_once(name: str) -> None:
    robots, recordings, options, error, words = BAD[name]
    with pytest.raises(error, match=words):
        identify_many(robots, recordings, **options)  # type: ignore[arg-type]


def test_an_error_of_the_progress_ends_the_work(recordings: Sequence[Recording]) -> None:
    seen = []

    def stop(words: str, part: float) -> None:
        seen.append(words)
        if part > 0:
            raise ValueError("enough")

    with pytest.raises(ValueError, match="enough"):
        identify_many(GIVEN, recordings, jobs=1, progress=stop, **OPTIONS)
    assert seen == ["identified 0 of 3", "identified 1 of 3"]


def test_an_outcome_that_failed_raises_what_it_met() -> None:
    with pytest.raises(KeyError, match="met"):
        Outcome("day", None, KeyError("met"), 1.0).result()
