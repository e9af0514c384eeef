"""The shot that faults are tried on, and what a run of it comes to."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.street import Street
from tests.faults.running import PLAIN, run_here

KEYS = 8


@pytest.fixture(scope="session")
def keys(tmp_path_factory) -> Path:
    """Eight key frames with vectors."""
    folder = tmp_path_factory.mktemp("rendered") / "keys"
    return shots.sequence(folder, shots.plain, range(1, KEYS + 1), Street(48, 27))


@pytest.fixture(scope="session")
def rendered(keys) -> set[bytes]:
    """What key frames' files hold, at four times their rate."""
    return {shots.passed_through(keys / name, 120) for name in shots.names(keys)}


@pytest.fixture(scope="session")
def undisturbed(keys, tmp_path_factory) -> dict[str, bytes]:
    """The files of a run that nothing disturbs, by name."""
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    run_here("upsample", keys, "-o", out, *PLAIN)
    return shots.contents(out)


@pytest.fixture(scope="session")
def shim(tmp_path_factory) -> Path:
    """What fails in place of the C library, built from shim.c."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not Path("/proc/self/fd").exists():
        pytest.skip("needs a C compiler and Linux")
    made = tmp_path_factory.mktemp("shim") / "shim.so"
    source = Path(__file__).with_name("shim.c")
    flags = ["-shared", "-fPIC", "-O1", "-o", str(made), str(source), "-ldl"]
    subprocess.run([compiler, *flags], check=True, capture_output=True)
    return made


@pytest.fixture
def small_disk(tmp_path) -> Iterator[Path]:
    """A file system with room for a part of a run alone."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=128k", "exwarp-test", str(place)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("needs the right to mount")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)
