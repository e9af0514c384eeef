"""Machines, models and ffmpeg that are not as they should be."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from exwarp_cli.errors import MissingExtraError
from exwarp_cli.models import model_file, picture_network, session
from exwarp_cli.pipeline.doctor import environment, libraries
from exwarp_cli.runtime.machine import Folder, Memory, Processors
from tests.cli.doctor.judging import failed, healthy, no_folder, warned


class TestMachine:
    def test_fewer_cpus_than_there_are(self, examined, monkeypatch):
        monkeypatch.setattr(environment, "processors", lambda: Processors(64, 8, 2.5))
        found = examined("machine")
        healthy(found)
        assert found[1]["checks"]["machine"]["found"].startswith("3 of 64 CPUs")

    def test_little_memory(self, examined, monkeypatch):
        monkeypatch.setattr(environment, "memory", lambda: Memory(8 << 30, 300 << 20, 1 << 30))
        warned(examined("machine"), "machine", "300 MiB of memory", "limit")

    def test_a_temporary_folder_that_cannot_be_written(self, examined, monkeypatch, tmp_path):
        monkeypatch.setattr(
            environment, "tempfile", SimpleNamespace(gettempdir=lambda: str(tmp_path / "none"))
        )
        monkeypatch.setattr("tempfile.TemporaryDirectory", no_folder)
        found = examined("temp_folder", "self_test")
        failed(found, "temp_folder", "No such file", "TMPDIR")
        failed(found, "self_test", "see 'temp folder'")

    def test_no_temporary_folder(self, examined, monkeypatch):
        monkeypatch.setattr(environment, "tempfile", SimpleNamespace(gettempdir=no_folder))
        failed(examined("temp_folder"), "temp_folder", "TMPDIR")

    def test_a_full_disk(self, examined, monkeypatch):
        monkeypatch.setattr(environment, "look_at", lambda path: Folder(path, None, 1 << 20))
        warned(examined("temp_folder"), "temp_folder", "nearly full")


class TestModels:
    @pytest.fixture
    def folder(self, monkeypatch, tmp_path) -> Path:
        """A copy of the shipped models, to be spoilt."""
        copy = tmp_path / "models"
        copy.mkdir()
        for path in model_file.shipped_folder().glob("*.*"):
            if path.suffix in (".onnx", ".npz", ".json"):
                shutil.copy(path, copy)
        monkeypatch.setattr(model_file, "shipped_folder", lambda: copy)
        return copy

    def test_the_copy_is_healthy(self, examined, folder):
        healthy(examined("models", "network"), "models", "network")

    def test_wrong_bytes(self, examined, folder):
        data = bytearray((folder / "policy.npz").read_bytes())
        data[-100] ^= 1
        (folder / "policy.npz").write_bytes(data)
        found = examined("models", "network")
        failed(found, "models", "policy.npz is not the one that came with ExWarp", "install")
        assert found[1]["failed"] == ["models"]

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
        offered = [session.CUDA, "CPUExecutionProvider"]
        real = picture_network.load_extrapolator

        def load(path: Path | None, threads: int, device: str) -> Any:
            if device == "cuda":
                raise MissingExtraError("onnxruntime cannot start CUDA; use --device cpu")
            return real(path, threads, device)

        monkeypatch.setattr(picture_network, "load_extrapolator", load)
        monkeypatch.setattr(session.load_runtime(), "get_available_providers", lambda: offered)
        found = examined("network")
        warned(found, "network", "--device")
        assert found[1]["checks"]["network"]["facts"]["devices"] == {"cpu": True, "cuda": False}


class TestVideo:
    def test_a_missing_encoder(self, examined, monkeypatch):
        real = libraries.ffmpeg_names
        monkeypatch.setattr(libraries, "ffmpeg_names", lambda kind: real(kind) - {"libx264"})
        failed(examined("video"), "video", "no encoder libx264", "imageio-ffmpeg")

    def test_a_missing_filter(self, examined, monkeypatch):
        real = libraries.ffmpeg_names
        monkeypatch.setattr(libraries, "ffmpeg_names", lambda kind: real(kind) - {"libvmaf"})
        warned(examined("video"), "video", "no filter libvmaf", "--metrics")

    def test_no_ffmpeg(self, examined, monkeypatch, tmp_path):
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "ffmpeg"))
        failed(examined("video"), "video", "does not start", "IMAGEIO_FFMPEG_EXE")

    def test_what_the_lists_of_ffmpeg_hold(self):
        assert {"libx264", "aac"} <= libraries.ffmpeg_names("encoders")
        assert {"scale", "libvmaf"} <= libraries.ffmpeg_names("filters")
        assert "nonsense" not in libraries.ffmpeg_names("filters")
