"""Work in several processes, none of which outlives it."""

from __future__ import annotations

import os
import signal
import time
from multiprocessing import active_children
from pathlib import Path

import pytest

from exwarp_cli.errors import ExwarpError, UsageError
from exwarp_cli.runtime.worker_pool import run_tasks, send_message


def test_every_task_comes_with_its_result():
    found = run_tasks(divmod, [(7, 2), (9, 4), (5, 5)], 2)
    assert dict(found) == {(7, 2): (3, 1), (9, 4): (2, 1), (5, 5): (1, 0)}


def test_closed_it_ends_what_is_under_way(tmp_path):
    paths = [tmp_path / name for name in ("first", "second", "third")]
    tasks = [(paths[0], 0.0), (paths[1], 5.0), (paths[2], 5.0)]
    found = run_tasks(touch_later, tasks, 2)
    assert next(found)[0] == tasks[0]
    found.close()
    assert [path.exists() for path in paths] == [True, False, False]
    assert active_children() == []


def test_what_one_raises_ends_the_others(tmp_path):
    tasks = [(tmp_path / "other", 5.0), (tmp_path / "refused", -1.0)]
    with pytest.raises(UsageError, match="no time"):
        list(run_tasks(touch_later, tasks, 2))
    assert not (tmp_path / "other").exists() and active_children() == []


def test_a_process_that_is_ended_from_outside_is_one_sentence():
    with pytest.raises(ExwarpError, match="fewer --jobs"):
        list(run_tasks(os._exit, [(1,)], 1))


def test_interruptions_leave_processes_alone():
    """A terminal sends them to every process, whatever it is doing."""
    found = run_tasks(interrupt_and_return, [(1,), (2,)], 2)
    assert sorted(result for _, result in found) == [1, 2]


def test_what_a_process_tells_is_heard_while_it_works(tmp_path):
    """Its work ends only when it was heard."""
    path = tmp_path / "heard"
    found = run_tasks(tell_and_wait, [(path,)], 1, lambda what: path.write_text(what))
    assert [result for _, result in found] == ["first of two"]


def tell_and_wait(path: Path) -> str | None:
    send_message("first of two")
    for _ in range(1000):
        if path.exists() and (text := path.read_text()):
            return text
        time.sleep(0.01)
    return None


def interrupt_and_return(number: int) -> int:
    os.kill(os.getpid(), signal.SIGINT)
    return number


def touch_later(path: Path, seconds: float) -> None:
    if seconds < 0:
        raise UsageError("there is no time below 0")
    time.sleep(seconds)
    path.touch()
