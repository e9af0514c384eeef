"""What a process reports of the files that it reads."""

from __future__ import annotations

import os
import select
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from exwarp_cli.errors import DamagedFileError
from exwarp_cli.runtime import read_registry
from exwarp_cli.runtime.read_registry import (
    ReadRegistry,
    attach,
    enable_restart,
    is_restarted,
    report_reading,
)

pytestmark = pytest.mark.skipif(os.name == "nt", reason="needs processes of POSIX")

Reported = Callable[[], ReadRegistry]


@pytest.fixture(autouse=True)
def detached(monkeypatch) -> None:
    monkeypatch.setattr(read_registry, "_pipe", None)
    monkeypatch.setattr(read_registry, "_skipped", {})


@pytest.fixture
def reported() -> Iterator[Reported]:
    """Returns what was reported until now, to a process that watches this one."""
    reader, writer = os.pipe()
    registry = ReadRegistry()

    def until_now() -> ReadRegistry:
        while select.select([reader], [], [], 0)[0]:
            registry.receive(os.read(reader, 7))  # messages arrive in pieces
        return registry

    attach(writer, {})
    yield until_now
    os.close(reader)
    os.close(writer)


def test_nothing_is_reported_without_a_watcher():
    with report_reading(Path("a.exr")):
        pass
    assert not is_restarted()


def test_files_are_reported_while_they_are_read(reported):
    with report_reading(Path("a.exr")), report_reading(Path("ünïcödé 帧.exr")):
        assert sorted(reported().files.values()) == [Path("a.exr"), Path("ünïcödé 帧.exr")]
    assert reported().files == {}


def test_a_model_is_required(reported):
    with report_reading(Path("a.exr")), report_reading(Path("e.onnx"), required=True):
        known = reported()
        assert [known.files[number] for number in known.required] == [Path("e.onnx")]
    assert reported().required == set()


def test_each_reading_has_its_number(reported):
    seen = set()
    for _ in range(5):
        with report_reading(Path("a.exr")):
            seen |= set(reported().files)
    assert len(seen) == 5


def test_an_error_ends_it(reported):
    with pytest.raises(KeyError), report_reading(Path("a.exr")):
        raise KeyError
    assert reported().files == {}


def test_threads_do_not_mix_what_they_report(reported):
    def read(number: int) -> None:
        for _ in range(20):
            with report_reading(Path(f"{number:03}" * 50)):
                pass

    with ThreadPoolExecutor(4) as pool:
        done = [pool.submit(read, number) for number in range(4)]
        while not all(future.done() for future in done):
            reported()
    assert reported().files == {}


def test_long_names_and_any_bytes(reported):
    with report_reading(Path("x" * 10_000)):
        assert set(str(next(iter(reported().files.values())))) == {"x"}
    odd = Path(os.fsdecode(b"\xff\xfe\n .exr"))
    with report_reading(odd):
        assert list(reported().files.values()) == [odd]


def test_a_command_may_want_to_start_again(reported):
    assert not reported().restarts
    enable_restart()
    assert reported().restarts and not is_restarted()


def test_a_file_that_crashed_a_library_is_not_read_again(reported):
    _, writer = os.pipe()
    attach(writer, {Path("a.exr"): "a.exr crashed it"})
    assert is_restarted()
    with pytest.raises(DamagedFileError, match=r"a\.exr crashed it"), report_reading(Path("a.exr")):
        pass
    with report_reading(Path("b.exr")):
        pass


def test_who_watches_may_have_ended():
    reader, writer = os.pipe()
    os.close(reader)
    attach(writer, {})
    with report_reading(Path("a.exr")):
        pass
    os.close(writer)


def test_what_a_crashed_process_read_is_known(reported):
    child = os.fork()
    if child == 0:
        with report_reading(Path("of the child.exr")):
            os._exit(0)  # as a crash leaves it
    os.waitpid(child, 0)
    assert list(reported().files.values()) == [Path("of the child.exr")]
