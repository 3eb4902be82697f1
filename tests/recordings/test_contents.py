"""A recording's hash changes with what is read of it, and with nothing else."""

from __future__ import annotations

import hashlib
from pathlib import Path

from torchrbd.recordings.contents import digest


def test_of_a_file_it_is_that_of_its_content(tmp_path: Path) -> None:
    file, content = tmp_path / "a.csv", bytes(range(256)) * 10_000
    file.write_bytes(content)
    assert digest(file) == (len(content), hashlib.sha256(content).hexdigest())


def written(folder: Path, files: dict[str, str]) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    return folder


def assert_read(folder: Path, read: tuple[str, ...], others: tuple[str, ...]) -> None:
    """See which files the hash depends on."""
    before = digest(folder)
    assert before[0] == sum((folder / name).stat().st_size for name in read)
    for name in others:
        written(folder, {name: "another content"})
        assert digest(folder) == before
    for name in read:
        content = (folder / name).read_text()
        written(folder, {name: f"{content[:-1]}!"})
        assert digest(folder)[1] != before[1]
        written(folder, {name: content})
    moved = folder / read[-1]
    moved.rename(moved.with_name(f"other-{moved.name}"))
    assert digest(folder)[0] == before[0]
    assert digest(folder)[1] != before[1]


def test_of_a_lerobot_set_it_is_that_of_its_frames(tmp_path: Path) -> None:
    read = ("meta/info.json", "data/chunk-000/a.parquet", "data/chunk-001/b.parquet")
    others = ("videos/chunk-000/a.mp4", "README.md", "meta/stats.json", "data/notes.txt")
    assert_read(written(tmp_path, dict.fromkeys((*read, *others), "content")), read, others)


def test_of_a_bag_it_is_that_of_its_messages(tmp_path: Path) -> None:
    read = ("metadata.yaml", "bag_0.db3", "bag_1.db3.zstd", "bag_2.mcap")
    others = ("notes.txt", "camera/video.mp4", "bag_0.db3-shm")
    assert_read(written(tmp_path, dict.fromkeys((*read, *others), "content")), read, others)
