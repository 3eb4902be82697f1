"""Check that files come in as they are, and that unusable ones say why."""

import subprocess
import sys
import textwrap

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv, parquet
from recordings.motion import JOINTS, clean_recording, motion, torque

from torchrbd.errors import RecordingError
from torchrbd.recordings import Recording, open_recording, survey

CLOCK = np.arange(0, 3, 0.005)


def table():
    """Return the motion as a table; columns in another order than the robot's."""
    q, tau = motion(CLOCK)[0], torque(CLOCK)
    return pa.table({"q_b": q[:, 1], "tau_b": tau[:, 1], "t": CLOCK + 1e5, "q_a": q[:, 0], "tau_a": tau[:, 0]})


def rows(recording, size=100):
    chunks = list(recording.chunks(size))
    return tuple(np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in ("t", "q", "tau"))


def test_csv_parquet_npz_and_arrays_are_the_same(tmp_path):
    csv.write_csv(table(), tmp_path / "r.csv")
    parquet.write_table(table(), tmp_path / "r.parquet", row_group_size=130)
    arrays = {"t": CLOCK + 1e5, "q": motion(CLOCK)[0][:, ::-1], "tau": torque(CLOCK)[:, ::-1], "joints": ["b", "a"]}
    np.savez(tmp_path / "r.npz", **arrays)
    np.savez_compressed(tmp_path / "c.npz", **{k: np.asfortranarray(v) for k, v in arrays.items()})
    expected = rows(clean_recording(CLOCK + 1e5, q=motion(CLOCK)[0], tau=torque(CLOCK)))
    assert expected[0][0] == 0
    for name in ("r.csv", "r.parquet", "r.npz", "c.npz"):
        recording = open_recording(tmp_path / name, JOINTS)
        assert (recording.name, recording.joints, recording.has_velocity) == (name, JOINTS, False)
        for _ in range(2):
            for got, want in zip(rows(recording), expected, strict=True):
                assert np.array_equal(got, want)


@pytest.mark.parametrize(
    "text",
    [
        "t,q_a,q_b,tau_a,tau_b\n0,1,2,3,4\n0.1,1.5,2,3,\n",
        "\ufefft, q_a, q_b, tau_a, tau_b\r\n0, 1, 2, 3, 4\r\n0.1, 1.5, 2, 3, nan\r\n",
        "t;q_a;q_b;tau_a;tau_b\n0;1;2;3;4\n0,1;1,5;2;3;\n",
        "t\tq_a\tq_b\ttau_a\ttau_b\n0\t1\t2\t3\t4\n0.1\t1.5\t2\t3\tNaN\n",
        "t q_a q_b tau_a tau_b\n0 1 2 3 4\n0.1 1.5 2 3 nan\n",
        "# robot: x\n# t,q_a,q_b,tau_a,tau_b\n0,1,2,3,4\n0.1,1.5,2,3,null\n",
        '"t","q_a","q_b","tau_a","tau_b","remark"\n0,1,2,3,4,ok\n0.1,1.5,2,3,,"a, b"\n',
    ],
)
def test_csv_dialects(tmp_path, text):
    (tmp_path / "r.csv").write_bytes(text.encode())
    t, q, tau = rows(open_recording(tmp_path / "r.csv", JOINTS))
    assert np.array_equal(t, [0, 0.1])
    assert np.array_equal(q, [[1, 2], [1.5, 2]])
    assert np.array_equal(tau, [[3, 4], [3, np.nan]], equal_nan=True)


def test_time_window_counts_from_the_first_row(tmp_path):
    csv.write_csv(table(), tmp_path / "r.csv")
    t, _, _ = rows(open_recording(tmp_path / "r.csv", JOINTS, time=(1.0, 2.0)))
    assert t[[0, -1]] == pytest.approx([1.0, 2.0])
    with pytest.raises(RecordingError, match="between 7 and 8 s"):
        survey(open_recording(tmp_path / "r.csv", JOINTS, time=(7.0, 8.0)))
    with pytest.raises(RecordingError, match="time 2:1 s is empty"):
        open_recording(tmp_path / "r.csv", JOINTS, time=(2.0, 1.0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "t,q_a,qb,tau_a\n0,1,2,3\n",
            r"r.csv: missing columns: q_b \(did you mean 'qb'\?\); present: t, q_a, qb, tau_a;",
        ),
        ("t,q_a,tau_a,tau_b\n0,1,2,3\n", "r.csv: missing columns: q_b; present: t, q_a, tau_a, tau_b;"),
        ("t,q_a,q_b\n0,1,2\n", "no joint has a torque; expected at least one of tau_a, tau_b; present: t, q_a, q_b"),
        ("t,q_a,q_b,tau_a\n0,1,2,3\n1,1,x,3\n", "column 'q_b', data row 2: expected a number, got 'x'"),
        ("t,q_a,q_b,tau_a\n0,1,2,3\n1,1,3\n", "data row 2 has 3 cells, but the header has 4 columns"),
        ("t,q_a,q_b,tau_a\n0,1,2,3\n1,1,inf,3\n", "column 'q_b', data row 2: infinite value"),
        ("t,q_a,q_b,tau_a\n0,1,2,3\n1,1,2,3\n.5,1,2,3\n", "data row 3: time goes backwards, to 0.5 s"),
        ("0,1,2,3\n1,1,2,3\n", "the first row holds numbers; expected a header"),
        ("t,q_a,q_b,tau_a\n", "a header but no rows"),
        ("t,q_a,q_a,q_b,tau_a\n0,1,1,2,3\n", "column 'q_a' appears more than once"),
        ("", "the file is empty"),
        ("# nothing\n", "no header found"),
        ("\x00\x01\x02\n\x03\n", "missing columns"),
    ],
)
def test_unusable_csv(tmp_path, text, message):
    path = tmp_path / "r.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=message) as caught:
        list(open_recording(path, JOINTS).chunks())
    assert str(path) in str(caught.value)


