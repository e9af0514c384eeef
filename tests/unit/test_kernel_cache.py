"""Compiled kernels on disk: shared, read only, damaged, full."""

from __future__ import annotations

import os
import pwd
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exwarp_cli.accelerator import mlp_kernel as accelerator
from exwarp_cli.kernels import _compile, splat
from exwarp_cli.kernels._row_bands import ALL

ROOT = Path(__file__).parents[2]
SCRIPT = """
import numpy as np
from exwarp_cli.kernels import _row_bands, splat
from exwarp_cli.runtime.compilation import compilation
out = np.zeros((4, 5, 2), np.float32)
for threads in (1, None):
    _row_bands.set_threads(threads)
    splat.quadratic_displacement(out + 1, out + 2, np.float32(0.5), out)
    print(compilation.compiled, float(out[0, 0, 0]))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """The only place for _compile."""
    return places(monkeypatch, tmp_path / "kernels")[0]


def places(monkeypatch, *paths: Path) -> tuple[Path, ...]:
    monkeypatch.setattr(_compile, "candidate_folders", lambda: iter(paths))
    for cached in (_compile.folders, _compile.writable_folder):
        monkeypatch.setattr(_compile, cached.__name__, getattr(cached, "__wrapped__", cached))
    return paths


def run() -> tuple[int, int]:
    """Compile or load a kernel, see that it works; how often it was loaded and compiled."""
    kernel: Any = _compile.kernel(splat.quadratic_displacement.__wrapped__)
    out = np.zeros((4, 5, 2), np.float32)
    kernel(out + 1, out + 2, np.float32(0.5), out, ALL)
    assert (out == 0.5 * 0.5 * (2 - 1) + 0.5 * 0.25 * (2 + 1)).all()
    stats = kernel.stats
    return sum(stats.cache_hits.values()), sum(stats.cache_misses.values())


def test_a_second_run_loads(folder):
    assert run() == (0, 1)
    assert [path.suffix for path in folder.iterdir()] == [_compile.SUFFIX]
    assert run() == (1, 0)


def test_a_damaged_file_is_replaced(folder):
    run()
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    middle = len(whole) // 2
    no_pickle = b"no pickle"
    for damaged in (
        whole[:middle],
        b"",
        whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :],
        b"something else",
        _compile.hashlib.sha256(no_pickle).digest() + no_pickle,
    ):
        path.write_bytes(damaged)
        assert run() == (0, 1), damaged[:9]
        assert run() == (1, 0)


def test_a_full_disk_is_no_failure(folder, monkeypatch):
    real = Path.write_bytes

    def half_way(path: Path, content: bytes) -> int:
        real(path, content[: len(content) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", half_way)
    assert run() == (0, 1)
    assert list(folder.iterdir()) == []


def test_a_folder_that_can_only_be_read_is_read(tmp_path, monkeypatch):
    first, second = tmp_path / "first", tmp_path / "second"
    places(monkeypatch, first)
    run()
    real = _compile.tempfile.TemporaryFile

    def read_only(dir: Path) -> Any:
        if dir == first:
            raise OSError(30, "Read-only file system")
        return real(dir=dir)

    monkeypatch.setattr(_compile.tempfile, "TemporaryFile", read_only)
    places(monkeypatch, first, second)
    assert run() == (1, 0)
    assert list(second.iterdir()) == []
    next(first.iterdir()).unlink()
    assert run() == (0, 1)
    assert list(first.iterdir()) == [] and len(list(second.iterdir())) == 1


def test_nothing_is_read_beyond_the_first_folder_that_can_be_written(tmp_path, monkeypatch):
    first, second = tmp_path / "first", tmp_path / "second"
    places(monkeypatch, second)
    run()
    places(monkeypatch, first, second)
    assert run() == (0, 1)


def test_without_any_folder_kernels_are_compiled(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    places(monkeypatch, blocked / "kernels")
    assert run() == (0, 1)
    assert run() == (0, 1)


def test_processes_that_compile_at_once_share_a_folder(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}

    def start() -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", SCRIPT], env=environment, stdout=subprocess.PIPE, text=True
        )

    racing = [start() for _ in range(2)]
    assert [process.communicate()[0] for process in racing] == ["1 0.625\n1 0.78125\n"] * 2
    assert [process.returncode for process in racing] == [0, 0]
    assert {path.suffix for path in (tmp_path / "exwarp").iterdir()} == {_compile.SUFFIX}
    assert start().communicate()[0] == "0 0.625\n0 0.78125\n"


def test_a_file_s_name_says_all_that_its_content_depends_on(folder, monkeypatch):
    codegen = type(_compile.kernel(splat.quadratic_displacement.__wrapped__).targetctx.codegen())
    run()
    for owner, name, other in (
        (codegen, "magic_tuple", lambda self: ("another", "cpu", "")),
        (_compile.numba, "__version__", "0.0"),
        (_compile.llvmlite, "__version__", "0.0"),
        (_compile, "source_digest", lambda file: "0"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, other)
            assert run() == (0, 1), name
    kernel: Any = _compile.kernel(splat.quadratic_displacement.__wrapped__)
    out = np.zeros((4, 5, 2))
    kernel(out + 1, out + 2, np.float32(0.5), out, ALL)
    assert len(list(folder.iterdir())) == 6, "the types of arguments count too"


def test_a_change_in_any_module_of_kernels_is_another_source(tmp_path, monkeypatch):
    monkeypatch.setattr(_compile, "__file__", str(tmp_path / "kernels" / "_compile.py"))
    digest = _compile.source_digest.__wrapped__
    for folder, name in (
        ("kernels", "one"),
        ("kernels", "two"),
        ("accelerator", "three"),
        ("", "own"),
    ):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / f"{name}.py").write_text("X = 1\n")
    found = [digest(tmp_path / "own.py")]
    for path in ("kernels/two.py", "accelerator/three.py", "own.py"):
        (tmp_path / path).write_text("X = 2\n")
        found.append(digest(tmp_path / "own.py"))
    assert len(set(found)) == 4


def test_a_function_that_another_one_makes_is_not_kept(folder):
    """It may depend on that one's variables, which no name tells."""
    for factor in (2, 3):
        assert _compile.kernel(lambda value, factor=factor: value * factor)(5) == 5 * factor
    assert not folder.exists() or list(folder.iterdir()) == []


