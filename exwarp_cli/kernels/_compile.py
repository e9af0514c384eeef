"""How kernels are compiled, lazily, and how their machine code is kept on disk.

Two processes that fill a folder of numba's own cache at once may load each other's machine code.
Numba's cache also reads no folder that it cannot write, and misses a change in the file of a part.
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
from importlib import metadata
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding  # type: ignore[import-untyped]
from numba.core import compiler, serialize
from numba.core.runtime.nrt import rtsys
from numba.extending import register_jitable
from numba.misc.appdirs import AppDirs

from exwarp_cli.kernels import _row_bands
from exwarp_cli.runtime.compilation import compilation

Kernel = Callable[..., Any]

COMMON: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Options of all kernels. `nogil`: files are read and written meanwhile. `fastmath` stays off, as
NaN marks pixels without a value. No kernel is called from C."""

SUFFIX = ".kernel"

UNUSED = 30 * 86400.0
"""Seconds after which a file that no process has loaded is removed: it is of another version, or
of another processor."""

NOTED = 86400.0
"""Seconds after which a load sets a file's time again; not at each load, for shared folders."""

# numba has no types of its own.
_rebuild: Any = compiler.CompileResult._rebuild
_dumps: Any = serialize.dumps
_Folders: Any = AppDirs


def compiled(text: Kernel) -> Kernel:
    """Compile a function on its first call, for one thread, and keep the result on disk."""
    assert isinstance(text, types.FunctionType)
    kernel: Any = numba.njit(text, **COMMON)
    if kernel is not text:  # as it is with NUMBA_DISABLE_JIT
        kernel._cache = KernelCache(text)
    function: Kernel = kernel
    return function


def parallel(text: Kernel) -> Kernel:
    """Compile a function for as many threads as :func:`_row_bands.threads` returns.

    Parameters
    ----------
    text
        Takes a share as its last argument, and loops over that share's :func:`_row_bands.turns`.
        Callers leave the share out.
    """
    kernel = compiled(text)

    @functools.wraps(text)
    def run(*arguments: object) -> None:
        _row_bands.run(kernel, arguments, _row_bands.threads())

    return run


def part(text: Kernel) -> Kernel:
    """Compile a function with the kernels that call it; Python calls it as it stands."""
    # Parts as kernels, callable from Python and cached, took half the compilation time again.
    function: Kernel = register_jitable(**COMMON)(text)
    return function


def inlined(text: Kernel) -> Kernel:
    """Do as :func:`part`, and compile the function into every place that calls it."""
    # Without force such functions stay calls: a gather of 1920x1080 took 35 ms instead of 25.
    function: Kernel = register_jitable(**COMMON, forceinline=True)(text)
    return function


part(_row_bands.turns)


def processor() -> str:
    """Return LLVM's name of this processor."""
    return str(binding.get_host_cpu_name())


class KernelCache:
    """The builds of one kernel on disk, a file for each; numba asks it in place of its own cache.

    A file's name is a digest of everything that its content depends on. A file is written whole or
    not at all, and its content is checked by a digest before it is loaded.
    """

    def __init__(self, text: types.FunctionType) -> None:
        self._text = text

    @property
    def cache_path(self) -> str | None:
        """The folder of new builds; None where no folder can be written."""
        folder = writable_folder()
        return None if folder is None else str(folder)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return a build from any folder that has it; None if it must be compiled."""
        # numba's cache refreshes the target here, which imports 200 modules: 0.13 s of each start.
        rtsys.initialize(target)
        name = self._name(signature, target.codegen())
        for folder in folders() if name else ():
            with suppress(Exception):  # a damaged file: the kernel is compiled again
                content = (folder / str(name)).read_bytes()
                if content[:32] == hashlib.sha256(content[32:]).digest():
                    result = _rebuild(target, *pickle.loads(content[32:]))
                    compilation.loaded += 1
                    _note_use(folder / str(name))
                    return result
        compilation.begin()
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep a build, if the disk has room for it."""
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

    def enable(self) -> None:
        """Do nothing; numba's caches have this."""

    def disable(self) -> None:
        """Do nothing; numba's caches have this."""

    def flush(self) -> None:
        """Do nothing; numba's caches have this."""

    def _name(self, signature: Any, codegen: Any) -> str | None:
        """Return the file name of a build; None if its source cannot be read, or not named."""
        file = Path(self._text.__code__.co_filename)
        function = f"{self._text.__module__}.{self._text.__qualname__}"
        if "<" in function:  # made in another function, of whose variables it may depend
            return None
        try:
            source = source_digest(file)
        except OSError:
            return None
        # magic_tuple: the processor and its instructions.
        key = repr((versions(), codegen.magic_tuple(), source, function, str(signature)))
        digest = hashlib.sha256(key.encode()).hexdigest()
        return f"{file.stem}.{self._text.__name__}-{digest}{SUFFIX}"