def test_backwards_across_chunks():
    t = np.arange(10.0)
    t[6] = 2.5
    with pytest.raises(RecordingError, match=r"data row 7: time goes backwards, to 2\.5 s"):
        list(clean_recording(t).chunks(3))


def test_unusable_files(tmp_path):
    def fails(name, message):
        with pytest.raises(RecordingError, match=message):
            list(open_recording(tmp_path / name, JOINTS).chunks())

    fails("missing.csv", "no such file")
    fails("r.xlsx", "cannot read '.xlsx' files; expected .csv, .parquet, .npz")
    for name in ("bad.parquet", "bad.npz"):
        (tmp_path / name).write_bytes(b"no such thing")
    fails("bad.parquet", "not a readable Parquet file")
    fails("bad.npz", "not a readable NPZ file")
    text = table().set_column(0, "q_b", pa.array(["x"] * len(CLOCK)))
    parquet.write_table(text, tmp_path / "text.parquet")
    fails("text.parquet", "column 'q_b' holds string; expected numbers")
    good = {"t": CLOCK, "q": motion(CLOCK)[0], "tau": torque(CLOCK), "joints": list(JOINTS)}
    np.savez(tmp_path / "shape.npz", **{**good, "tau": torque(CLOCK)[:-1]})
    fails("shape.npz", r"array 'tau' has shape \(599, 2\); expected \(600, 2\)")
    np.savez(tmp_path / "names.npz", **{key: value for key, value in good.items() if key != "joints"})
    fails("names.npz", "'joints' with the joints' names is missing")
    np.savez(tmp_path / "object.npz", **{**good, "q": np.array([None, 1], dtype=object)})
    fails("object.npz", "array 'q' holds object; expected numbers")


def test_arrays_of_wrong_shape():
    with pytest.raises(RecordingError, match=r"x: tau has shape \(3, 1\); expected \(3, 2\)"):
        Recording.from_arrays("x", JOINTS, np.arange(3), np.zeros((3, 2)), np.zeros((3, 1)))


def test_notes_name_what_is_left_aside(tmp_path):
    columns = {"temperature_a": CLOCK, "q_link_a": CLOCK, "wrench_x": CLOCK, "mood": CLOCK, "qd_a": CLOCK}
    extra = table()
    for name, values in columns.items():
        extra = extra.append_column(name, pa.array(values))
    parquet.write_table(extra, tmp_path / "r.parquet")
    recording = open_recording(tmp_path / "r.parquet", JOINTS)
    said = [*map(str, recording.notes)]
    assert said == ["qd is not used: it is there for some joints only", "columns not used: mood"]


@pytest.mark.slow
def test_memory_stays_bounded(tmp_path):
    """A Parquet file of one huge row group streams in far less memory than it holds."""
    count = 400_000
    t = np.arange(count) * 0.001
    columns = {"t": t} | {
        f"{key}_{joint}": np.sin(t * 3 + i) for i, joint in enumerate("abcdefg") for key in ("q", "tau")
    }
    path = tmp_path / "big.parquet"
    parquet.write_table(pa.table(columns), path, row_group_size=count, compression="none", use_dictionary=False)
    program = """
        import resource, sys
        from torchrbd.recordings import Filtering, open_recording, survey, tiles
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        recording = open_recording(sys.argv[1], list("abcdefg"))
        seen = survey(recording)
        count = sum(part.decimate(part.tau).shape[1] for part in tiles(recording, seen, Filtering(5.0)))
        print(count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    """
    command = [sys.executable, "-c", textwrap.dedent(program), str(path)]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    outputs, kilobytes = map(int, result.stdout.split())
    assert outputs > 4900
    scale = 1 if sys.platform == "linux" else 1024  # macOS counts bytes
    assert kilobytes / scale < 200_000
