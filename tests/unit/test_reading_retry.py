"""Reads that the system makes fail: repeated, and distinguished from damage."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from exwarp_cli.errors import DamagedFileError, InputError, OutputError, UnreadableError
from exwarp_cli.io import files
from exwarp_cli.io.files import with_retries
from exwarp_cli.io.key_file import KeyFile


@pytest.fixture(autouse=True)
def at_once(monkeypatch) -> list[float]:
    """Record the pauses instead of making them."""
    pauses: list[float] = []
    monkeypatch.setattr(files.time, "sleep", pauses.append)
    return pauses


class Reader:
    """Raises the given errors, one after the other, and then reads."""

    def __init__(self, *errors: Exception) -> None:
        self.errors = list(errors)
        self.calls = 0

    def __call__(self) -> str:
        self.calls += 1
        if self.errors:
            raise self.errors.pop(0)
        return "pixels"


def system(number: int) -> OSError:
    return OSError(number, os.strerror(number))


@pytest.fixture
def frame(tmp_path):
    path = tmp_path / "a.exr"
    path.write_bytes(b"pixels")
    return path


@pytest.mark.parametrize("number", [errno.ESTALE, errno.EIO, errno.ETIMEDOUT, errno.ENOMEM])
def test_a_share_that_comes_back_is_read(frame, at_once, number):
    read = Reader(system(number), system(number), system(number))
    assert with_retries(frame, read) == "pixels"
    assert at_once == [0.1, 0.4, 1.6]


def test_a_share_that_stays_away_is_named_with_its_reason(frame):
    read = Reader(*(system(errno.ESTALE) for _ in range(9)))
    with pytest.raises(UnreadableError, match=r"a\.exr: Stale file handle; .*share") as caught:
        with_retries(frame, read)
    assert read.calls == 4 and caught.value.exit_code == 3
    assert not isinstance(caught.value, InputError)


def test_rights_are_tried_once_more_and_not_for_long(frame, at_once):
    with pytest.raises(UnreadableError, match="Permission denied; check the rights"):
        with_retries(frame, Reader(*(system(errno.EACCES) for _ in range(9))))
    assert at_once == [0.1]


def test_a_damaged_file_is_damaged(frame, at_once):
    read = Reader(*(DamagedFileError("truncated") for _ in range(9)))
    with pytest.raises(DamagedFileError, match="truncated"):
        with_retries(frame, read)
    assert read.calls == 2 and at_once == []  # a fault that has just passed looks the same


def test_a_decoder_that_hides_the_reason_does_not_hide_it_here(frame, monkeypatch):
    def refuse(*_: object) -> int:
        raise system(errno.EMFILE)

    monkeypatch.setattr(files.os, "open", refuse)
    with pytest.raises(UnreadableError, match="Too many open files; raise the limit"):
        with_retries(frame, Reader(*(DamagedFileError("not an EXR") for _ in range(9))))


@pytest.mark.parametrize("number", [errno.ENOENT, errno.EISDIR, errno.ENOTDIR, errno.EINVAL])
def test_a_wrong_path_is_not_tried_again(frame, at_once, number):
    read = Reader(system(number))
    with pytest.raises(OSError, match=os.strerror(number)):
        with_retries(frame, read)
    assert read.calls == 1 and at_once == []


class TestCopies:
    def test_the_source_is_named_where_it_fails(self, frame, tmp_path, monkeypatch):
        opened = Path.open

        def refuse(path: Path, *mode: str, **more: int) -> object:
            if path == frame:
                raise system(errno.EIO)
            return opened(path, *mode, **more)

        monkeypatch.setattr(Path, "open", refuse)
        with pytest.raises(UnreadableError, match=r"cannot read .*a\.exr: Input/output error"):
            KeyFile(frame).write(tmp_path / "b.exr")
        assert not (tmp_path / "b.exr").exists()

    def test_the_target_is_named_where_it_fails(self, frame, tmp_path, monkeypatch):
        def refuse(*_: object) -> int:
            raise system(errno.EIO)

        monkeypatch.setattr(files.os, "fsync", refuse)
        with pytest.raises(OutputError, match=r"cannot write .*b\.exr"):
            KeyFile(frame).write(tmp_path / "b.exr")
