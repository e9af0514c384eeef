"""What is told of files that are being read."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path

import pytest

from exwarp_cli.domain import being_read as module
from exwarp_cli.domain.being_read import PLACES, ROOM, Board, being_read, hang_up


@pytest.fixture
def board(monkeypatch) -> Board:
    monkeypatch.setattr(module, "_board", None)
    made = Board()
    hang_up(made)
    return made


def test_nothing_is_told_where_nobody_watches(monkeypatch):
    monkeypatch.setattr(module, "_board", None)
    with being_read(Path("a.exr")):
        pass


def test_files_are_told_while_they_are_read(board):
    with being_read(Path("a.exr")), being_read(Path("ünïcödé 帧.exr")):
        assert sorted(board.notes().values()) == [Path("a.exr"), Path("ünïcödé 帧.exr")]
    assert board.notes() == {}


def test_each_reading_has_its_number(board):
    seen = set()
    for _ in range(5):
        with being_read(Path("a.exr")):
            seen |= set(board.notes())
    assert len(seen) == 5


def test_an_error_ends_it(board):
    with pytest.raises(KeyError), being_read(Path("a.exr")):
        raise KeyError
    assert board.notes() == {}


def test_more_than_there_are_places_for(board):
    with ExitStack() as stack:
        for number in range(PLACES + 3):
            stack.enter_context(being_read(Path(f"{number}.exr")))
        assert len(board.notes()) == PLACES
    assert board.notes() == {}


def test_long_names_and_any_bytes(board):
    with being_read(Path("x" * 2 * ROOM)):
        assert len(str(next(iter(board.notes().values())))) < ROOM
    odd = Path(os.fsdecode(b"\xff\xfe.exr"))
    with being_read(odd):
        assert list(board.notes().values()) == [odd]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes of POSIX")
def test_another_process_sees_it(board):
    child = os.fork()
    if child == 0:
        with being_read(Path("of the child.exr")):
            os._exit(0)  # as a crash leaves it
    os.waitpid(child, 0)
    assert list(board.notes().values()) == [Path("of the child.exr")]
