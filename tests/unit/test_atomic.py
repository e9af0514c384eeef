"""Files are absent or whole, whatever happens."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from exwarp_cli.errors import InputError, OutputError
from exwarp_cli.io import files
from exwarp_cli.io.files import (
    FOREIGN_AGE_S,
    TEMPORARY_SUFFIX,
    atomic_path,
    atomic_write_bytes,
    atomic_write_text,
    make_folder,
    remove_leftovers,
)
from exwarp_cli.io.key_file import KeyFile


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


class TestAtomicPath:
    def test_the_file_appears_when_the_block_ends(self, tmp_path):
        target = tmp_path / "a.0001.exr"
        with atomic_path(target) as temporary:
            temporary.write_bytes(b"half")
            assert not target.exists()
            assert temporary.parent == tmp_path and temporary.suffix == TEMPORARY_SUFFIX
        assert names(tmp_path) == ["a.0001.exr"]
        assert target.read_bytes() == b"half"

    def test_an_existing_file_is_replaced_at_once(self, tmp_path):
        target = tmp_path / "a"
        target.write_text("old")
        with atomic_path(target) as temporary:
            temporary.write_text("new")
            assert target.read_text() == "old"
        assert target.read_text() == "new"

    @pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
    def test_an_error_leaves_nothing_and_passes(self, tmp_path, error):
        (tmp_path / "a").write_text("old")
        with pytest.raises(error), atomic_path(tmp_path / "a") as temporary:
            temporary.write_text("half")
            raise error
        assert names(tmp_path) == ["a"]
        assert (tmp_path / "a").read_text() == "old"

    @pytest.mark.parametrize(
        ("number", "why"),
        [
            (errno.ENOSPC, "no space is left"),
            (errno.EDQUOT, "quota"),
            (errno.EACCES, "permission denied"),
            (errno.EROFS, "read-only"),
            (errno.EIO, "input/output error"),
            (errno.EBUSY, os.strerror(errno.EBUSY)),
        ],
    )
    def test_system_errors_become_one_sentence(self, tmp_path, number, why):
        with pytest.raises(OutputError, match=why) as caught, atomic_path(tmp_path / "a"):
            raise OSError(number, os.strerror(number))
        assert str(caught.value).startswith(f"cannot write {tmp_path / 'a'}: ")
        assert "\n" not in str(caught.value) and "; " in str(caught.value)
        assert names(tmp_path) == []

    def test_a_failing_flush_keeps_the_old_file(self, tmp_path, monkeypatch):
        def full(_handle: int) -> None:
            raise OSError(errno.ENOSPC, "full")

        (tmp_path / "a").write_text("old")
        monkeypatch.setattr(files.os, "fsync", full)
        with pytest.raises(OutputError, match="no space"):
            atomic_write_text(tmp_path / "a", "new")
        assert names(tmp_path) == ["a"] and (tmp_path / "a").read_text() == "old"

    def test_the_folder_must_exist(self, tmp_path):
        with pytest.raises(OutputError, match="the folder does not exist"):
            atomic_write_text(tmp_path / "no" / "a", "x")

    def test_a_folder_in_the_way(self, tmp_path):
        (tmp_path / "a").mkdir()
        with pytest.raises(OutputError, match="a folder of that name is in the way"):
            atomic_write_text(tmp_path / "a", "x")
        assert names(tmp_path) == ["a"]

    @pytest.mark.parametrize("name", ["é" * 127, "x" * 255, "a b%#[1].exr"])
    def test_names_may_be_as_long_as_the_system_allows(self, tmp_path, name):
        atomic_write_bytes(tmp_path / name, b"1")
        assert names(tmp_path) == [name]

    def test_many_at_once_in_one_folder(self, tmp_path):
        with atomic_path(tmp_path / "a") as one, atomic_path(tmp_path / "a") as two:
            assert one != two
            one.write_text("1")
            two.write_text("2")
        assert (tmp_path / "a").read_text() == "1"


class TestWritersAndCopy:
    def test_text_is_utf_8_with_plain_line_ends(self, tmp_path):
        atomic_write_text(tmp_path / "a", "é\nb\r\n")
        assert (tmp_path / "a").read_bytes() == "é\nb\r\n".encode()

    def test_copy_is_byte_for_byte(self, tmp_path):
        data = bytes(range(256)) * 5000
        (tmp_path / "a").write_bytes(data)
        KeyFile(tmp_path / "a").write(tmp_path / "b")
        assert (tmp_path / "b").read_bytes() == data
        assert names(tmp_path) == ["a", "b"]

    def test_pieces_follow_each_other(self, tmp_path):
        pieces = [b"1", bytearray(b"23"), memoryview(b"4" * 99999), b"", b"5"]
        atomic_write_bytes(tmp_path / "a", *pieces)
        assert (tmp_path / "a").read_bytes() == b"123" + b"4" * 99999 + b"5"

    def test_a_copy_of_a_read_only_file_can_be_replaced(self, tmp_path):
        (tmp_path / "a").write_bytes(b"1")
        (tmp_path / "a").chmod(0o444)
        KeyFile(tmp_path / "a").write(tmp_path / "b")
        KeyFile(tmp_path / "a").write(tmp_path / "b")
        assert (tmp_path / "b").stat().st_mode & 0o200

    def test_a_missing_source_is_the_inputs_fault(self, tmp_path):
        with pytest.raises(InputError, match=r"cannot read .*/a: No such file"):
            KeyFile(tmp_path / "a").write(tmp_path / "b")
        assert names(tmp_path) == []

    def test_a_missing_target_folder_is_the_outputs_fault(self, tmp_path):
        (tmp_path / "a").touch()
        with pytest.raises(OutputError, match="the folder does not exist"):
            KeyFile(tmp_path / "a").write(tmp_path / "no" / "b")


class TestMakeFolder:
    def test_parents_are_made_and_nothing_is_left(self, tmp_path):
        make_folder(tmp_path / "a" / "b")
        make_folder(tmp_path / "a" / "b")
        assert names(tmp_path / "a" / "b") == []

    @pytest.mark.parametrize("inside", ["file", "file/below"])
    def test_a_file_in_the_way(self, tmp_path, inside):
        (tmp_path / "file").touch()
        with pytest.raises(OutputError, match=r"in the way|is a file, not a folder"):
            make_folder(tmp_path / inside)

    @pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder none can write in")
    def test_a_folder_that_takes_no_files(self):
        with pytest.raises(OutputError, match="cannot write /proc/self"):
            make_folder(Path("/proc/self"))


DIES_HALF_WAY = """
import os, signal, sys
from pathlib import Path
from exwarp_cli.io.files import atomic_path
with atomic_path(Path(sys.argv[1])) as temporary:
    temporary.write_text("half")
    print("half", flush=True)
    sys.stdin.readline()
    os.kill(os.getpid(), signal.SIGKILL)
