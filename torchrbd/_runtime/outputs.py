"""Files that are written completely or not at all, one by one and as a set.

A set is first written into a folder of its own inside the output folder. One renaming marks it as ready; then its files
are moved one by one. If a run is killed in between, the next run moves them. A set that is not ready replaces nothing.

Nothing is written, moved or removed through a link, nor outside the folder. The output folder itself may be reached
through links, as the user names it; so may a device such as /dev/stdout.
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
# Disk space that is reserved for the results during the work [bytes]; the results of a robot take a few million.
_ROOM, _ROOM_FILE, _PIECE = 32 << 20, "room", bytes(1 << 20)


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file. If that fails or is interrupted, its old content stays. A pipe or the like is written directly.

    Raises:
        OptionError: it is a link.
    """
    target = Path(path)
    _refuse_link(target)
    if target.exists() and not target.is_file():
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
    """Create the folder of a file, and check before any work that the file can be written.

    Raises:
        OptionError: it cannot; the message says why.
    """
    _refuse_link(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OptionError(f"output '{path}': its folder cannot be made ({_reason(error)}); name another") from None
    if path.is_dir():
        raise OptionError(f"output '{path}' is a folder; name a file")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise OptionError(f"output '{path}': '{path.parent}' is not a folder that can be written; name another")


def inside(folder: Path, name: str) -> Path:
    """Return the path of a folder inside an output folder; it need not exist.

    Args:
        folder: the output folder.
        name: from a file, such as the name of a recording.

    Raises:
        OptionError: no folder inside can have the name, or a link already has it.
    """
    if name in ("", ".", "..", _LOCK, _WRITING, _READY) or any(mark in name for mark in ("/", "\\", "\0")):
        raise OptionError(f"output '{folder}': no folder inside it can be called {name!r}; rename the recording")
    _refuse_link(folder / name)
    return folder / name


class OutputFolder:
    """A folder for one set of files, and for one process at a time.

    On entry it checks, before any work, that the folder is writable and has enough space, and reserves that space.
    Without ``fill``, nothing in the folder changes.

    Args:
        folder: created if it does not exist.

    Raises:
        OptionError: it is not writable, has no space, or another process is writing into it; the message has the
            remedy.
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
            self._check()
            self._take()
            _finish(self.folder)
            self._reserve()
        except OSError as error:
            self._release()
            why = _reason(error)
            raise OptionError(f"output '{self.folder}': cannot be written ({why}); make room or name another") from None
        except BaseException:
            self._release()
            raise
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        removed = isinstance(error, FileNotFoundError) and not self._is_own()
        self._release()
        if removed:
            raise self._removed() from None

    def _release(self) -> None:
        """Remove what was made for this run alone."""
        if self._lock is not None:
            if self._is_own():
                shutil.rmtree(self.folder / _WRITING, ignore_errors=True)
                with suppress(OSError):
                    (self.folder / _LOCK).unlink()
            self._lock.close()
            self._lock = None
        for path in self._made:
            with suppress(OSError):
                path.rmdir()

    def fill(self, write: Callable[[Path], Value]) -> Value:
        """Write a set of files, which replace those of the same names.

        Args:
            write: writes files, no folders, into the folder that it is given.

        Raises:
            OptionError: another process has removed the folder.
        """
        self._check()
        writing = self.folder / _WRITING
        (writing / _ROOM_FILE).unlink()
        value = write(writing)
        self._check()
        os.rename(writing, self.folder / _READY)
        _finish(self.folder)
        return value

    def _is_own(self) -> bool:
        """Say whether the folder is still the one that this process has locked: others may remove and make it anew."""
        if self._lock is None:
            return False
        with suppress(OSError):
            return os.path.samestat(os.fstat(self._lock.fileno()), (self.folder / _LOCK).stat())
        return False

    def _removed(self) -> OptionError:
        return OptionError(
            f"output '{self.folder}': another process has removed it during the run, and nothing was written; see "
            "which one does, and run it again, or name another folder"
        )

    def _check(self) -> None:
        """Reject files of others at the places of this process's own lock and folders.

        Raises:
            OptionError: it is a link, or not what torchrbd would make; or another process has removed the folder.
        """
        if self._lock is not None and not self._is_own():
            raise self._removed()
        for name, kind in ((_LOCK, stat.S_ISREG), (_WRITING, stat.S_ISDIR), (_READY, stat.S_ISDIR)):
            with suppress(FileNotFoundError):
                found = (self.folder / name).lstat()
                # A file with a second name (hard link) is also another file's content.
                if not kind(found.st_mode) or _is_link(self.folder / name) or (name == _LOCK and found.st_nlink > 1):
                    what = "is a link" if _is_link(self.folder / name) else "is not from torchrbd"
                    raise OptionError(
                        f"output '{self.folder}': '{name}' in it {what}; see what it is and remove it, or name "
                        "another folder"
                    )

    def _take(self) -> None:
        """Take the folder's lock, which is released when the process ends in any way."""
        path = self.folder / _LOCK
        while True:
            # Do not follow a link that somebody else has put there.
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
            # The previous owner may have removed the file that has just been locked.
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
        """Write as many bytes as the results may need."""
        writing = self.folder / _WRITING
        shutil.rmtree(writing, ignore_errors=True)
        writing.mkdir()
        with (writing / _ROOM_FILE).open("wb") as file:
            for _ in range(_ROOM // len(_PIECE)):
                file.write(_PIECE)


def _finish(folder: Path) -> None:
    """Move the files that are ready to their places; a file or link there is replaced and not followed."""
    ready = folder / _READY
    if ready.is_dir() and not _is_link(ready):
        for path in sorted(ready.iterdir()):
            os.replace(path, folder / path.name)
        ready.rmdir()


def _is_link(path: Path) -> bool:
    # Junctions are Windows links to folders; Python 3.12 and later can detect them.
    return path.is_symlink() or bool(getattr(os.path, "isjunction", lambda _: False)(path))


def _refuse_link(path: Path) -> None:
    """Raise an error for a link; /dev/stdout is an exception: a link to something that is not a file.

    Raises:
        OptionError: it is a link.
    """
    if _is_link(path) and not (path.absolute().parts[:2] == ("/", "dev") and path.exists() and not path.is_file()):
        raise OptionError(f"output '{path}' is a link to '{os.readlink(path)}'; remove it or name another")


def _hold(lock: IO[str]) -> None:
    if sys.platform == "win32":  # pragma: no cover
        msvcrt.locking(lock.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
