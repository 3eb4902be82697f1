"""Other packages offer formats of recordings as entry points."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from torchrbd.errors import RecordingError
from torchrbd.recordings import Format, open_recording
from torchrbd.recordings.formats import opening
from torchrbd.recordings.formats.table import ArrayTable

ROWS = np.arange(4.0)
OWN = Format((".own",), lambda path, _: ArrayTable({"t": ROWS, "q_a": ROWS, "tau_a": ROWS}))
NONE = "no format"


@pytest.fixture
def offered(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[EntryPoint]]:
    points: list[EntryPoint] = []
    monkeypatch.setattr(opening, "entry_points", lambda group: points if group == opening.GROUP else [])
    opening.formats.cache_clear()
    yield points
    opening.formats.cache_clear()


def test_a_format_of_another_package_is_found(offered: list[EntryPoint], tmp_path: Path) -> None:
    file = tmp_path / "day.own"
    file.write_text("anything")
    offered.append(EntryPoint("own", f"{__name__}:OWN", opening.GROUP))
    (chunk,) = open_recording(file, ["a"]).chunks(10)
    np.testing.assert_array_equal(chunk.q[:, 0], ROWS)


def test_unknown_suffixes_name_all_that_are_known(offered: list[EntryPoint], tmp_path: Path) -> None:
    offered.append(EntryPoint("own", f"{__name__}:OWN", opening.GROUP))
    (tmp_path / "day.xlsx").write_text("anything")
    with pytest.raises(
        RecordingError, match=r"cannot read '\.xlsx' files; expected \.csv, .*\.mcap, \.own or the folder"
    ):
        open_recording(tmp_path / "day.xlsx", ["a"])


def test_an_entry_point_that_is_no_format_is_named(offered: list[EntryPoint], tmp_path: Path) -> None:
    offered.append(EntryPoint("none", f"{__name__}:NONE", opening.GROUP))
    (tmp_path / "day.own").write_text("anything")
    with pytest.raises(RecordingError, match=r"test_formats:NONE' of torchrbd\.formats: expected .*Format, got a str"):
        open_recording(tmp_path / "day.own", ["a"])