class TestUnused:
    """Builds that no process loads are removed."""

    def test_old_ones_are_removed_as_another_is_kept(self, folder, monkeypatch):
        monkeypatch.setattr(_compile, "remove_unused", _compile.remove_unused.__wrapped__)
        folder.mkdir()
        for name, days in (("a.kernel", 31), ("b.kernel", 29), ("c.kernel.12ab", 31), ("d.py", 99)):
            (folder / name).write_text("")
            ago = time.time() - days * 86400
            os.utime(folder / name, (ago, ago))
        assert run() == (0, 1)
        kept = {path.name for path in folder.iterdir()}
        assert kept > {"b.kernel", "d.py"} and len(kept) == 3

    def test_a_load_is_noted_once_a_day(self, folder):
        run()
        (path,) = folder.iterdir()
        for hours, noted in ((25, True), (23, False)):
            ago = time.time() - hours * 3600
            os.utime(path, (ago, ago))
            assert run() == (1, 0)
            assert (path.stat().st_mtime > ago + 60) == noted

    def test_what_cannot_be_noted_is_loaded(self, folder, monkeypatch):
        run()
        (path,) = folder.iterdir()
        os.utime(path, (0, 0))

        def refuses(*_: Any) -> None:
            raise OSError(30, "Read-only file system")

        monkeypatch.setattr(_compile.os, "utime", refuses)
        assert run() == (1, 0)


def test_the_accelerator_has_its_builds_there_too(folder):
    def use() -> tuple[int, int]:
        kernel: Any = _compile.kernel(
            getattr(accelerator.run_network, "py_func", accelerator.run_network)
        )
        arrays = np.zeros(4, np.int8), np.zeros((3, 3), np.int32), np.array([1, 2], np.int64)
        outputs = np.ones((1, 2), np.int32)
        kernel(*arrays, np.ones((1, 1), np.int32), 4, outputs)
        assert outputs.tolist() == [[0, 0]]
        stats = kernel.stats
        return sum(stats.cache_hits.values()), sum(stats.cache_misses.values())

    assert use() == (0, 1)
    assert [path.name[:16] for path in folder.iterdir()] == ["mlp_kernel.run_n"]
    assert use() == (1, 0)


@pytest.fixture
def homeless(monkeypatch, tmp_path) -> Path:
    """Neither HOME nor an entry of the user; return the current folder."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)

    def unknown(number: int) -> None:
        raise KeyError(number)

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return here


@pytest.mark.parametrize("cache_home", [None, "", "~/.cache"])
@pytest.mark.parametrize("home", [None, "nonexistent"])
def test_without_home_builds_go_to_a_temporary_folder(homeless, monkeypatch, home, cache_home):
    missing = homeless.parent / "nonexistent"
    if home is not None:
        monkeypatch.setenv("HOME", str(missing))
    if cache_home is not None:
        monkeypatch.setenv("XDG_CACHE_HOME", cache_home)
    places = [place for place in _compile.candidate_folders() if ROOT not in place.parents]
    assert places == [homeless.parent / f"exwarp-{os.getuid()}"]
    assert places[0].stat().st_mode & 0o777 == 0o700
    assert list(homeless.iterdir()) == [] and not missing.exists()


def test_a_cache_folder_that_is_set_needs_no_home(homeless, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert tmp_path / "cache" / "numba" / "exwarp" in _compile.candidate_folders()


@pytest.mark.parametrize("damage", ["writable for others", "a link"])
def test_a_temporary_folder_of_others_is_not_trusted(homeless, tmp_path, damage):
    """Builds are run, and anybody can make a folder of that name."""
    folder = tmp_path / f"exwarp-{os.getuid()}"
    if damage == "a link":
        folder.symlink_to(homeless)
    else:
        folder.mkdir()
        folder.chmod(0o777)
    assert folder not in list(_compile.candidate_folders())
