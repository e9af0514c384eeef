"""Wheel and sdist: they build, hold what a user needs, and the wheel runs where only it is."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from exwarp_cli import __version__
from exwarp_cli.kernels import _compile

ROOT = Path(__file__).parents[2]
KEYS = ROOT / "examples" / "market" / "keys"


@pytest.fixture(scope="module")
def dist(tmp_path_factory) -> Path:
    """Folder with the wheel and the sdist."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "--directory", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def clean(dist, tmp_path_factory) -> Path:
    """Python of an environment with the wheel, and with the dependencies of this one alone.

    A .pth file that names site-packages brings its packages, not the editable ExWarp in it.
    """
    folder = tmp_path_factory.mktemp("clean")
    venv.create(folder, symlinks=True)
    site = next(folder.glob("lib/python*/site-packages"))
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    wheel = next(dist.glob("*.whl"))
    install = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--target",
        str(site),
    ]
    subprocess.run([*install, str(wheel)], check=True, capture_output=True)
    return folder / "bin" / "python"


def test_the_wheel_holds_the_package_and_its_models_alone(dist):
    wheel = next(dist.glob("*.whl"))
    assert wheel.name == f"exwarp-{__version__}-py3-none-any.whl"
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} == {
        "exwarp_cli", f"exwarp-{__version__}.dist-info",
    }  # fmt: skip
    policies = "tile-policy.npz", "look-ahead-policy.npz", "policy.npz"
    for name in ("extrapolator.onnx", "lookahead.onnx", *policies):
        assert f"exwarp_cli/_models/{name}" in names
    assert any(name.endswith(".v") for name in names), "the predictor's Verilog"
    assert any(name.endswith("viewer.js") for name in names), "the report's page"


def test_the_sdist_builds_the_same_wheel(dist, tmp_path):
    archive = next(dist.glob("*.tar.gz"))
    with tarfile.open(archive) as file:
        file.extractall(tmp_path, filter="data")
    source = next(tmp_path.iterdir())
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "--directory", "again"]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    again = next((source / "again").glob("*.whl"))
    first = next(dist.glob("*.whl"))
    assert sorted(zipfile.ZipFile(again).namelist()) == sorted(zipfile.ZipFile(first).namelist())


def test_the_wheel_upsamples_the_example(clean, tmp_path):
    where = subprocess.run(
        [clean, "-c", "import exwarp_cli; print(exwarp_cli.__file__)"],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert str(clean.parents[1]) in where.stdout
    command = [
        clean,
        "-m",
        "exwarp_cli",
        "upsample",
        KEYS,
        "-o",
        "out",
        "--frames",
        "1",
        "--isolated",
    ]
    # The source is the same, and so are its kernels: none has to be compiled again.
    (tmp_path / "exwarp").symlink_to(_compile.writable_folder())
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    run = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert len(list((tmp_path / "out").glob("*.exr"))) == 4
    assert "lookahead" in run.stderr
