"""Whether the compiled kernels work, and where they are kept from run to run."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import numba
import numpy as np

from exwarp_cli.domain.wording import pluralise, size_text
from exwarp_cli.io.machine import Folder, cached_files, look_at
from exwarp_cli.kernels import _compile, _row_bands
from exwarp_cli.kernels._compile import SUFFIX
from exwarp_cli.kernels.gather import gather_bilinear
from exwarp_cli.pipeline.doctor.examine import Check, Remark, failure, warning
from exwarp_cli.runtime.compilation import compilation

FOLDER_VARIABLE = "NUMBA_CACHE_DIR"
"""Names where compiled kernels go, before numba looks for a folder itself."""

LEAST_FREE = 64 << 20
"""Bytes on the disk of the compiled kernels, several times what they take."""


def check_kernels() -> Check:
    """Compile and run a kernel by one thread and by all, on motion by whole pixels."""
    _row_bands.set_threads(None)
    remarks = []
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        remarks.append(
            warning(
                "NUMBA_DISABLE_JIT is set, so that nothing is compiled and everything takes "
                "hundreds of times as long; unset it"
            )
        )
    wrong = [name for name, kernel in _WAYS.items() if not moves_exactly(kernel)]
    if wrong:
        remarks.append(
            failure(
                f"a kernel run by {' and by '.join(wrong)} gives wrong pixels; delete the "
                "folder of compiled kernels, and if that does not help install numba again"
            )
        )
    facts = {
        "numba": numba.__version__,
        "llvmlite": metadata.version("llvmlite"),
        "jit": not numba.config.DISABLE_JIT,  # type: ignore[attr-defined]
        "cpu": _compile.processor(),
        "threads": _row_bands.threads(),
    }
    threads = pluralise(_row_bands.threads(), "thread")
    found = f"numba {numba.__version__} on numpy {np.__version__}, {threads}"
    lines = (f"llvmlite {facts['llvmlite']}, which takes this CPU for {facts['cpu']}",)
    return Check(found, tuple(remarks), facts, lines)


def moves_exactly(kernel: Callable[..., Any]) -> bool:
    """Whether a gather along whole pixels copies every bit."""
    rng = np.random.default_rng(0)
    image = rng.normal(size=(24, 40, 3)).astype(np.float32)
    field = np.full((24, 40, 2), (-3, 2), np.float32)
    out, hole = np.empty_like(image), np.empty(image.shape[:2], np.bool_)
    kernel(image, field, out, hole)
    expected = np.ones_like(hole)
    expected[:-2, 3:] = False
    return np.array_equal(out[:-2, 3:], image[2:, :-3]) and np.array_equal(hole, expected)


def check_cache() -> Check:
    """Look at the folders of compiled kernels; meant for the end, when kernels have been used."""
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return Check("not used, as NUMBA_DISABLE_JIT is set", facts={"folders": [], "warm": False})
    folders, read = [look_at(path) for path in cache_folders()], only_read()
    hits, misses = cache_use()
    if not folders and (misses or not read):
        text = (
            "no folder for compiled kernels can be written, so that every run compiles them; name "
            "one in NUMBA_CACHE_DIR"
        )
        facts = {"folders": [], "kernels": 0, "bytes": 0, "warm": False, "compiled": misses}
        return Check("none", (warning(text),), facts)
    paths = [*read, *(folder.path for folder in folders)]
    files = [cached_files(path, SUFFIX) for path in paths]
    kernels, size = sum(count for count, _ in files), sum(taken for _, taken in files)
    facts = {
        "folders": [{"path": str(path), "place": place_of(path)} for path in paths],
        "writable": bool(folders) and all(folder.problem is None for folder in folders),
        "free": min((f.free for f in folders if f.free is not None), default=None),
        "kernels": kernels,
        "bytes": size,
        "warm": misses == 0,
        "loaded": hits,
        "compiled": misses,
    }
    state = _state(hits, misses)
    places = " and ".join(dict.fromkeys(map(place_of, paths)))
    found = f"{state}; {pluralise(kernels, 'kernel')}, {size_text(size)}, {places}"
    lacking = misses > 0 or not read
    return Check(found, tuple(_cache_remarks(folders, lacking)), facts, tuple(map(str, paths)))


def cache_folders() -> list[Path]:
    """Return the folder of new builds; none where no folder can be written."""
    folder = _compile.writable_folder()
    return [] if folder is None else [folder]


def cache_use() -> tuple[int, int]:
    """Return how many kernels this process loaded from the cache, and how many it compiled."""
    return compilation.loaded, compilation.compiled


def only_read() -> list[Path]:
    """Return the folders whose builds are taken though nothing can be written there."""
    found = [path for path in _compile.folders() if path != _compile.writable_folder()]
    return [path for path in found if cached_files(path, SUFFIX)[0]]


def _state(hits: int, misses: int) -> str:
    """Say how the cache was found, by what this run took from it and what it had to compile."""
    if not misses:
        return "warm" if hits else "not used"
    return "partly cold until now" if hits else "cold until now"


def place_of(folder: Path) -> str:
    """Say where a folder of compiled kernels is: numba looks for one that can be written."""
    named = os.environ.get(FOLDER_VARIABLE)
    if named and Path(named).resolve() in folder.resolve().parents:
        return f"in {FOLDER_VARIABLE}"
    beside = Path(_compile.__file__).resolve().parents[1] in folder.resolve().parents
    if beside:
        return "beside the source"
    is_temporary = Path(tempfile.gettempdir()) == folder.parent
    return "in the temporary folder" if is_temporary else "in the user's cache"


def _cache_remarks(folders: list[Folder], lacking: bool) -> Iterator[Remark]:
    """Say what is wrong; `lacking`, whether a folder that cannot be written does not suffice."""
    named = os.environ.get(FOLDER_VARIABLE)
    elsewhere = [f for f in folders if not place_of(f.path).endswith(FOLDER_VARIABLE)]
    if named and elsewhere and lacking:
        yield warning(
            f"{FOLDER_VARIABLE} names {named}, which cannot be written and lacks kernels, so that "
            f"they are kept {place_of(elsewhere[0].path)}; correct it, fill it from where it can "
            "be written, or unset it"
        )
    for folder in folders:
        if folder.problem is not None:
            yield warning(
                f"cannot write to {folder.path} ({folder.problem}), so that kernels are compiled "
                "for every run; name another folder in NUMBA_CACHE_DIR"
            )
        elif folder.free is not None and folder.free < LEAST_FREE:
            yield warning(
                f"the disk of {folder.path} is full, and compiled kernels go there; make room, or "
                "name another folder in NUMBA_CACHE_DIR"
            )


def _by_one_thread(*arguments: object) -> None:
    _row_bands.set_threads(1)
    try:
        gather_bilinear(*arguments)
    finally:
        _row_bands.set_threads(None)


_WAYS = {"all threads": gather_bilinear, "one thread": _by_one_thread}
