"""LeRobot data sets, laid out as version 3 has them: frames of all episodes in Parquet files, names in info.json."""

import json

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from recordings.motion import JOINTS, motion, torque

from torchrbd.errors import RecordingError
from torchrbd.recordings import Mapping, open_recording, survey
from torchrbd.recordings.mapping import Source

FPS, LENGTHS = 50, (120, 90, 60)


def feature(dtype, width, names=None):
    return {"dtype": dtype, "shape": [width], "names": names}


def data_set(path, names=JOINTS, effort="observation.effort", lists=pa.list_):
    """Write three episodes into two files, the second episode in both."""
    clocks = [np.arange(length) / FPS for length in LENGTHS]
    t = np.concatenate(clocks)
    q, tau = (np.concatenate([f(clock) for clock in clocks]) for f in (lambda t: motion(t)[0], torque))
    episode = np.repeat(np.arange(len(LENGTHS)), LENGTHS)
    columns = {
        "observation.state": pa.array(list(q.astype("f4")), lists(pa.float32())),
        effort: pa.array(list(tau.astype("f4")), lists(pa.float32())),
        "timestamp": pa.array(t.astype("f4")),
        "frame_index": pa.array(np.concatenate([np.arange(length) for length in LENGTHS])),
        "episode_index": pa.array(episode),
        "index": pa.array(np.arange(len(t))),
        "task_index": pa.array(np.zeros(len(t), dtype=int)),
    }
    table, half = pa.table(columns), LENGTHS[0] + 30
    (path / "data/chunk-000").mkdir(parents=True)
    for k, part in enumerate((table[:half], table[half:])):
        parquet.write_table(part, path / f"data/chunk-000/file-{k:03d}.parquet", row_group_size=50)
    info = {
        "codebase_version": "v3.0",
        "fps": FPS,
        "total_episodes": len(LENGTHS),
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "features": {
            "observation.state": feature("float32", 2, names),
            effort: feature("float32", 2, list(JOINTS)),
            "observation.images.top": {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "rgb"]},
            **{name: feature("int64", 1) for name in ("frame_index", "episode_index", "index", "task_index")},
            "timestamp": feature("float32", 1),
        },
    }
    (path / "meta").mkdir()
    (path / "meta/info.json").write_text(json.dumps(info))
    return path


def episodes(path, **options):
    """Return the segments of a recording as (duration, q, tau)."""
    recording = open_recording(path, JOINTS, **options)
    t, q, tau = (np.concatenate([getattr(chunk, name) for chunk in recording.chunks(70)]) for name in ("t", "q", "tau"))
    starts = np.flatnonzero(np.diff(t, prepend=-np.inf) > 0.5)
    pieces = zip(starts, (*starts[1:], len(t)), strict=True)
    return [(t[start:end] - t[start], q[start:end], tau[start:end]) for start, end in pieces]


def are_the_motion(found, lengths=LENGTHS):
    assert [len(t) for t, _, _ in found] == list(lengths)
    for t, q, tau in found:
        np.testing.assert_allclose(t, np.arange(len(t)) / FPS, atol=1e-6)
        np.testing.assert_allclose(q, motion(t)[0], atol=1e-5)
        np.testing.assert_allclose(tau, torque(t), atol=1e-4)


@pytest.mark.parametrize("lists", [pa.list_, lambda kind: pa.list_(kind, 2)])
def test_episodes_are_segments(tmp_path, lists):
    path = data_set(tmp_path / "set", lists=lists)
    are_the_motion(episodes(path))
    found = survey(open_recording(path, JOINTS))
    assert found.rate_hz == pytest.approx(FPS, rel=1e-4)
    lengths = [end - start for start, end in found.segments]
    assert lengths == pytest.approx([(n - 1) / FPS for n in LENGTHS], abs=1.1 / FPS)


def test_chosen_episodes(tmp_path):
    path = data_set(tmp_path / "set")
    are_the_motion(episodes(path, mapping=Mapping(episodes=(0, 2))), (LENGTHS[0], LENGTHS[2]))
    with pytest.raises(RecordingError, match="episodes: there is no 3; the set has 3, numbered from 0"):
        open_recording(path, JOINTS, mapping=Mapping(episodes=(3,)))


def test_names_as_other_robots_have_them(tmp_path):
    mapping = Mapping(joints={"*": {"tau": Source("observation.current/{joint}")}})
    path = data_set(tmp_path / "set", {"motors": [f"{joint}.pos" for joint in JOINTS]}, "observation.current")
    are_the_motion(episodes(path, mapping=mapping))
    with pytest.raises(RecordingError, match=r"no joint has a torque; .* present: t, .*observation.current/a"):
        open_recording(path, JOINTS)
    are_the_motion(episodes(data_set(tmp_path / "endings", {"motors": [f"{joint}.pos" for joint in JOINTS]})))
    path = data_set(tmp_path / "nameless", None)
    every = {"q": Source("observation.state[{index}]")}
    are_the_motion(episodes(path, mapping=Mapping(joints={"*": every | {"tau": Source("observation.effort/{joint}")}})))


def test_sets_that_cannot_be_read(tmp_path):
    path = data_set(tmp_path / "set")
    info = path / "meta/info.json"
    content = json.loads(info.read_text())
    file = path / "data/chunk-000/file-001.parquet"

    def fails(words, **changes):
        info.write_text(json.dumps(content | changes))
        with pytest.raises(RecordingError, match=words):
            list(open_recording(path, JOINTS).chunks())

    features = content["features"]
    fails("has no 'features'; expected a LeRobot data set", features=None)
    fails("'timestamp' is missing", features={name: f for name, f in features.items() if name != "timestamp"})
    wide = features | {"observation.state": feature("float32", 3, [*JOINTS, "c"])}
    fails("column 'observation.state': expected 3 numbers in each row", features=wide)
    file.write_bytes(file.read_bytes()[:200])
    fails("file-001.parquet: not a readable Parquet file")
    info.write_text("{")
    with pytest.raises(RecordingError, match="cannot be read as JSON"):
        open_recording(path, JOINTS)
