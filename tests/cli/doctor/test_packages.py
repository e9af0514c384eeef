"""Packages that are missing, of other versions, or cannot be imported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from email.message import Message
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from packaging.requirements import Requirement

from exwarp_cli import __version__
from exwarp_cli.pipeline.doctor import environment
from tests.cli.doctor.judging import NAMES, failed, healthy, remarks, warned

ROOT = Path(__file__).parents[3]


class TestPackages:
    @pytest.fixture
    def versions(self, monkeypatch):
        """Pretend that packages have other versions; None that they are not installed."""

        def pretend(**others: str | None) -> None:
            real = environment.version
            wanted = {name.replace("_", "-"): version for name, version in others.items()}

            def version(name: str) -> str:
                if name.lower() not in wanted:
                    return real(name)
                if wanted[name.lower()] is None:
                    raise metadata.PackageNotFoundError(name)
                return wanted[name.lower()]

            monkeypatch.setattr(environment, "version", version)

        return pretend

    @pytest.fixture
    def required(self, monkeypatch):
        """Make ExWarp's own metadata ask for something else."""

        def pretend(*lines: str, extras: tuple[str, ...] = (), version: str = __version__) -> None:
            headers = Message()
            for extra in extras:
                headers["Provides-Extra"] = extra
            own = SimpleNamespace(requires=list(lines), metadata=headers, version=version)
            monkeypatch.setattr(environment, "distribution", lambda _: own)

        return pretend

    def test_a_version_out_of_range(self, examined, versions):
        versions(numba="0.1")
        found = examined("packages", "extras")
        failed(found, "packages", "numba is 0.1", "<0.69,>=0.67", "'numba<0.69,>=0.67'")
        assert found[1]["failed"] == ["packages"]

    def test_a_version_that_is_excluded(self, examined, versions):
        versions(click="8.2.1")
        failed(examined("packages"), "packages", "click is 8.2.1")

    def test_a_package_that_is_missing(self, examined, versions):
        versions(rich=None)
        failed(examined("packages"), "packages", "rich is not installed", "pip install 'rich>=13'")

    def test_a_package_that_stands_in(self, examined, versions):
        versions(onnxruntime=None, onnxruntime_gpu="1.22.0")
        found = examined("packages")
        healthy(found, "packages")
        listed = found[1]["checks"]["packages"]["facts"]["packages"]
        assert {"onnxruntime-gpu"} == {p["name"] for p in listed if p["name"].startswith("onnxr")}

    def test_a_stand_in_that_is_too_old(self, examined, versions):
        versions(onnxruntime=None, onnxruntime_gpu="1.2")
        failed(examined("packages"), "packages", "onnxruntime-gpu is 1.2")

    @pytest.mark.parametrize(
        ("error", "advice"),
        [
            (ImportError("libGL.so.1: cannot open shared object file"), "that has libGL.so.1"),
            (AttributeError("_ARRAY_API not found"), "pip install --force-reinstall 'openimage"),
        ],
    )
    def test_a_package_that_cannot_be_imported(self, examined, monkeypatch, error, advice):
        real = environment.importlib.import_module

        def load(name: str, *rest: Any) -> Any:
            if name == "OpenImageIO":
                raise error
            return real(name, *rest)

        monkeypatch.setattr(environment.importlib, "import_module", load)
        failed(examined("packages"), "packages", str(error), advice)

    def test_another_version_than_the_one_installed(self, examined, required):
        required("numpy>=2", version="0.0.1")
        warned(examined("packages"), "packages", "0.0.1", __version__, "install it again")

    def test_without_being_installed(self, examined, monkeypatch):
        def missing(name: str) -> None:
            raise metadata.PackageNotFoundError(name)

        monkeypatch.setattr(environment, "distribution", missing)
        warned(examined("packages", "extras"), "packages", "pip install .")

    def test_requirements_of_other_platforms_do_not_count(self, examined, required):
        required('never-heard-of>=1; sys_platform == "plan9"', "numpy>=2")
        found = examined("packages")
        healthy(found, "packages")
        assert found[1]["checks"]["packages"]["found"].startswith("1 of 1 ")

    def test_extras_that_are_not_there_are_no_defect(self, examined, required):
        required(
            "never-heard-of>=1; extra == 'one'", "numpy>=2; extra == 'two'", extras=("one", "two")
        )
        found = examined("extras")
        healthy(found, "extras")
        check = found[1]["checks"]["extras"]
        assert check["found"] == "two installed, one not (pip install 'exwarp[one]')"
        installed = {name: extra["installed"] for name, extra in check["facts"]["extras"].items()}
        assert installed == {"one": False, "two": True}

    def test_an_extra_that_is_half_there(self, examined, required):
        required("numpy>=2; extra == 'one'", "never-heard-of>=1; extra == 'one'", extras=("one",))
        warned(examined("extras"), "extras", "never-heard-of is not installed", "extra one")

    def test_an_extra_that_is_too_old(self, examined, required):
        required("numpy>=99; extra == 'one'", extras=("one",))
        warned(examined("extras"), "extras", "numpy is ", ">=99", "extra one")

    def test_every_requirement_has_a_module(self):
        project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
        names = [Requirement(line).name.lower() for line in project["dependencies"]]
        modules = [environment.MODULES.get(name, name) for name in names]
        assert [module for module in modules if find_spec(module) is None] == []


class TestBrokenImport:
    def test_the_other_checks_go_on(self, tmp_path):
        """A library that cannot be loaded, in a process of its own."""
        folder = tmp_path / "broken" / "OpenImageIO"
        folder.mkdir(parents=True)
        said = "libGL.so.1: cannot open shared object file: No such file or directory"
        (folder / "__init__.py").write_text(f"raise ImportError({said!r})\n")
        env = {**os.environ, "PYTHONPATH": f"{folder.parent}{os.pathsep}{ROOT}"}
        done = subprocess.run(
            [sys.executable, "-m", "exwarp_cli", "doctor", "--json"],
            env=env,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 10 and "Traceback" not in done.stderr, done.stderr
        document = json.loads(done.stdout)
        assert list(document["checks"]) == NAMES
        assert document["failed"][:1] == ["packages"] and "self_test" in document["failed"]
        assert not {"kernels", "models", "machine", "video"} & set(document["failed"])
        assert "install the system's package that has libGL.so.1" in remarks(document, "packages")
        assert "libGL.so.1" in remarks(document, "self_test")
        assert f"exwarp: error: {len(document['failed'])} of {len(NAMES)} checks" in done.stderr

    def test_a_check_that_breaks(self, examined, monkeypatch):
        def broken() -> None:
            raise ZeroDivisionError("of all things\nand more")

        monkeypatch.setattr(environment, "check_machine", broken)
        found = examined("machine", "temp_folder")
        failed(found, "machine", "unexpected ZeroDivisionError: of all things;")
        assert found[1]["checks"]["temp_folder"]["outcome"] == "ok"
