"""Tables and dicts of arrays are read as files are, with the same complaints."""

import numpy as np
import pandas as pd
import pytest
import torch
from recordings.motion import JOINTS, motion, torque

from torchrbd.errors import RecordingError
from torchrbd.recordings import InMemory, Mapping, listed_sources, open_recording, survey
from torchrbd.recordings.mapping import Source

CLOCK = np.arange(0, 3, 0.005)
Q, TAU = motion(CLOCK)[0], torque(CLOCK)
COLUMNS = {"q_b": Q[:, 1], "tau_b": TAU[:, 1], "t": CLOCK + 1e5, "q_a": Q[:, 0], "tau_a": TAU[:, 0]}
ARRAYS = {"t": CLOCK + 1e5, "q": Q, "tau": TAU}


class Bare:
    """The least that a table must have."""

    columns = tuple(COLUMNS)

    def __getitem__(self, name):
        return pd.Series(COLUMNS[name])


def rows(recording, size=100):
    chunks = list(recording.chunks(size))
    return tuple(np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in ("t", "q", "tau"))


@pytest.mark.parametrize(
    "data",
    [
        pd.DataFrame(COLUMNS),
        pd.DataFrame(COLUMNS).astype("Float64"),
        pd.DataFrame(COLUMNS).astype(object),
        Bare(),
        COLUMNS,
        {name: values.tolist() for name, values in COLUMNS.items()},
        {name: torch.from_numpy(values).requires_grad_() for name, values in COLUMNS.items()},
        ARRAYS,
        ARRAYS | {"q": Q[:, ::-1], "tau": TAU[:, ::-1], "joints": ["b", "a"]},
        ARRAYS | {"joints": np.array(JOINTS)},
        {name: torch.from_numpy(values) for name, values in ARRAYS.items()},
        ARRAYS | {"q": pd.DataFrame(Q)},
    ],
)
def test_data_in_memory_are_what_a_file_is(tmp_path, data):
    pd.DataFrame(COLUMNS).to_csv(tmp_path / "r.csv", index=False)
    for _ in range(2):
        recording = open_recording(data, JOINTS, name="here")
        for got, want in zip(rows(recording), rows(open_recording(tmp_path / "r.csv", JOINTS)), strict=True):
            np.testing.assert_array_equal(got, want)
    assert (recording.name, recording.path, recording.joints, recording.notes) == ("here", None, JOINTS, ())


def test_optional_arrays_whole_numbers_and_single_precision_are_taken():
    q = torch.tensor([[1, 2], [3, 4], [5, 6]])
    data = {"t": [0, 1, 2], "q": q, "qd": q.to(torch.bfloat16), "tau": q.float(), "temperature": q * 2, "rate": 1.0}
    recording = open_recording(data, JOINTS)
    (chunk,) = recording.chunks()
    assert chunk.q.dtype == chunk.tau.dtype == chunk.qd.dtype == np.float64
    np.testing.assert_array_equal(chunk.temperature, 2 * q.numpy())
    np.testing.assert_array_equal(chunk.qd, q.numpy())
    assert [*map(str, recording.notes)] == ["columns not used: rate"]


def test_missing_cells_are_nan_and_as_in_files_their_rows_are_dropped():
    table = pd.DataFrame(COLUMNS).astype("Float64")
    table.loc[[3, 9], "q_a"] = pd.NA
    cells = pd.DataFrame(COLUMNS).astype(object)
    cells.loc[[3, 9], "q_a"] = None
    for data in (table, cells, {**COLUMNS, "q_a": [None if k in (3, 9) else x for k, x in enumerate(Q[:, 0])]}):
        recording = open_recording(data, JOINTS)
        assert np.flatnonzero(np.isnan(rows(recording)[1][:, 0])).tolist() == [3, 9]
        assert "2 of 600 rows dropped: a value is missing" in [*map(str, survey(recording).notes)]


def test_memory_is_not_copied():
    table, tensors = pd.DataFrame(COLUMNS), {name: torch.from_numpy(values.copy()) for name, values in ARRAYS.items()}
    first, second = open_recording(table, JOINTS), open_recording(tensors, JOINTS)
    assert np.shares_memory(first._table._numbers("q_a"), table["q_a"].to_numpy())
    tensors["q"][5, 0] = 7.0
    assert rows(second)[1][5, 0] == 7.0


