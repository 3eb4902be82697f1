"""MATLAB's files, of version 5 written by scipy and of version 7.3 by h5py as MATLAB lays them out."""

import sys

import h5py
import numpy as np
import pytest
from recordings.motion import JOINTS, motion, torque
from scipy.io import savemat

from torchrbd.errors import RecordingError
from torchrbd.recordings import Mapping, open_recording
from torchrbd.recordings.mapping import Source

CLOCK = np.arange(0, 2, 0.01)
Q, QD, _ = motion(CLOCK)
TAU = torque(CLOCK)
ARRAYS = {"t": CLOCK[:, None], "q": Q, "tau": TAU, "qd": QD}
BY_COLUMN = {"t": CLOCK} | {f"{key}_{j}": x[:, k] for key, x in (("q", Q), ("tau", TAU)) for k, j in enumerate(JOINTS)}
CELLS = np.array(JOINTS, dtype=object)


def matlab73(path, content, group="/"):
    """Write what MATLAB's save(..., '-v7.3') writes: a header of 512 bytes, arrays by columns, text as numbers."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in content.items():
            if value is CELLS:
                references = []
                for k, joint in enumerate(value):
                    letters = file.create_dataset(f"#refs#/{k}", data=np.array([[ord(x)] for x in joint], "u2"))
                    letters.attrs["MATLAB_class"] = np.bytes_("char")
                    references.append(letters.ref)
                data = file[group].create_dataset(name, data=np.array([references], dtype=h5py.ref_dtype))
                data.attrs["MATLAB_class"] = np.bytes_("cell")
            else:
                data = file.require_group(group).create_dataset(name, data=np.atleast_2d(value.T), chunks=True)
                data.attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def is_the_motion(path, **options):
    chunks = list(open_recording(path, JOINTS, **options).chunks(64))
    for name, expected in (("t", CLOCK), ("q", Q), ("tau", TAU)):
        np.testing.assert_array_equal(np.concatenate([getattr(chunk, name) for chunk in chunks]), expected)


def write(path, content, version):
    if version == "5":
        savemat(path, content, do_compression=True)
    else:
        matlab73(path, content)
    return path


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_arrays_and_columns(tmp_path, version):
    is_the_motion(write(tmp_path / "a.mat", {**ARRAYS, "joints": CELLS}, version))
    is_the_motion(write(tmp_path / "b.mat", BY_COLUMN, version))
    lying = {name: np.ascontiguousarray(array.T) for name, array in ARRAYS.items()}
    is_the_motion(write(tmp_path / "c.mat", {**lying, "joints": CELLS}, version))
    mapping = Mapping(joints={"*": {"q": Source("q[{index}]"), "tau": Source("tau[{index}]")}})
    is_the_motion(write(tmp_path / "d.mat", {**ARRAYS, "rate": np.array([[100.0]])}, version), mapping=mapping)
    with pytest.raises(RecordingError, match=r"missing columns: q_a, q_b.*present: .*q\[0\], q\[1\]"):
        open_recording(tmp_path / "d.mat", JOINTS)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_shapes_that_do_not_fit(tmp_path, version):
    write(tmp_path / "a.mat", {**ARRAYS, "tau": TAU[:-1], "joints": CELLS}, version)
    with pytest.raises(RecordingError, match=r"array 'tau' has shape \(199, 2\); expected 200 rows"):
        open_recording(tmp_path / "a.mat", JOINTS)
    write(tmp_path / "b.mat", {**ARRAYS, "tau": TAU[:, :1], "joints": CELLS}, version)
    with pytest.raises(RecordingError, match="array 'tau' has 1 columns; expected 2"):
        open_recording(tmp_path / "b.mat", JOINTS)


def test_structures_and_matrices_of_letters(tmp_path):
    savemat(tmp_path / "a.mat", {"log": {**ARRAYS, "joints": np.array(JOINTS)}})
    is_the_motion(tmp_path / "a.mat")
    matlab73(tmp_path / "b.mat", BY_COLUMN, "log")
    is_the_motion(tmp_path / "b.mat")
    savemat(tmp_path / "c.mat", {"log": {"t": CLOCK, "pos": Q, "tau": TAU}, "date": "monday"})
    mapping = Mapping(
        time=Source("log.t"), joints={"*": {"q": Source("log.pos[{index}]"), "tau": Source("log.tau[{index}]")}}
    )
    is_the_motion(tmp_path / "c.mat", mapping=mapping)


def test_files_that_cannot_be_read(tmp_path):
    savemat(tmp_path / "text.mat", {"remark": "nothing"})
    with pytest.raises(RecordingError, match="holds no vectors or matrices of numbers; tables, timetables"):
        open_recording(tmp_path / "text.mat", JOINTS)
    for version in ("5", "7.3"):
        path = write(tmp_path / f"{version}.mat", {**ARRAYS, "joints": CELLS}, version)
        content = path.read_bytes()
        path.write_bytes(content[: len(content) // 2])
        with pytest.raises(RecordingError, match="not a readable MATLAB file"):
            open_recording(path, JOINTS)
    (tmp_path / "none.mat").write_bytes(b"anything but a MATLAB file" * 40)
    with pytest.raises(RecordingError, match="not a readable MATLAB file"):
        open_recording(tmp_path / "none.mat", JOINTS)


def test_data_sets_that_lie_elsewhere_are_not_opened(tmp_path):
    with h5py.File(tmp_path / "other.mat", "w") as file:
        file["q_b"] = Q[:, 1]
    (tmp_path / "raw").write_bytes(Q[:, 0].tobytes())
    with h5py.File(tmp_path / "a.mat", "w") as file:
        for name, values in BY_COLUMN.items():
            if not name.startswith("q"):
                file[name] = values
        file.create_dataset("q_a", CLOCK.shape, "f8", external=[(str(tmp_path / "raw"), 0, h5py.h5f.UNLIMITED)])
        layout = h5py.VirtualLayout(CLOCK.shape, "f8")
        layout[:] = h5py.VirtualSource(tmp_path / "other.mat", "q_b", CLOCK.shape)
        file.create_virtual_dataset("q_b", layout)
        file["q_c"] = h5py.ExternalLink("other.mat", "q_b")
    with pytest.raises(RecordingError, match="missing columns: q_a, q_b; present: t, tau_a, tau_b; "):
        open_recording(tmp_path / "a.mat", JOINTS)


def test_the_library_is_asked_for_only_when_it_is_needed(tmp_path, monkeypatch):
    matlab73(tmp_path / "a.mat", BY_COLUMN)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(RecordingError, match="pip install h5py"):
        open_recording(tmp_path / "a.mat", JOINTS)
