"""Files that are written whole or not at all, one by one and as a set.

A set is written into a folder of its own inside its folder, which becomes ready by one renaming, and then moved file by
file; what a killed run had made ready is moved by the next run. Nothing of a set that is not ready replaces anything.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, TypeVar

from torchrbd.errors import OptionError

if sys.platform == "win32":  # pragma: no cover
    import msvcrt
else:
    import fcntl

Value = TypeVar("Value")

_LOCK, _WRITING, _READY = ".torchrbd.lock", ".torchrbd-writing", ".torchrbd-ready"
# Some network drives have no locks.
_UNLOCKABLE = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)
# Room that is kept free for the results while the work is done [bytes]; those of a robot are a few million.
_ROOM, _ROOM_FILE, _PIECE = 32 << 20, "room", bytes(1 << 20)


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file; if that fails or is cut off, what it held stays. What is no file, such as a pipe, is written to."""
    target = Path(os.path.realpath(path))
    if target.exists() and not stat.S_ISREG(target.stat().st_mode):
        target.write_bytes(content)
        return
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        part.unlink(missing_ok=True)
        with part.open("xb") as file:
            file.write(content)
        os.replace(part, target)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise


def check_file(path: Path) -> None:
    """Make the folder of a file, and see that it can be written there, before any work is done.

    Raises:
        OptionError: it cannot; says why.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OptionError(f"output '{path}': its folder cannot be made ({_reason(error)}); name another") from None
    if path.is_dir():
        raise OptionError(f"output '{path}' is a folder; name a file")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise OptionError(f"output '{path}': '{path.parent}' is not a folder that can be written; name another")


class OutputFolder:
    """A folder for one set of files, and for one process at a time.

    Entering it finds out, before any work is done, whether it can be written and has room, and keeps that room. Leaving
    it without having filled it leaves everything as it was.

    Args:
        folder: made if it is not there.

    Raises:
        OptionError: it cannot be written, has no room, or another process is writing into it; says what to do.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock: IO[str] | None = None
        self._made: list[Path] = []

    def __enter__(self) -> OutputFolder:
        existing = next(path for path in (self.folder, *self.folder.absolute().parents) if path.exists())
        if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
            raise OptionError(f"output '{self.folder}': '{existing}' is not a folder that can be written; name another")
        absent = [path for path in (self.folder.absolute(), *self.folder.absolute().parents) if not path.exists()]
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._made = absent
            self._take()
            _finish(self.folder)
            self._reserve()
        except OSError as error:
            self.__exit__()
            why = _reason(error)
            raise OptionError(f"output '{self.folder}': cannot be written ({why}); make room or name another") from None
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        if self._lock is not None:
            shutil.rmtree(self.folder / _WRITING, ignore_errors=True)
            with suppress(OSError):
                (self.folder / _LOCK).unlink()
            self._lock.close()
            self._lock = None
        for path in self._made:
            with suppress(OSError):
                path.rmdir()

    def fill(self, write: Callable[[Path], Value]) -> Value:
        """Have a set of files written and put it in the place of those of the same names.

        Args:
            write: writes files, no folders, into the folder that it is given.
        """
        writing = self.folder / _WRITING
        (writing / _ROOM_FILE).unlink()
        value = write(writing)
        os.rename(writing, self.folder / _READY)
        _finish(self.folder)
        return value

    def _take(self) -> None:
        """Take the folder's lock, which ends with its process however that ends."""
        path = self.folder / _LOCK
        while True:
            # Not through a link that somebody else has put there.
            handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
            lock = os.fdopen(handle, "r+")
            try:
                _hold(lock)
            except OSError as error:
                if error.errno in _UNLOCKABLE:
                    break
                lock.seek(0)
                owner = lock.read().strip()
                lock.close()
                if error.errno not in (errno.EACCES, errno.EAGAIN, errno.EDEADLK):
                    raise
                raise OptionError(
                    f"output '{self.folder}': another torchrbd{f' (process {owner})' if owner else ''} is writing into "
                    "it; wait until it has ended, or name another folder"
                ) from None
            # The owner before may have removed the file that has just been locked.
            with suppress(OSError):
                if os.path.samestat(os.fstat(lock.fileno()), path.stat()):
                    break
            lock.close()
        self._lock = lock
        lock.seek(0)
        lock.truncate()
        lock.write(str(os.getpid()))
        lock.flush()

    def _reserve(self) -> None:
        """Write as much as the results may need."""
        writing = self.folder / _WRITING
        shutil.rmtree(writing, ignore_errors=True)
        writing.mkdir()
        with (writing / _ROOM_FILE).open("wb") as file:
            for _ in range(_ROOM // len(_PIECE)):
                file.write(_PIECE)


def _finish(folder: Path) -> None:
    """Move what is ready to where it belongs."""
    ready = folder / _READY
    if ready.is_dir():
        for path in sorted(ready.iterdir()):
            os.replace(path, folder / path.name)
        ready.rmdir()


def _hold(lock: IO[str]) -> None:
    if sys.platform == "win32":  # pragma: no cover
        msvcrt.locking(lock.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