def test_mapping_and_time_hold_for_memory_too():
    mapping = Mapping("", Source("stamp", 1e-3), {"*": {"q": Source("pos{index}", 2.0)}})
    data = {"stamp": 1e3 * CLOCK, "pos0": Q[:, 0], "pos1": Q[:, 1], "tau_a": TAU[:, 0], "tau_b": TAU[:, 1]}
    t, q, _ = rows(open_recording(data, JOINTS, mapping=mapping, time=(1.0, 2.0)))
    assert t[[0, -1]] == pytest.approx([1.0, 2.0])
    np.testing.assert_array_equal(q, 2.0 * Q[(CLOCK >= 1.0) & (CLOCK <= 2.0)])


def changed(**columns):
    return {**COLUMNS, **columns}


TWICE = pd.concat([pd.DataFrame(COLUMNS), pd.DataFrame({"q_a": Q[:, 0]})], axis=1)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (pd.DataFrame(COLUMNS).drop(columns="q_b"), "missing columns: q_b; present: tau_b, t, q_a, tau_a"),
        (pd.DataFrame(Q), "a column is called 0; expected text such as t, q_joint1"),
        (TWICE, "column 'q_a' appears more than once"),
        (pd.DataFrame(COLUMNS)[:0], "there are no rows; 't' is empty"),
        ({}, "missing columns: t"),
        (changed(t=CLOCK[::-1]), "data row 2: time goes backwards, to 2.99 s; sort the rows"),
        (changed(q_b=np.where(CLOCK == 1.0, np.inf, 0.0)), "column 'q_b', data row 201: infinite value"),
        (changed(q_a=Q[1:, 0]), r"column 'q_a' has shape \(599,\); expected \(600,\), a row for each of 't'"),
        (changed(tau_a=1.0), r"column 'tau_a' has shape \(\); expected \(600,\)"),
        (changed(q_a=["x", *Q[1:, 0]]), "column 'q_a', data row 1: expected a number, got 'x'; a missing one is nan"),
        (changed(q_a=[None, {}, *Q[2:, 0]]), "column 'q_a', data row 2: expected a number, got {}"),
        (changed(t=pd.to_datetime(CLOCK)), "column 't' holds datetime64.*; expected numbers, times in seconds"),
        (changed(q_a=Q[:, 0] * 1j), "column 'q_a' holds complex128; expected numbers"),
        (changed(q_a=[[1.0], [1.0, 2.0]]), "'q_a' is no array"),
        (ARRAYS | {"tau": TAU[1:]}, r"array 'tau' has shape \(599, 2\); expected \(600, 2\) for 600 times"),
        (ARRAYS | {"q": Q[:, :1]}, r"array 'q' has shape \(600, 1\).*the robot's 2 joints; name others under 'joints'"),
        (ARRAYS | {"joints": ["a"]}, r"array 'q' has shape \(600, 2\); expected \(600, 1\).*the 1 names in 'joints'"),
        (ARRAYS | {"joints": ["a", "c"]}, "missing columns: q_b"),
        ({"q": Q, "tau": TAU}, "the array 't' with the times is missing; present: q, tau"),
        (ARRAYS | {"q": [[1.0], [1.0, 2.0]]}, "'q' is no array"),
    ],
)
def test_unusable_data_say_why_and_which_recording(data, message):
    with pytest.raises(RecordingError, match=f"^monday: {message}"):
        list(open_recording(data, JOINTS, name="monday").chunks())


def test_sources_are_listed_and_those_in_memory_numbered_by_place(tmp_path):
    recording = open_recording(ARRAYS, JOINTS)
    assert recording.name == "recording"
    table = pd.DataFrame(COLUMNS)
    for one in (table, COLUMNS):
        (found,) = listed_sources(one)
        assert isinstance(found, InMemory)
        assert (found.name, found.data) == ("recording 1", one) if one is COLUMNS else found.data is one
    first, second, third = listed_sources([tmp_path / "a.csv", table, recording], "held-out recording")
    assert first == tmp_path / "a.csv"
    assert isinstance(second, InMemory)
    assert (second.name, third) == ("held-out recording 2", recording)
    assert listed_sources("a.csv") == listed_sources(("a.csv",))
    assert listed_sources([second]) == [second]
    assert listed_sources(None) == []
    for wrong in (3, [Q], Q):
        with pytest.raises(RecordingError, match=r"recording 1 is of type (int|ndarray); expected a file"):
            listed_sources(wrong)
