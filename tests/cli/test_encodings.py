"""Names of files in other encodings than UTF-8, and terminals that have another one."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli import shots

COMMAND = (sys.executable, "-m", "exwarp_cli")


@pytest.fixture(scope="module")
def latin_1(tmp_path_factory) -> dict[str, str]:
    """Make a locale in Latin-1; return the environment that has it."""
    if shutil.which("localedef") is None:
        pytest.skip("no locales can be made here")
    folder = tmp_path_factory.mktemp("locales")
    name = "en_US.ISO-8859-1"
    made = ["localedef", "-i", "en_US", "-f", "ISO-8859-1", str(folder / name)]
    if subprocess.run(made, capture_output=True, check=False).returncode:
        pytest.skip("no locale in Latin-1 can be made here")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("LC_", "LANG", "PYTHON"))}
    return {**kept, "LOCPATH": str(folder), "LC_ALL": name}


def printed(arguments: tuple[str, ...], environment: dict[str, str], folder: Path) -> bytes:
    done = subprocess.run(
        [*COMMAND, *arguments], capture_output=True, env=environment, cwd=folder, timeout=120,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def accented(tmp_path) -> Path:
    """A shot in a folder whose name is no ASCII."""
    return shots.sequence(tmp_path / "k\xe9y", shots.colour_only, (1, 2), shots.SMALL)


def test_a_terminal_in_latin_1_reads_names_as_they_are(latin_1, accented):
    """Both in what is opened and in what is printed."""
    found = printed(("inspect", str(accented)), latin_1, Path.cwd())
    assert f"{accented}/".encode() in found


def test_a_job_from_a_terminal_in_latin_1_names_the_same_files(latin_1, accented):
    call = ("farm", "commands", str(accented), "-o", "out", "-m", "hold")
    found = printed(call, latin_1, Path.cwd())
    assert f"'{accented}'".encode() in found


def test_command_lines_name_files_as_the_disk_does(accented):
    """They are run by a shell, whatever encoding the output has."""
    call = ("farm", "commands", str(accented), "-o", "out", "-m", "hold")
    found = printed(call, {**os.environ, "PYTHONIOENCODING": "latin-1"}, Path.cwd())
    assert f"'{accented}'".encode() in found


@pytest.mark.parametrize("kind", ["commands", "openjd"])
def test_a_current_folder_that_no_job_can_name_is_refused(
    exwarp, plain_shot, tmp_path, monkeypatch, kind
):
    """Its name becomes a part of all paths of the job, whose tasks could not read them."""
    folder = shutil.copytree(plain_shot, os.fsdecode(os.fsencode(tmp_path) + b"/k\xe9y"))
    monkeypatch.chdir(folder)
    before = shots.names(Path(folder))
    result = exwarp("farm", kind, ".", "-o", "../out", "-m", "s6", "--motion", "forward")
    assert result.code == 3 and result.out == ""
    assert "y' holds bytes that are no UTF-8, which no job can carry; rename it" in result.err
    assert shots.names(Path(folder)) == before
