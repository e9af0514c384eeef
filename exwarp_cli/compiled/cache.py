"""Compiled functions on disk, a file for each build of one.

Numba's own cache keeps an index beside the builds of a function. Of two processes that compile two
builds at once both call theirs the first, and the index may then lead to the other's machine code;
a damaged file or a full disk ends the run; and a folder that can be read but not written is not
read. Here a file's name says all that its content depends on, and it is whole or not taken.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import re
import stat
import sys
import tempfile
import time
import types
import uuid
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import numba
from numba.core import compiler, serialize
from numba.core.runtime.nrt import rtsys
from numba.misc.appdirs import AppDirs

SUFFIX = ".kernel"

# As numba has no types of its own.
_rebuild: Any = compiler.CompileResult._rebuild
_dumps: Any = serialize.dumps
_Places: Any = AppDirs

IMPORTED = re.compile(r"^ *from exwarp_cli\.([\w.]+) import (\([^)]*\)|[^#\n]*)", re.MULTILINE)
"""How a file names those whose parts and constants it uses, or that compile it, at any depth."""

PACKAGE = Path(__file__).parents[1]

UNUSED = 30 * 86400.0
"""Seconds after which a build that nobody has loaded is removed: it is of another version, or of a
processor that is gone. Whoever wants it after all compiles it."""

NOTED = 86400.0
"""Seconds after which a file's time tells anew that it was loaded. Times of reading are not kept
everywhere, and at each load they would be written by every process of a farm."""


class KernelCache:
    """What numba asks for the builds of a kernel, in place of its own cache.

    Parameters
    ----------
    text
        The kernel's Python function.
    options
        What it is compiled with.
    """

    def __init__(self, text: types.FunctionType, options: dict[str, Any]) -> None:
        self._text, self._options = text, options

    @property
    def cache_path(self) -> str | None:
        """Where builds are kept from now on; None where no folder for them can be written."""
        folder = writable_folder()
        return None if folder is None else str(folder)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return a build, from whatever folder has it; None where it has to be compiled.

        Machine code needs numba's memory functions only. Numba would make ready to compile before
        it looks: it imports two hundred modules, scipy.linalg among them, and registers every
        function that a kernel might call, 0.3 s of a start in which nothing is compiled.
        """
        rtsys.initialize(target)
        name = self._name(signature, target.codegen())
        if name is None:
            return None
        for folder in folders():
            # Whatever is wrong with a file: the kernel can be compiled anew.
            with contextlib.suppress(Exception):
                content = (folder / name).read_bytes()
                if content[:32] == hashlib.sha256(content[32:]).digest():
                    build = _rebuild(target, *pickle.loads(content[32:]))
                    _note_use(folder / name)
                    return build
        return None

    def save_overload(self, signature: Any, build: Any) -> None:
        """Keep a build, if there is room for it; whole, or not at all."""
        folder = writable_folder()
        name = self._name(signature, build.codegen)
        if folder is None or name is None or build.library.has_dynamic_globals:
            return
        content = _dumps(build._reduce())
        remove_unused(folder)
        passing = folder / f"{name}.{uuid.uuid4().hex[:16]}"
        try:
            passing.write_bytes(hashlib.sha256(content).digest() + content)
            passing.replace(folder / name)
        except OSError:
            with contextlib.suppress(OSError):
                passing.unlink()

    def enable(self) -> None:
        """Nothing; it is what numba's caches have."""

    def disable(self) -> None:
        """Nothing, likewise."""

    def flush(self) -> None:
        """Nothing, likewise."""

    def _name(self, signature: Any, codegen: Any) -> str | None:
        """Return the name of a build's file; None where the kernel's source cannot be read."""
        file = Path(self._text.__code__.co_filename)
        try:
            sources = source_digest(file)
        except OSError:
            return None
        machine = (*_versions(), codegen.magic_tuple())  # the processor and what it can do
        function = f"{self._text.__module__}.{self._text.__qualname__}"
        options = sorted(self._options.items())
        what = repr((machine, sources, function, options, str(signature)))
        digest = hashlib.sha256(what.encode()).hexdigest()
        return f"{file.stem}.{self._text.__name__}-{digest}{SUFFIX}"


@functools.cache
def folders() -> tuple[Path, ...]:
    """Return where builds are looked for: up to the first place that can be written."""
    found: list[Path] = []
    for place in places_in_turn():
        found.append(place)
        if _is_writable(place):
            break
    return tuple(found)


@functools.cache
def writable_folder() -> Path | None:
    """Return where builds are kept."""
    last = folders()[-1]
    return last if _is_writable(last) else None


def places_in_turn() -> Iterator[Path]:
    """Yield where builds may be: in NUMBA_CACHE_DIR, beside the source, in the user's cache.

    The last place is a temporary folder, for users without a home folder.
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
    cache = Path(_Places(appname="numba", appauthor=False).user_cache_dir)
    if not cache.is_absolute():  # a relative or empty XDG_CACHE_HOME does not count
        cache = home / ".cache" / "numba"
    # A missing home folder is not made, and without one "~" would be made in the current folder.
    has_place = cache.is_absolute() and (home.is_dir() or not cache.is_relative_to(home))
    return cache / "exwarp" if has_place else None


def _temporary_folder() -> Path | None:
    """Return a temporary folder that no other user can write, as builds in it are run."""
    if not hasattr(os, "getuid"):
        return None
    with contextlib.suppress(OSError):
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
    with contextlib.suppress(OSError):
        if time.time() - path.stat().st_mtime > NOTED:
            os.utime(path)


@functools.cache
def remove_unused(folder: Path) -> None:
    """Remove builds that nobody has loaded for long, and what killed processes left; once a run.

    Others may do the same at once, or load such a build: they have all of it then, or compile it.
    """
    before = time.time() - UNUSED
    with contextlib.suppress(OSError):
        for path in folder.glob(f"*{SUFFIX}*"):
            with contextlib.suppress(OSError):
                if path.stat().st_mtime < before:
                    path.unlink()


@functools.cache
def source_digest(file: Path) -> str:
    """Return a digest of a source file and of all those of ExWarp that it uses, at any remove.

    Raises
    ------
    OSError
        If they cannot be read, as in an archive.
    """
    texts: dict[Path, bytes] = {}
    wanted = [file]
    while wanted:
        path = wanted.pop()
        if path not in texts:
            texts[path], used = _source(path)
            wanted += used
    return hashlib.sha256(b"\0".join(texts[path] for path in sorted(texts))).hexdigest()


@functools.cache
def _source(path: Path) -> tuple[bytes, tuple[Path, ...]]:
    """Return what a file holds, and the files that it uses."""
    text = path.read_bytes()
    return text, tuple(_used(text.decode()))


def _used(text: str) -> Iterator[Path]:
    """Yield the files that a file imports, whether it names them or what is in them."""
    for module, names in IMPORTED.findall(text):
        place = PACKAGE.joinpath(*module.split("."))
        if not place.is_dir():
            yield place.with_suffix(".py")
            continue
        for name in re.findall(r"(\w+)(?: as \w+)?", names):
            named = place / f"{name}.py"
            yield named if named.is_file() else place / "__init__.py"


@functools.cache
def _versions() -> tuple[str, ...]:
    """Return what else machine code depends on, and how it is kept."""
    cut = os.environ.get("NUMBA_OPT", "")
    return numba.__version__, metadata.version("llvmlite"), sys.version, cut
