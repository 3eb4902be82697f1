"""C code as a library: built once per machine by its C compiler, cached in a folder, loaded once per process.

Without a compiler callers use torch or numpy: all compiled functions exist there too.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import torch
from torch import Tensor
from torch.autograd import forward_ad

FLAGS = (
    ("-O3", "-std=gnu11", "-fPIC", "-shared", "-ffp-contract=fast", "-fno-math-errno", "-Wno-psabi", "-march=native"),
    ("-O3", "-std=gnu11", "-fPIC", "-shared", "-ffp-contract=fast", "-fno-math-errno", "-mcpu=native"),
)
"""Tried in this order: some compilers for ARM know only the second."""

SECONDS = 120.0
"""Longest time for the compiler [s]; one second is usual."""

_LOG = logging.getLogger(__name__)
INTEGER, NUMBER, ADDRESS = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
"""Types of the functions' arguments."""


@dataclass(frozen=True, eq=False)
class Source:
    """C code for a library.

    Attributes:
        folder: its folder.
        files: the one that is compiled, then those that it includes.
        functions: those that are called, with the types of their arguments; they return an int.
    """

    folder: Path
    files: tuple[str, ...]
    functions: Mapping[str, tuple[type, ...]]


def is_watched() -> bool:
    """Return whether operations are traced or differentiated in forward mode."""
    stack, tracing = torch._C._len_torch_dispatch_stack(), torch._C._get_tracing_state()
    return bool(stack or tracing) or forward_ad._current_level >= 0


def is_transformed() -> bool:
    """Return whether operations are traced, batched or differentiated in forward mode: none may write into a tensor."""
    return torch.compiler.is_compiling() or torch._C._are_functorch_transforms_active() or is_watched()


def is_plain(x: Tensor) -> bool:
    """Return whether a tensor is plain float64 in CPU memory, which compiled code can use directly."""
    if is_transformed():
        return False
    ordinary = type(x) is Tensor and x.is_cpu and x.dtype is torch.float64 and not x.is_neg()
    return ordinary and not (x.requires_grad and torch.is_grad_enabled())


@cache
def library(source: Source) -> ctypes.CDLL | None:
    """Return the library of C code, or None if TORCHRBD_KERNELS is 0 or no compiler can build it.

    Environment:
        TORCHRBD_KERNELS: 0 for torch's own operations everywhere.
        TORCHRBD_CACHE: the folder to keep the library in instead of the user's cache folder.
        CC: the compiler, and options for it, instead of the first of cc, gcc and clang.
    """
    if os.environ.get("TORCHRBD_KERNELS") == "0":
        _LOG.debug("no compiled kernels: TORCHRBD_KERNELS is 0")
        return None
    compiler = _compiler()
    if compiler is None:
        _LOG.debug("no compiled kernels: found no C compiler; set CC, or put cc, gcc or clang on the PATH")
        return None
    try:
        loaded = _load(compiler, source)
    except (OSError, subprocess.SubprocessError) as error:
        output = getattr(error, "stderr", None) or str(error)
        _LOG.debug("no compiled kernels: %s: %s", shlex.join(compiler), output.strip())
        return None
    for name, arguments in source.functions.items():
        function = getattr(loaded, name)
        function.argtypes, function.restype = arguments, ctypes.c_int
    return loaded


def _load(compiler: list[str], source: Source) -> ctypes.CDLL:
    """Load the library from the cache folder; if that is not writable, build it for this process alone.

    Raises:
        OSError, subprocess.SubprocessError: as for `build`.
    """
    try:
        return ctypes.CDLL(str(build(compiler, source, cache_folder())))
    except (OSError, RuntimeError) as error:
        _LOG.debug("compiled code is not kept, set TORCHRBD_CACHE to a folder that can be written to: %s", error)
    with tempfile.TemporaryDirectory() as folder:
        return ctypes.CDLL(str(build(compiler, source, Path(folder))))


def build(compiler: list[str], source: Source, folder: Path) -> Path:
    """Return the library in a folder, built if it is not there; several processes may build it at once.

    Args:
        compiler: command and options.
        source: the C code.
        folder: created if needed.

    Raises:
        OSError: the folder cannot be written to, or the compiler cannot be run.
        subprocess.SubprocessError: the compiler fails, or takes too long.
    """
    name = Path(source.files[0]).stem
    texts = [(source.folder / file).read_bytes() for file in source.files]
    key = hashlib.sha256("\0".join((*compiler, *map(str, FLAGS), sys.platform, _machine())).encode())
    for text in texts:
        key.update(text)
    library = folder / f"{name}-{key.hexdigest()[:32]}.so"
    if library.exists():
        return library
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as work:
        built = Path(work) / f"{name}.so"
        for flags in FLAGS:
            command = [*compiler, *flags, str(source.folder / source.files[0]), "-o", str(built), "-lm"]
            done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS)
            if done.returncode == 0:
                break
        done.check_returncode()
        os.replace(built, library)
    _LOG.debug("built %s", library)
    return library


def cache_folder() -> Path:
    """Return the folder of cached libraries."""
    if chosen := os.environ.get("TORCHRBD_CACHE"):
        return Path(chosen)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "torchrbd"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "torchrbd" / "Cache"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "torchrbd"


def _compiler() -> list[str] | None:
    chosen = shlex.split(os.environ.get("CC", ""))
    for command in [chosen] if chosen else [["cc"], ["gcc"], ["clang"]]:
        if found := shutil.which(command[0]):
            return [found, *command[1:]]
    return None


def _machine() -> str:
    """Return an identifier of the processor's instruction set: machines may share a home folder."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    output = {line for line in lines if line.startswith(("flags", "Features", "CPU part", "model name"))}
    return "\n".join((platform.machine(), platform.processor(), *sorted(output)))
