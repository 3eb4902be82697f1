"""Which blocks are kept back, how that is told, and what is said where too little is left."""

from __future__ import annotations

import re

import numpy as np
import pytest
import torch
from inference.problems import urdf_of
from simulated import record

from torchrbd.dataset.block_statistics import Block
from torchrbd.errors import OptionError, RecordingError
from torchrbd.inference.data.holdout import check_enough, held_out_recordings, held_out_runs
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.recordings import Recording, survey
from torchrbd.robot import RobotModel


def blocks_of(*counts: int, block_s: float = 1.0) -> list[Block]:
    """Return blocks of recordings a, b, ... with a sample every millisecond."""
    return [
        Block(name, k * block_s, (k + 1) * block_s - 1e-3)
        for name, count in zip("abc", counts, strict=False)
        for k in range(count)
    ]


def prepared_of(*recordings: Recording, **options) -> Prepared:
    robot = RobotModel.from_urdf(urdf_of(0, 2))
    return prepare(robot, list(recordings), Settings(cutoff_hz=5.0, **options), [])


@pytest.mark.parametrize("fraction", [0.1, 0.25, 0.5])
@pytest.mark.parametrize("seed", range(3))
def test_share_is_the_fraction_and_seeds_differ(fraction: float, seed: int) -> None:
    held, _ = held_out_runs(blocks_of(400), fraction, seed)
    assert float(held.double().mean()) == pytest.approx(fraction, abs=0.01)
    assert not torch.equal(held, held_out_runs(blocks_of(400), fraction, seed + 1)[0])


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        ((9,), "22 % of the time, 6 to 8 s of a"),
        ((16,), "25 % of the time, in 2 runs of up to 2 s"),
        ((7, 9), "25 % of the time, in 3 runs of up to 2 s"),
        ((2,), "100 % of the time, 0 to 2 s of a"),
    ],
)
def test_words_say_what_is_held_out(counts: tuple[int, ...], words: str) -> None:
    held, said = held_out_runs(blocks_of(*counts), 0.25, 0)
    assert said == words
    assert float(said.split(" %")[0]) == pytest.approx(100 * float(held.double().mean()), abs=0.5)


def test_opened_recordings_are_held_out_like_files() -> None:
    robot = RobotModel.from_urdf(urdf_of(0, 2))
    fitted, kept = (record(urdf_of(0, 2), seed, name=f"{seed}.csv", duration_s=12.0) for seed in (0, 1))
    options = {"cutoff_hz": 5.0}
    for holdout in (kept, [kept], (kept,)):
        settings = Settings.from_mapping({"holdout": holdout, **options}, "test")
        found = prepare(robot, [fitted], settings, [])
        assert (found.fitted, found.holdout_words) == (("0.csv",), "1.csv")
    same = Settings.from_mapping({"holdout": [kept, fitted], **options}, "test")
    with pytest.raises(OptionError, match=r"^0.csv is both fitted and held out; leave it out of one list$"):
        prepare(robot, [fitted], same, [])


def test_recordings_at_rest_judge_nothing() -> None:
    robot = RobotModel.from_urdf(urdf_of(0, 2))
    moving, other = (record(urdf_of(0, 2), seed, name=f"{seed}.csv", duration_s=12.0) for seed in (0, 1))
    chunk = next(iter(other.chunks(10**6)))
    t, q, tau = (np.asarray(x) for x in (chunk.t, chunk.q, chunk.tau))
    noise = 1e-5 * np.random.default_rng(0).standard_normal(q.shape)
    still = Recording.from_arrays("still.csv", other.joints, t, 0.3 + noise, tau)
    off = Recording.from_arrays("off.csv", other.joints, t, q, 0.0 * tau)
    for kept in ([still], [off], [still, off]):
        names = ", ".join(one.name for one in kept)
        with pytest.raises(RecordingError, match=rf"^nothing moves in what is held out \({names}\), or no torque"):
            prepare(robot, [moving], Settings(cutoff_hz=5.0, holdout=tuple(kept)), [])
    assert prepare(robot, [moving], Settings(cutoff_hz=5.0, holdout=(still, other)), []).fitted == ("0.csv",)


def test_whole_recordings() -> None:
    held, words = held_out_recordings(blocks_of(2, 3, 1), ["c", "b"])
    assert held.tolist() == [False] * 2 + [True] * 4
    assert words == "b, c"


@pytest.mark.parametrize("n_blocks", range(8))
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("fraction", [None, 0.1, 0.25, 0.5])
def test_what_is_said_to_be_needed_is_enough_and_no_more(n_blocks: int, seed: int, fraction: float | None) -> None:
    def held_of(n: int) -> torch.Tensor:
        return torch.zeros(n) > 0 if fraction is None else held_out_runs(blocks_of(n), fraction, seed)[0]

    runs = None if fraction is None else (fraction, seed)
    if int((~held_of(n_blocks)).sum()) >= 6:
        check_enough(held_of(n_blocks), "x", 2.0, 5.0, runs)
        return
    with pytest.raises(RecordingError) as refused:
        check_enough(held_of(n_blocks), "x", 2.0, 5.0, runs)
    (seconds,) = re.findall(r"record about (\d+) s more", str(refused.value))
    more = round(float(seconds) / 2.0)
    check_enough(held_of(n_blocks + more), "x", 2.0, 5.0, runs)
    assert int((~held_of(n_blocks + more - 1)).sum()) < 6


def test_short_recording_is_enough_with_the_seconds_that_it_lacked() -> None:
    urdf = urdf_of(0, 2)
    with pytest.raises(
        RecordingError, match=r"\d blocks of 1 s are left to fit; .* needed: record about \d s more"
    ) as refused:
        prepared_of(record(urdf, 3, duration_s=4.0))
    (seconds,) = re.findall(r"record about (\d+) s more", str(refused.value))
    assert prepared_of(record(urdf, 3, duration_s=4.0 + float(seconds))).training.torque.any()


def test_encoder_noise_that_was_found_is_kept_beside_what_the_user_says() -> None:
    urdf = urdf_of(0, 2)
    quiet, loud = (
        record(urdf, seed, name=f"{seed}", duration_s=12.0, encoder_noise=noise)
        for seed, noise in ((1, 1e-4), (2, 3e-4))
    )
    told, untold = (prepared_of(quiet, loud, encoder_noise=noise, estimator="physical") for noise in (5e-3, None))
    expected = np.sqrt(np.mean([survey(r).q_noise_std ** 2 for r in (quiet, loud)], axis=0))
    for prepared in (told, untold):
        np.testing.assert_allclose(prepared.found_encoder_noise, expected, rtol=1e-12)
    np.testing.assert_allclose(expected, np.sqrt((1e-8 + 9e-8) / 2), rtol=0.2)
    np.testing.assert_allclose(told.input_noise.encoder_std, 5e-3)
    np.testing.assert_allclose(untold.input_noise.encoder_std, expected, rtol=1e-12)
