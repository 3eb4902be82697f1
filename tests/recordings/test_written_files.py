"""Files that other libraries have written, each with the script that wrote it: tests/recordings/files."""

from pathlib import Path

import numpy as np
import pytest

from torchrbd.recordings import open_recording, survey

FILES = Path(__file__).parent / "files"
RATE_HZ = 20


def motion(t):
    """Return what the scripts write: positions and torques (N, 2) at times (N,)."""
    phase = np.outer(t, (2.0, 5.0)) + np.array([0.2, 1.1])
    return np.sin(phase), 3.0 * np.cos(phase)


def read(path):
    recording = open_recording(path, ["a", "b"])
    return recording, *(np.concatenate([getattr(c, name) for c in recording.chunks(16)]) for name in ("t", "q", "tau"))


def test_lerobot():
    """A data set of version 3 by lerobot 0.4.4: each episode begins anew, and is a segment."""
    recording, t, q, tau = read(FILES / "lerobot/set")
    assert len(t) == 60
    for own in (slice(0, 30), slice(30, 60)):
        clock = np.arange(30) / RATE_HZ
        np.testing.assert_allclose(t[own] - t[own][0], clock, atol=1e-6)
        for found, expected in zip((q[own], tau[own]), motion(clock), strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-6)
    assert len(survey(recording).segments) == 2
    (note,) = map(str, recording.notes)
    assert note == "columns not used: frame_index, episode_index, index, task_index"


@pytest.mark.parametrize("name", ["arrays", "structure", "columns"])
def test_matlab(name):
    """Files of version 7.3 by hdf5storage 0.2.2."""
    _, t, q, tau = read(FILES / f"matlab/{name}.mat")
    np.testing.assert_array_equal(t, np.arange(40) / RATE_HZ)
    for found, expected in zip((q, tau), motion(t), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-14)
