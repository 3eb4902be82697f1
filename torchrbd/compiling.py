"""C code as a library: built once a machine by its C compiler, kept in a cache folder, loaded once a process.

Where there is no compiler callers do without: all that is compiled is written for torch or numpy as well.
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
"""That a compiler may take before it is given up; a second is usual."""

_LOG = logging.getLogger(__name__)
INTEGER, NUMBER, ADDRESS = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
"""What functions are called with."""


@dataclass(frozen=True, eq=False)
class Source:
    """C code for a library.

    Attributes:
        folder: where it lies.
        files: the one that is compiled, then those that it includes.
        functions: those that are called, with the types of their arguments; they return an int.
    """

    folder: Path
    files: tuple[str, ...]
    functions: Mapping[str, tuple[type, ...]]


def is_watched() -> bool:
    """Say whether something watches operations to trace them or to differentiate forwards."""
    stack, tracing = torch._C._len_torch_dispatch_stack(), torch._C._get_tracing_state()
    return bool(stack or tracing) or forward_ad._current_level >= 0


def is_transformed() -> bool:
    """Say whether operations are traced, batched, differentiated forwards or watched: none may write into a tensor."""
    return torch.compiler.is_compiling() or torch._C._are_functorch_transforms_active() or is_watched()


def is_plain(x: Tensor) -> bool:
    """Say whether a tensor is float64 numbers in memory and nothing else, which compiled code takes as they are."""
    if is_transformed():
        return False
    ordinary = type(x) is Tensor and x.is_cpu and x.dtype is torch.float64 and not x.is_neg()
    return ordinary and not (x.requires_grad and torch.is_grad_enabled())


@cache
def library(source: Source) -> ctypes.CDLL | None:
    """Return what is compiled of C code, or None where TORCHRBD_KERNELS is 0 or no compiler can build it.

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
    """Load the library from the cache folder; where nothing can be kept there, build it for this process alone.

    Raises:
        OSError, subprocess.SubprocessError: as of `build`.
    """
    try:
        return ctypes.CDLL(str(build(compiler, source, cache_folder())))
    except (OSError, RuntimeError) as error:
        _LOG.debug("compiled code is not kept, set TORCHRBD_CACHE to a folder that can be written to: %s", error)
    with tempfile.TemporaryDirectory() as folder:
        return ctypes.CDLL(str(build(compiler, source, Path(folder))))


def build(compiler: list[str], source: Source, folder: Path) -> Path:
    """Return the library in a folder, built if it is not there; processes that build it at once do not meet.

    Args:
        compiler: command and options.
        source: what is built.
        folder: is made if need be.

    Raises:
        OSError: the folder cannot be written to, or the compiler cannot be run.
        subprocess.SubprocessError: it fails, or takes too long.
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
    """Return the folder that the library is kept in."""
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
    """Return a text that differs between processors with different instructions: home folders are shared."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    output = {line for line in lines if line.startswith(("flags", "Features", "CPU part", "model name"))}
    return "\n".join((platform.machine(), platform.processor(), *sorted(output)))
