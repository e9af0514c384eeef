"""Work that several processes share, none of which outlives the command."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_context, parent_process
from typing import Any, TypeVar

from exwarp_cli.errors import ExwarpError
from exwarp_cli.runtime.stop import block_signals, check_stop

Task = TypeVar("Task", bound=tuple[Any, ...])
Result = TypeVar("Result")

POLL_S = 0.2  # seconds between two looks at messages

# Signals that reach no process before `_follow_parent` has run in it.
BLOCKED = (signal.SIGINT, signal.SIGTERM)

# Where a worker puts its messages; None in other processes.
_outbox: Any = None


def run_tasks(
    # A function of a module, called in other processes. Whatever it raises is raised here, and ends
    # the others.
    work: Callable[..., Result],
    tasks: Sequence[Task],  # arguments of `work`; like the results, they can be pickled
    jobs: int,  # processes
    # Called here with the messages of workers, in between
    receive: Callable[[Any], None] = lambda _: None,
) -> Generator[tuple[Task, Result], None, None]:
    """Yield every task with its result, as they come; close the iterator to end the work.

    ExwarpError: a process was ended from outside.
    """
    before = set(active_children())
    context = get_context("spawn")
    inbox = context.SimpleQueue()
    pool = ProcessPoolExecutor(jobs, context, _follow_parent, (inbox,))
    try:
        with block_signals(*BLOCKED):
            waiting = {pool.submit(work, *task): task for task in tasks}
        pending: set[Future[Result]] = set(waiting)
        while pending:
            check_stop()
            done, pending = wait(pending, POLL_S, FIRST_COMPLETED)
            while not inbox.empty():
                receive(inbox.get())
            for future in done:
                yield waiting[future], future.result()
    except BrokenProcessPool as error:
        raise ExwarpError(
            "a process of this command was ended from outside, most likely as the memory did not "
            "suffice; run the same command again with fewer --jobs, it goes on from there"
        ) from error
    except BaseException:
        # Else all that is under way would be finished first. No mask and no handler stops `kill`.
        for child in set(active_children()) - before:
            child.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def send_message(message: object) -> None:
    """Send something that can be pickled to the process that gave the work."""
    if _outbox is not None:
        _outbox.put(message)


def _follow_parent(inbox: Any) -> None:
    """Prepare a worker to send messages to its parent, and to end with it, however that ends.

    Interruptions are the parent's business.
    """
    global _outbox
    _outbox = inbox
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, BLOCKED)
    # Where the parent is killed, nothing else would end a process that waits for work.
    threading.Thread(target=_await_parent, daemon=True).start()


def _await_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