"""


class TestLeftovers:
    def test_a_killed_run_leaves_one_and_the_next_removes_it(self, tmp_path):
        with subprocess.Popen(
            [sys.executable, "-c", DIES_HALF_WAY, str(tmp_path / "a.0001.exr")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        ) as process:
            assert process.stdout.readline() == b"half\n"
            assert remove_leftovers(tmp_path) == 0, "the process lives"
            assert len(names(tmp_path)) == 1
            process.stdin.write(b"\n")
        assert process.returncode == -signal.SIGKILL
        (left,) = names(tmp_path)
        assert left.endswith(TEMPORARY_SUFFIX), "no image suffix, so no reader takes it for a frame"
        assert remove_leftovers(tmp_path) == 1
        assert names(tmp_path) == []

    def test_those_of_this_process_stay(self, tmp_path):
        with atomic_path(tmp_path / "a") as temporary:
            temporary.touch()
            assert remove_leftovers(tmp_path) == 0
            assert temporary.exists()

    @pytest.mark.parametrize(("age", "removed"), [(FOREIGN_AGE_S - 60, 0), (FOREIGN_AGE_S + 60, 1)])
    def test_those_of_other_machines_go_by_age(self, tmp_path, age, removed):
        foreign = tmp_path / f".a.exr.elsewhere-4026531836-1-0{TEMPORARY_SUFFIX}"
        foreign.touch()
        os.utime(foreign, (time.time() - age,) * 2)
        assert remove_leftovers(tmp_path) == removed

    def test_other_files_stay(self, tmp_path):
        kept = [
            "a.0001.exr",
            ".hidden",
            f"notes{TEMPORARY_SUFFIX}",
            f".a.x-y-z{TEMPORARY_SUFFIX}",
            ".a.host-1-0.tmp",
        ]
        for name in kept:
            (tmp_path / name).touch()
            os.utime(tmp_path / name, (0, 0))
        assert remove_leftovers(tmp_path) == 0
        assert names(tmp_path) == sorted(kept)

    def test_no_folder_no_leftovers(self, tmp_path):
        assert remove_leftovers(tmp_path / "none") == 0
