"""Why kernels have a cache of their own: what numba's own does where processes share a folder.

Where one of these tests fails, numba has changed: `KernelCache` may have become needless.
"""

from __future__ import annotations

import importlib.util
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.caching import IndexDataCacheFile

TEXT = """
from part import scale

def total(values):
    found = 0 * values[0]
    for value in values:
        found += scale(value)
    return found
"""
PART = """
import numba

@numba.njit
def scale(value):
    return {factor} * value
"""


@pytest.fixture
def source(tmp_path, monkeypatch) -> Path:
    """A folder of two modules; numba keeps what it compiles below it."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "whole.py").write_text(TEXT)
    (tmp_path / "part.py").write_text(PART.format(factor=1))
    return tmp_path


def imported(source: Path, name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, source / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def process(source: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the kernel as a new process has it: nothing is compiled."""
    monkeypatch.setitem(__import__("sys").modules, "part", imported(source, "part"))
    return numba.njit(imported(source, "whole").total, cache=True)


def test_of_two_processes_at_once_one_loads_the_code_of_the_other(source, monkeypatch):
    floats, whole = np.array([1.0, 2.0]), np.array([1, 2])
    first, second = process(source, monkeypatch), process(source, monkeypatch)
    files: list[IndexDataCacheFile] = [one._cache._cache_file for one in (first, second)]
    # The second reads the index before the first has written it, and writes its own after that.
    index, save = files[1]._load_index(), files[0]._save_data
    monkeypatch.setattr(files[1], "_load_index", lambda: index)

    def save_after_second(*given: Any) -> None:
        assert second(floats) == 3
        save(*given)

    monkeypatch.setattr(files[0], "_save_data", save_after_second)
    assert first(whole) == 3
    assert process(source, monkeypatch)(floats) != 3


def test_a_folder_that_can_only_be_read_is_not_read(source, monkeypatch):
    process(source, monkeypatch)(np.array([1.0]))
    filled, real = source / "cache", tempfile.TemporaryFile

    def read_only(dir: str) -> Any:
        if filled in Path(dir).parents:
            raise OSError(30, "Read-only file system")
        return real(dir=dir)

    monkeypatch.setattr(tempfile, "TemporaryFile", read_only)
    kernel = process(source, monkeypatch)
    assert kernel(np.array([1.0])) == 1
    assert sum(kernel.stats.cache_hits.values()) == 0


def test_a_change_in_the_file_of_a_part_is_missed(source, monkeypatch):
    assert process(source, monkeypatch)(np.array([1.0, 2.0])) == 3
    (source / "part.py").write_text(PART.format(factor=10))
    assert process(source, monkeypatch)(np.array([1.0, 2.0])) == 3  # and not 30
