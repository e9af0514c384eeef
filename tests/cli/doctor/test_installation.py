"""Machines, models and codecs that are not as they should be."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exwarp_cli.errors import MissingExtraError, UsageError
from exwarp_cli.io import model_files, models
from exwarp_cli.pipeline.doctor import codecs, machine, networks
from exwarp_cli.runtime.machine import Folder, Memory, Processors
from tests.cli.doctor.judging import failed, healthy, warned


class TestMachine:
    def test_fewer_cpus_than_there_are(self, examined, monkeypatch):
        monkeypatch.setattr(machine, "processors", lambda: Processors(64, 8, 2.5))
        found = examined("machine")
        healthy(found)
        assert found[1]["checks"]["machine"]["found"].startswith("3 of 64 CPUs")

    def test_little_memory(self, examined, monkeypatch):
        monkeypatch.setattr(machine, "memory", lambda: Memory(8 << 30, 300 << 20, 1 << 30))
        warned(examined("machine"), "machine", "300 MiB of memory", "limit")

    def test_a_temporary_folder_that_cannot_be_written(self, examined, monkeypatch, tmp_path):
        def none(*_: Any, **__: Any) -> None:
            raise FileNotFoundError(2, "No such file or directory")

        monkeypatch.setattr(machine, "temporary_folder", lambda: tmp_path / "none")
        monkeypatch.setattr("tempfile.TemporaryDirectory", none)
        found = examined("temp_folder", "exr")
        failed(found, "temp_folder", "No such file", "TMPDIR")
        failed(found, "exr", "see 'temp folder'")

    def test_no_temporary_folder(self, examined, monkeypatch):
        monkeypatch.setattr(machine, "temporary_folder", lambda: None)
        failed(examined("temp_folder"), "temp_folder", "TMPDIR")

    def test_a_full_disk(self, examined, monkeypatch):
        monkeypatch.setattr(machine, "look_at", lambda path: Folder(path, None, 1 << 20))
        warned(examined("temp_folder"), "temp_folder", "nearly full")


class TestModels:
    @pytest.fixture
    def folder(self, monkeypatch, tmp_path) -> Path:
        """A copy of the shipped models, to be spoilt."""
        copy = tmp_path / "models"
        copy.mkdir()
        for path in models.shipped_folder().glob("*.*"):
            if path.suffix in (".onnx", ".npz", ".json"):
                shutil.copy(path, copy)
        for module in (models, model_files, networks):
            monkeypatch.setattr(module, "shipped_folder", lambda: copy)
        return copy

    def test_the_copy_is_healthy(self, examined, folder):
        healthy(examined("models", "network", "policy"), "models", "network", "policy")

    def test_wrong_bytes(self, examined, folder):
        data = bytearray((folder / "policy.npz").read_bytes())
        data[-100] ^= 1
        (folder / "policy.npz").write_bytes(data)
        found = examined("models", "network", "policy")
        failed(found, "models", "policy.npz is not the one that came with ExWarp", "install")
        assert found[1]["failed"] == ["models", "policy"]

    def test_a_missing_file(self, examined, folder):
        (folder / "extrapolator.onnx").unlink()
        found = examined("models", "network")
        failed(found, "models", "extrapolator.onnx is missing")
        assert found[1]["failed"] == ["models", "network"]
        assert "does not run the extrapolator" in found[1]["checks"]["network"]["found"]

    def test_no_models(self, examined, folder):
        (folder / "checksums.json").unlink()
        failed(examined("models"), "models", "install ExWarp again")

    def test_cuda_that_is_offered_and_does_not_start(self, examined, monkeypatch):
        offered = (models.CUDA, "CPUExecutionProvider")
        real = networks.load_extrapolator

        def load(path: Path | None, threads: int, device: str) -> Any:
            if device == "cuda":
                raise MissingExtraError("onnxruntime cannot start CUDA; use --device cpu")
            return real(path, threads, device)

        monkeypatch.setattr(networks, "load_extrapolator", load)
        monkeypatch.setattr(networks, "providers", lambda: offered)
        found = examined("network")
        warned(found, "network", "--device")
        assert found[1]["checks"]["network"]["facts"]["devices"] == {"cpu": True, "cuda": False}

    @pytest.mark.parametrize(
        ("form", "name"), [("MlpKernel", "compiled"), ("IntegerPolicy", "ONNX")]
    )
    def test_a_policy_that_decides_otherwise(self, examined, monkeypatch, form, name):
        real = getattr(networks, form).decide_many

        def off_by_one(self: Any, states: Any) -> Any:
            found = real(self, states)
            (found[0] if isinstance(found, tuple) else found)[5, 1] += 1
            return found

        monkeypatch.setattr(getattr(networks, form), "decide_many", off_by_one)
        failed(examined("policy"), "policy", f"the {name} policy does not decide as")


class TestCodecs:
    def test_a_compression_that_cannot_be_written(self, examined, monkeypatch):
        monkeypatch.setitem(codecs.COMPRESSIONS, "dwab", "nonsense")
        found = examined("exr")
        failed(found, "exr", "EXR with dwab does not work")
        compressions = found[1]["checks"]["exr"]["facts"]["compressions"]
        assert [name for name, good in compressions.items() if not good] == ["dwab"]

    def test_pixels_that_come_back_changed(self, examined, monkeypatch):
        real = codecs.read_exr

        def read(path: Path) -> dict[str, np.ndarray]:
            found = real(path)
            found["R"] = found["R"].copy()
            found["R"][3, 4] += 0.5
            return found

        monkeypatch.setattr(codecs, "read_exr", read)
        found = examined("exr")
        failed(found, "exr", "come back changed")
        assert not any(found[1]["checks"]["exr"]["facts"]["compressions"].values())

    def test_stills_without_a_writer(self, examined, monkeypatch):
        real = codecs.require_writer

        def without(path: Path) -> Any:
            if path.suffix == ".webp":
                raise UsageError("no")
            return real(path)

        monkeypatch.setattr(codecs, "require_writer", without)
        found = examined("stills")
        warned(found, "stills", "no writer of .webp", "use EXR")
        assert ".webp" not in found[1]["checks"]["stills"]["facts"]["written"]

    def test_a_missing_encoder(self, examined, monkeypatch):
        real = codecs.ffmpeg_has
        monkeypatch.setattr(codecs, "ffmpeg_has", lambda kind: real(kind) - {"libx264"})
        failed(examined("video"), "video", "no encoder libx264", "imageio-ffmpeg")

    def test_a_missing_filter(self, examined, monkeypatch):
        real = codecs.ffmpeg_has
        monkeypatch.setattr(codecs, "ffmpeg_has", lambda kind: real(kind) - {"libvmaf"})
        warned(examined("video"), "video", "no filter libvmaf", "--metrics")

    def test_no_ffmpeg(self, examined, monkeypatch, tmp_path):
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "ffmpeg"))
        failed(examined("video"), "video", "does not start", "IMAGEIO_FFMPEG_EXE")

    def test_what_the_lists_of_ffmpeg_hold(self):
        assert {"libx264", "aac"} <= codecs.ffmpeg_has("encoders")
        assert {"scale", "libvmaf"} <= codecs.ffmpeg_has("filters")
        assert "nonsense" not in codecs.ffmpeg_has("filters")
