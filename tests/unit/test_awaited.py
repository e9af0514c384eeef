"""Waiting for files that other machines wrote."""

from __future__ import annotations

import threading
import time

from exwarp_cli.io.files import await_file


def test_a_file_that_is_there_is_not_waited_for(tmp_path):
    (tmp_path / "a").touch()
    begin = time.monotonic()
    await_file(tmp_path / "a", patience=5)
    assert time.monotonic() - begin < 1


def test_one_that_shows_later(tmp_path):
    threading.Timer(0.3, (tmp_path / "a").touch).start()
    begin = time.monotonic()
    await_file(tmp_path / "a", patience=30)
    assert (tmp_path / "a").exists()
    assert time.monotonic() - begin < 15


def test_one_that_never_shows_and_has_no_folder(tmp_path):
    begin = time.monotonic()
    await_file(tmp_path / "none" / "a", patience=0.3)
    assert 0.3 <= time.monotonic() - begin < 5
