"""Connecting to a Dask cluster: a running one, or worker processes on this machine."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from multiprocessing import resource_tracker
from typing import Any

from exwarp_cli.domain.settings import ClusterSettings
from exwarp_cli.domain.wording import first_line
from exwarp_cli.errors import ClusterError, MissingExtraError
from exwarp_cli.runtime.machine import processors
from exwarp_cli.runtime.stop import block_signals, clean_up_after, note_progress, scratch_folder

CONNECT_S = 10.0  # seconds that a scheduler has to answer
STOP_S = 6.0  # seconds that processes have to end before they are killed
LOOPBACK = "127.0.0.1"

# What Dask raises where an answer does not come in time, or its event loop has ended.
_NO_ANSWER = (OSError, TimeoutError, RuntimeError)


def require_dask() -> Any:
    """Return the module `distributed`; MissingExtraError where it is not installed."""
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError(
            "--workers and --cluster need Dask, which is not installed; install it with pip "
            'install "exwarp[cluster]"'
        ) from error
    return distributed


def threads_per_worker(workers: int, threads: int | None) -> int:
    """Divide threads, or all cores, among worker processes of this machine."""
    return max(1, (threads or processors().allowed) // workers)


@contextmanager
def connected(where: ClusterSettings, threads: int | None) -> Iterator[Any]:
    """Yield a `distributed.Client`; processes on this machine live as long as the block.

    The processes share `threads`, or all cores for None.

    Raises
    ------
    ClusterError
        When the scheduler does not answer, or processes do not start.
    MissingExtraError
        When Dask is not installed.
    """
    distributed = require_dask()
    with ExitStack() as stack:
        stack.enter_context(_silenced())
        address = where.address
        if address is None:
            address = stack.enter_context(_local_cluster(distributed, where.workers or 1, threads))
        try:
            client = _connect(distributed, address)
        except Exception as error:  # servers of other kinds cause errors of any kind
            raise ClusterError(
                f"cannot reach a Dask scheduler at {address} ({_reason(error)}); check the "
                "address, which is like tcp://host:8786, and that 'dask scheduler' runs there"
            ) from error
        stack.callback(_close, client)
        yield client


def _connect(distributed: Any, address: Any) -> Any:
    if isinstance(address, str):
        # Ask first: a client that fails half way keeps its event loop.
        asyncio.run(asyncio.wait_for(_require_scheduler(distributed, address), CONNECT_S))
    # Not as the default, which Dask would use for everything else in this process.
    return distributed.Client(address, timeout=CONNECT_S, set_as_default=False)


async def _require_scheduler(distributed: Any, address: str) -> None:
    connection_args = distributed.Security().get_connection_args("client")
    async with distributed.rpc(address, connection_args=connection_args) as server:
        kind = (await server.identity())["type"]
    if kind != "Scheduler":
        raise ValueError(f"a {kind.lower()} of a cluster listens there")


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return f"no answer for {CONNECT_S:g} seconds"
    if isinstance(error, MemoryError):  # Dask reads the bytes of other protocols as a size
        return "what listens there does not speak Dask's language"
    return first_line(error)


@contextmanager
def _local_cluster(distributed: Any, workers: int, threads: int | None) -> Iterator[Any]:
    """Start processes that end with the block, or with this process, however it ends."""
    import dask

    if sys.platform != "win32":
        # It would unblock SIGINT below where the first process starts it.
        resource_tracker.ensure_running()
    with ExitStack() as stack:
        folder = str(stack.enter_context(scratch_folder()))
        # Some parts of Dask otherwise make a folder for all runs, which is never removed.
        stack.enter_context(dask.config.set({"temporary-directory": folder}))
        try:
            with block_signals(signal.SIGINT):  # this process ends its workers itself
                cluster = distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=threads_per_worker(workers, threads),
                    processes=True,
                    host=LOOPBACK,
                    scheduler_kwargs={"dashboard": False, "dashboard_address": f"{LOOPBACK}:0"},
                    memory_limit=None,
                    silence_logs=logging.CRITICAL,
                    local_directory=folder,
                    preload=["exwarp_cli.farm.dask_worker"],
                )
        except (OSError, RuntimeError) as error:
            raise ClusterError(
                f"cannot start {workers} worker processes on this machine ({first_line(error)}); "
                "use fewer --workers, or none"
            ) from error
        # Listed now: a cluster that is being closed lists them no more.
        stack.enter_context(clean_up_after(partial(_kill, tuple(cluster.workers.values()))))
        stack.callback(_close, cluster)
        yield cluster


def _close(connection: Any) -> None:
    """Close a client or a local cluster. Processes that do not end are killed afterwards."""
    note_progress()
    with suppress(*_NO_ANSWER):
        connection.close(timeout=STOP_S)


def _kill(nannies: Iterable[Any]) -> None:
    """End a local cluster's processes. Nothing is lost: files appear only when complete."""
    for nanny in nannies:
        if nanny.pid:
            with suppress(OSError):  # ended meanwhile
                os.kill(nanny.pid, signal.SIGTERM if os.name == "nt" else signal.SIGKILL)


@contextmanager
def _silenced() -> Iterator[None]:
    """Hide Dask's log and warnings: what matters becomes a message of ExWarp."""
    import dask

    # Dask's loggers have levels of their own, and one handler. It stays silent after the block,
    # because processes that do not end in time are killed, which Dask logs later.
    for handler in logging.getLogger("distributed").handlers:
        handler.setLevel(logging.CRITICAL + 1)
    settings = {
        "distributed.comm.timeouts.connect": f"{CONNECT_S}s",
        # Processes of this machine need no web pages.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    with dask.config.set(settings), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
