"""Compiled kernels on disk: shared, read only, damaged, full."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exwarp_cli.kernels import cache, jit, parabola

ROOT = Path(__file__).parents[2]
SCRIPT = """
import numpy as np
from exwarp_cli.kernels import parabola
out = np.zeros((4, 5, 2), np.float32)
for kernel in (parabola.parabola_serial, parabola.parabola):
    kernel(out + 1, out + 2, np.float32(0.5), out)
    stats = kernel.stats
    print(sum(stats.cache_misses.values()), float(out[0, 0, 0]))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """The only place for builds."""
    return places(monkeypatch, tmp_path / "kernels")[0]


def places(monkeypatch, *paths: Path) -> tuple[Path, ...]:
    monkeypatch.setattr(cache, "places_in_turn", lambda: iter(paths))
    for cached in (cache.folders, cache.writable_folder):
        monkeypatch.setattr(cache, cached.__name__, getattr(cached, "__wrapped__", cached))
    return paths


def run() -> tuple[int, int]:
    """Compile or load a kernel, see that it works; how often it was loaded and compiled."""
    kernel: Any = jit.serial(parabola.parabola_text)
    out = np.zeros((4, 5, 2), np.float32)
    kernel(out + 1, out + 2, np.float32(0.5), out)
    assert (out == 0.5 * 0.5 * (2 - 1) + 0.5 * 0.25 * (2 + 1)).all()
    stats = kernel.stats
    return sum(stats.cache_hits.values()), sum(stats.cache_misses.values())


def test_a_second_run_loads(folder):
    assert run() == (0, 1)
    assert [path.suffix for path in folder.iterdir()] == [cache.SUFFIX]
    assert run() == (1, 0)


@pytest.mark.parametrize("damage", ["cut", "empty", "changed", "foreign"])
def test_a_damaged_file_is_replaced(folder, damage):
    run()
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    middle = len(whole) // 2
    path.write_bytes(
        {
            "cut": whole[:middle],
            "empty": b"",
            "changed": whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :],
            "foreign": b"something else",
        }[damage]
    )
    assert run() == (0, 1)
    assert run() == (1, 0)


def test_what_cannot_be_unpickled_is_compiled_anew(folder):
    run()
    (path,) = folder.iterdir()
    content = b"no pickle"
    path.write_bytes(cache.hashlib.sha256(content).digest() + content)
    assert run() == (0, 1)


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
    real = cache.tempfile.TemporaryFile

    def read_only(dir: Path) -> Any:
        if dir == first:
            raise OSError(30, "Read-only file system")
        return real(dir=dir)

    monkeypatch.setattr(cache.tempfile, "TemporaryFile", read_only)
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
    assert {path.suffix for path in (tmp_path / "exwarp").iterdir()} == {cache.SUFFIX}
    assert start().communicate()[0] == "0 0.625\n0 0.78125\n"


class TestNames:
    """A file's name says all that its content depends on."""

    def test_the_processor(self, folder, monkeypatch):
        codegen = type(jit.serial(parabola.parabola_text).targetctx.codegen())
        run()
        monkeypatch.setattr(codegen, "magic_tuple", lambda self: ("another", "cpu", ""))
        assert run() == (0, 1)
        assert len(list(folder.iterdir())) == 2

    def test_the_version_of_numba(self, folder, monkeypatch):
        run()
        monkeypatch.setattr(cache, "_versions", lambda: ("0.0", "0.0", "3", ""))
        assert run() == (0, 1)

    def test_the_source(self, folder, monkeypatch):
        run()
        monkeypatch.setattr(cache, "source_digest", lambda stem: "0")
        assert run() == (0, 1)

    def test_the_build(self):
        one, other = (
            cache.KernelCache(parabola.parabola_text, {"parallel": wanted})._name(
                (), jit.serial(parabola.parabola_text).targetctx.codegen()
            )
            for wanted in (True, False)
        )
        assert one != other

    def test_the_types_of_arguments(self, folder):
        run()
        kernel: Any = jit.serial(parabola.parabola_text)
        out = np.zeros((4, 10, 2), np.float32)[:, ::2]
        kernel(out + 1, out + 2, np.float32(0.5), out)
        assert len(list(folder.iterdir())) == 2


def test_a_kernel_goes_by_the_files_that_it_uses(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "__file__", str(tmp_path / "cache.py"))
    monkeypatch.setattr(cache, "source_digest", cache.source_digest.__wrapped__)
    (tmp_path / "one.py").write_text("from exwarp_cli.kernels.two import PART\n")
    (tmp_path / "two.py").write_text("from exwarp_cli.kernels import three\nPART = 1\n")
    (tmp_path / "three.py").write_text("X = 1\n")
    (tmp_path / "four.py").write_text("X = 1\n")
    before = cache.source_digest("one")
    (tmp_path / "four.py").write_text("X = 2\n")
    assert cache.source_digest("one") == before
    (tmp_path / "three.py").write_text("X = 2\n")
    assert cache.source_digest("one") != before
