"""Kernels, their cache, and the self test."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from exwarp_cli.errors import UsageError
from exwarp_cli.kernels import _compile
from exwarp_cli.pipeline.doctor import libraries, self_test
from exwarp_cli.runtime.compilation import compilation
from exwarp_cli.runtime.machine import Folder
from exwarp_cli.synthesis import warp
from tests.cli.doctor.judging import failed, healthy, warned


def use_folders(monkeypatch, writable: Path | None, *shared: Path) -> None:
    """Have compiled kernels go to a folder, or nowhere, and be read from others too."""
    folders = (*shared, *([] if writable is None else [writable]))
    monkeypatch.setattr(_compile, "writable_folder", lambda: writable)
    monkeypatch.setattr(_compile, "folders", lambda: folders)


def use_kernels(monkeypatch, loaded: int, compiled: int) -> None:
    monkeypatch.setattr(compilation, "loaded", loaded)
    monkeypatch.setattr(compilation, "compiled", compiled)


class TestKernels:
    def test_interpreted_kernels(self, examined, monkeypatch):
        monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
        found = examined("kernels", "kernel_cache")
        warned(found, "kernels", "NUMBA_DISABLE_JIT")
        assert found[1]["checks"]["kernel_cache"]["found"].startswith("not used")

    def test_no_cache(self, examined, monkeypatch):
        use_folders(monkeypatch, None)
        found = examined("kernel_cache")
        warned(found, "kernel_cache", "every run compiles", "NUMBA_CACHE_DIR")

    def test_a_cache_that_cannot_be_written(self, examined, monkeypatch, tmp_path):
        use_folders(monkeypatch, tmp_path)
        monkeypatch.setattr(libraries, "look_at", lambda p: Folder(p, "Read-only file system", 1))
        found = examined("kernel_cache")
        warned(found, "kernel_cache", str(tmp_path), "Read-only file system", "NUMBA_CACHE_DIR")
        assert found[1]["checks"]["kernel_cache"]["facts"]["writable"] is False

    def test_a_full_disk(self, examined, monkeypatch, tmp_path):
        use_folders(monkeypatch, tmp_path)
        monkeypatch.setattr(libraries, "look_at", lambda p: Folder(p, None, 1 << 20))
        warned(examined("kernel_cache"), "kernel_cache", "is full")

    def test_a_named_folder_that_is_not_taken(self, examined, monkeypatch, tmp_path):
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "elsewhere"))
        warned(examined("kernel_cache"), "kernel_cache", "elsewhere", "unset it")

    @pytest.mark.parametrize("other", ["another", "none"])
    def test_a_shared_folder_that_can_only_be_read(self, examined, monkeypatch, tmp_path, other):
        shared, own = tmp_path / "shared" / "exwarp", tmp_path / "own"
        shared.mkdir(parents=True)
        own.mkdir()
        (shared / "gather.kernel").write_bytes(b"1234")
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(shared.parent))
        use_folders(monkeypatch, None if other == "none" else own, shared)
        use_kernels(monkeypatch, 5, 0)
        found = examined("kernel_cache")
        healthy(found, "kernel_cache")
        facts = found[1]["checks"]["kernel_cache"]["facts"]
        assert facts["folders"][0] == {"path": str(shared), "place": "in NUMBA_CACHE_DIR"}
        assert facts["kernels"] == 1 and facts["bytes"] == 4
        use_kernels(monkeypatch, 5, 1)
        warned(examined("kernel_cache"), "kernel_cache", "NUMBA_CACHE_DIR")

    def test_where_the_cache_is(self, monkeypatch, tmp_path):
        source = Path(_compile.__file__).parent / "__pycache__"
        assert libraries.place_of(source) == "beside the source"
        assert libraries.place_of(tmp_path / "numba" / "kernels_1") == "in the user's cache"
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
        assert libraries.place_of(tmp_path / "kernels_1") == "in NUMBA_CACHE_DIR"

    def test_what_came_from_the_cache_is_counted(self, examined, monkeypatch):
        use_kernels(monkeypatch, 5, 3)
        _, document = examined("kernel_cache")
        check = document["checks"]["kernel_cache"]
        assert check["found"].startswith("partly cold until now;")
        assert check["facts"]["warm"] is False and check["facts"]["compiled"] == 3
        use_kernels(monkeypatch, 0, 3)
        _, document = examined("kernel_cache")
        assert document["checks"]["kernel_cache"]["found"].startswith("cold until now;")


class TestSelfTest:
    @pytest.fixture(autouse=True)
    def one_method(self, monkeypatch) -> None:
        """Try one method; the test of the page tries all."""
        monkeypatch.setattr(self_test, "METHODS", {"s6": None})

    def test_frames_and_chunks_are_right(self, examined):
        found = examined("self_test", "kernel_cache")
        healthy(found, "self_test")
        runs = found[1]["checks"]["self_test"]["facts"]["runs"]
        frames = {name: run["frames"] for name, run in runs.items()}
        assert frames == {"s6": 12, "chunks": 12}
        facts = found[1]["checks"]["kernel_cache"]["facts"]
        assert facts["loaded"] + facts["compiled"] >= 1
        assert facts["kernels"] >= 1 and facts["bytes"] > 1000

    def test_wrong_pixels(self, examined, monkeypatch):
        """The smallest step of a half float, in one pixel of each warp, is found."""
        real = warp.resample.resample

        def wrong(image: Any, field: Any, table: Any, out: Any, hole: Any) -> None:
            real(image, field, table, out, hole)
            if out.shape == image.shape:  # pixels beside edges are gathered in rows of their own
                out[24, 40] *= np.float32(1 + 2**-9)

        monkeypatch.setattr(warp.resample, "resample", wrong)
        found = examined("self_test")
        failed(found, "self_test", "upsampling by s6 goes wrong", "9 frames of 12", "shot.0002.exr")
        assert found[1]["checks"]["self_test"]["facts"]["runs"]["chunks"]["ok"]

    def test_vectors_that_are_read_otherwise(self, examined, monkeypatch):
        real = self_test.render

        def turned(slot: int) -> dict[str, np.ndarray]:
            planes = real(slot)
            return planes | {f"Vector.{c}": -planes[f"Vector.{c}"] for c in "XYZW"}

        monkeypatch.setattr(self_test, "render", turned)
        found = examined("self_test")
        failed(found, "self_test", "upsampling by s6", "the vectors were read as")

    def test_chunks_that_differ(self, examined, monkeypatch):
        real = self_test._upsample

        def other(folder: Path, output: str, *rest: Any) -> Any:
            summary = real(folder, output, *rest)
            if output == "chunk1":
                path = folder / output / "shot.0007.exr"
                path.write_bytes(path.read_bytes() + b"\0")
                (folder / output / "shot.0012.exr").unlink()
            return summary

        monkeypatch.setattr(self_test, "_upsample", other)
        failed(
            examined("self_test"),
            "self_test",
            "in chunks",
            "shot.0007.exr and shot.0012.exr differ",
        )

    def test_a_run_that_fails(self, examined, monkeypatch):
        def refuses(*_: Any) -> None:
            raise UsageError("the network is out of order; mend it")

        monkeypatch.setattr(self_test, "upsample", refuses)
        found = examined("self_test")
        failed(found, "self_test", "by s6 goes wrong: the network is out of order; mend it;")
        assert found[1]["checks"]["self_test"]["found"].startswith("nothing is right")

    def test_the_shot_moves_by_whole_pixels(self):
        before, after = self_test.render(0), self_test.render(1)
        right, down = self_test.RIGHT, self_test.DOWN
        assert right > 0 > down
        for name in "RGBA":
            np.testing.assert_array_equal(after[name][:down, right:], before[name][-down:, :-right])
