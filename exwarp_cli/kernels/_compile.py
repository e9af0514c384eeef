"""Decorators that compile kernels on their first call, and the disk cache of their machine code.

Numba's own cache is not used: two processes that fill its folder at once may load each other's
code, it reads no folder that it cannot write, and it misses changes in files of device functions.
"""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
import stat
import sys
import tempfile
import time
import types
import uuid
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import llvmlite  # type: ignore[import-untyped]
import numba
from llvmlite import binding
from numba.core import compiler, serialize
from numba.core.caching import NullCache
from numba.core.runtime.nrt import rtsys
from numba.extending import register_jitable
from numba.misc.appdirs import AppDirs

from exwarp_cli.kernels import _row_bands
from exwarp_cli.runtime.compilation import compilation

Kernel = Callable[..., Any]

# nogil: files are read and written meanwhile. No kernel is called from C. fastmath stays off, as
# NaN marks pixels without a value.
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

SUFFIX = ".kernel"

# Seconds since the last load after which a file is removed: it is of another version or processor.
MAX_UNUSED = 30 * 86400.0

# Seconds after which a load updates a file's time: not each time, for the sake of shared folders.
TOUCH_INTERVAL = 86400.0

# numba has no types of its own.
_rebuild: Any = compiler.CompileResult._rebuild
_dumps: Any = serialize.dumps
_Folders: Any = AppDirs


class ParallelKernel:
    """A kernel that runs on as many threads as :func:`_row_bands.threads` returns.

    Its function takes a band as its last argument, and loops over that band's
    :func:`_row_bands.band_range`. Callers leave the band out.
    """

    def __init__(self, function: Kernel) -> None:
        functools.update_wrapper(self, function)
        self._compiled = kernel(function)

    def __call__(self, *arguments: object) -> None:
        _row_bands.run_bands(self._compiled, arguments, _row_bands.threads())


def kernel(function: Kernel) -> Kernel:
    """Compile a function on its first call, and keep the machine code on disk."""
    assert isinstance(function, types.FunctionType)
    dispatcher: Any = numba.njit(function, **OPTIONS)
    if dispatcher is not function:  # it is with NUMBA_DISABLE_JIT
        dispatcher._cache = KernelCache(function)
    compiled: Kernel = dispatcher
    return compiled


# Each compiles a function with the kernels that call it; Python calls it uncompiled. As kernels,
# callable from Python and cached, these took half the compilation time again.
device_function: Callable[[Kernel], Kernel] = register_jitable(**OPTIONS)

# Compiled into every caller. Without force such functions stay calls: a gather of 1920x1080 took
# 35 ms instead of 25.
inline: Callable[[Kernel], Kernel] = register_jitable(**OPTIONS, forceinline=True)

device_function(_row_bands.band_range)


def processor() -> str:
    """Return LLVM's name of this processor."""
    return str(binding.get_host_cpu_name())


@dataclass(eq=False)
class KernelCache(NullCache):
    """The builds of one kernel on disk, one file each, in place of numba's cache.

    A file's name is a digest of all that its content depends on. Files are written atomically, and
    their content is verified by a digest before it is loaded.
    """

    function: types.FunctionType

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return a build from any folder, or None if it must be compiled."""
        # numba's cache refreshes the target here, which imports 200 modules: 0.13 s of each start.
        rtsys.initialize(target)
        name = self._name(signature, target.codegen())
        for folder in folders() if name else ():
            with suppress(Exception):  # a damaged file: the kernel is compiled again
                content = (folder / str(name)).read_bytes()
                if content[:32] == hashlib.sha256(content[32:]).digest():
                    result = _rebuild(target, *pickle.loads(content[32:]))
                    compilation.loaded += 1
                    with suppress(OSError):
                        if time.time() - (folder / str(name)).stat().st_mtime > TOUCH_INTERVAL:
                            os.utime(folder / str(name))
                    return result
        compilation.begin()
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Write a build; failures, such as a full disk, are ignored."""
        compilation.end()
        folder, name = writable_folder(), self._name(signature, result.codegen)
        if folder is None or name is None or result.library.has_dynamic_globals:
            return
        content = _dumps(result._reduce())
        remove_unused(folder)
        temporary = folder / f"{name}.{uuid.uuid4().hex[:16]}"
        try:
            temporary.write_bytes(hashlib.sha256(content).digest() + content)
            temporary.replace(folder / name)
        except OSError:
            with suppress(OSError):
                temporary.unlink()

    def _name(self, signature: Any, codegen: Any) -> str | None:
        """Return the file name of a build, or None if it cannot be cached."""
        file = Path(self.function.__code__.co_filename)
        function = f"{self.function.__module__}.{self.function.__qualname__}"
        if "<" in function:  # a closure may depend on variables of the function around it
            return None
        try:
            source = source_digest(file)
        except OSError:
            return None
        versions = numba.__version__, llvmlite.__version__, sys.version
        switches = ("OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT")
        options = [getattr(numba.config, name) for name in switches]
        machine = codegen.magic_tuple()  # the processor and its instructions
        key = repr((versions, options, machine, source, function, str(signature)))
        digest = hashlib.sha256(key.encode()).hexdigest()
        return f"{file.stem}.{self.function.__name__}-{digest}{SUFFIX}"


@functools.cache
def source_digest(file: Path) -> str:
    """Return a digest of a source file and of all modules with device functions.

    OSError: a file cannot be read, as in an archive.
    """
    kernels = Path(__file__).parent
    sources = [*kernels.glob("*.py"), *(kernels.parent / "accelerator").glob("*.py"), file]
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sorted(sources))).hexdigest()


@functools.cache
def folders() -> tuple[Path, ...]:
    """Return the folders that are searched for builds, up to the first writable one."""
    candidates: list[Path] = []
    for folder in candidate_folders():
        candidates.append(folder)
        if folder == writable_folder():
            break
    return tuple(candidates)


@functools.cache
def writable_folder() -> Path | None:
    """Return the folder of new builds, or None if none is writable."""
    for folder in candidate_folders():
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
    return None


def candidate_folders() -> Iterator[Path]:
    """Yield the folders that may hold builds, in order of preference.

    NUMBA_CACHE_DIR, beside the source, the user's cache, and a temporary folder for users without
    a home folder.
    """
    cache_dir: str = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    if cache_dir:
        yield Path(cache_dir, "exwarp")
    yield Path(__file__).parent / "__pycache__"
    home = Path(os.path.expanduser("~"))  # noqa: PTH111  # which raises without a home folder
    cache = Path(_Folders(appname="numba", appauthor=False).user_cache_dir)
    if not cache.is_absolute():  # a relative or empty XDG_CACHE_HOME does not count
        cache = home / ".cache" / "numba"
    # A missing home folder is not made, and without one "~" would be made in the current folder.
    if cache.is_absolute() and (home.is_dir() or not cache.is_relative_to(home)):
        yield cache / "exwarp"
    if hasattr(os, "getuid"):
        with suppress(OSError):
            folder = Path(tempfile.gettempdir(), f"exwarp-{os.getuid()}")
            folder.mkdir(mode=0o700, exist_ok=True)
            status = folder.lstat()
            is_own = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
            # No other user may write to it, as builds in it are executed.
            if is_own and not status.st_mode & 0o022:
                yield folder


@functools.cache
def remove_unused(folder: Path) -> None:
    """Remove builds unused for MAX_UNUSED seconds, and temporary files of killed processes."""
    before = time.time() - MAX_UNUSED
    with suppress(OSError):
        for path in folder.glob(f"*{SUFFIX}*"):
            with suppress(OSError):
                if path.stat().st_mtime < before:
                    path.unlink()