@functools.cache
def versions() -> tuple[object, ...]:
    """Return the versions and options of the compiler that machine code depends on."""
    options = [getattr(numba.config, name) for name in ("OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT")]
    return numba.__version__, metadata.version("llvmlite"), sys.version, *options


@functools.cache
def source_digest(file: Path) -> str:
    """Return a digest of a source file and of all modules beside kernels and parts.

    Raises
    ------
    OSError
        If one cannot be read, as in an archive.
    """
    kernels = Path(__file__).parent
    sources = [*kernels.glob("*.py"), *(kernels.parent / "accel").glob("*.py"), file]
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sorted(sources))).hexdigest()


@functools.cache
def folders() -> tuple[Path, ...]:
    """Return the folders in which builds are looked for: up to the first that can be written."""
    found: list[Path] = []
    for place in places_in_turn():
        found.append(place)
        if _is_writable(place):
            break
    return tuple(found)


@functools.cache
def writable_folder() -> Path | None:
    """Return the folder of new builds; None where none can be written."""
    last = folders()[-1]
    return last if _is_writable(last) else None


def places_in_turn() -> Iterator[Path]:
    """Yield the folders that may hold builds.

    NUMBA_CACHE_DIR, beside the source, the user's cache, and a temporary folder for users without
    a home folder.
    """
    named: str = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    if named:
        yield Path(named, "exwarp")
    yield Path(__file__).parent / "__pycache__"
    for folder in (_user_folder(), _temporary_folder()):
        if folder is not None:
            yield folder


def _user_folder() -> Path | None:
    home = Path(os.path.expanduser("~"))  # noqa: PTH111  # which raises without a home folder
    cache = Path(_Folders(appname="numba", appauthor=False).user_cache_dir)
    if not cache.is_absolute():  # a relative or empty XDG_CACHE_HOME does not count
        cache = home / ".cache" / "numba"
    # A missing home folder is not made, and without one "~" would be made in the current folder.
    has_place = cache.is_absolute() and (home.is_dir() or not cache.is_relative_to(home))
    return cache / "exwarp" if has_place else None


def _temporary_folder() -> Path | None:
    """Return a temporary folder that no other user can write, as builds in it are run."""
    if not hasattr(os, "getuid"):
        return None
    with suppress(OSError):
        folder = Path(tempfile.gettempdir(), f"exwarp-{os.getuid()}")
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        is_own = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
        if is_own and not status.st_mode & 0o022:
            return folder
    return None


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _note_use(path: Path) -> None:
    """Keep a build from being removed."""
    with suppress(OSError):
        if time.time() - path.stat().st_mtime > NOTED:
            os.utime(path)


@functools.cache
def remove_unused(folder: Path) -> None:
    """Remove builds that no process has loaded for long, and what killed processes left."""
    before = time.time() - UNUSED
    with suppress(OSError):
        for path in folder.glob(f"*{SUFFIX}*"):
            with suppress(OSError):
                if path.stat().st_mtime < before:
                    path.unlink()
