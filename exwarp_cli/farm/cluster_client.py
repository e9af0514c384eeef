"""Connecting to a Dask cluster: a running one, or one of this machine's processes."""

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

CONNECT_S = 10.0
"""Seconds that a scheduler has to answer."""

LOOPBACK = "127.0.0.1"

STOP_S = 6.0
"""Seconds that they have to end before they are killed."""

_LATE = (OSError, TimeoutError, RuntimeError)
"""What Dask raises where an answer does not come in time, or its event loop has ended."""


def require_cluster() -> Any:
    """Return the module `distributed`; MissingExtraError where it is not installed."""
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError(
            "--workers and --cluster need Dask, which is not installed; install it with pip "
            'install "exwarp[cluster]"'
        ) from error
    return distributed


def threads_each(workers: int, threads: int | None) -> int:
    """Share threads out: how many each of some processes has."""
    return max(1, (threads or processors().allowed) // workers)


@contextmanager
def connected(where: ClusterSettings, threads: int | None) -> Iterator[Any]:
    """Yield a client of the cluster; a local one lives as long as the block.

    Parameters
    ----------
    where
        Which cluster.
    threads
        That processes of this machine share; None for all cores.

    Yields
    ------
    distributed.Client
        With a connection.

    Raises
    ------
    ClusterError
        When the scheduler does not answer, or processes do not start.
    MissingExtraError
        When Dask is not installed.
    """
    distributed = require_cluster()
    with ExitStack() as stack:
        stack.enter_context(_quiet())
        if where.address is None:
            address = stack.enter_context(_local(distributed, where.workers or 1, threads))
        else:
            address = where.address
        yield stack.enter_context(_client(distributed, address))


@contextmanager
def _client(distributed: Any, address: Any) -> Iterator[Any]:
    """Connect, without becoming what Dask uses for everything else in this process."""
    try:
        client = _join(distributed, address)
    except Exception as error:  # whatever comes of what speaks another language, or none
        raise ClusterError(
            f"cannot reach a Dask scheduler at {address} ({_reason(error)}); check the address, "
            "which is like tcp://host:8786, and that 'dask scheduler' runs there"
        ) from error
    try:
        yield client
    finally:
        _leave(client)


def _join(distributed: Any, address: Any) -> Any:
    """Make a client, once a server has answered: one that fails half way holds on to its loop."""
    if isinstance(address, str):
        asyncio.run(asyncio.wait_for(_greet(distributed, address), CONNECT_S))
    return distributed.Client(address, timeout=CONNECT_S, set_as_default=False)


async def _greet(distributed: Any, address: str) -> None:
    """Ask who listens at an address; raises ValueError where it is no scheduler."""
    connection_args = distributed.Security().get_connection_args("client")
    async with distributed.rpc(address, connection_args=connection_args) as server:
        kind = (await server.identity())["type"]
    if kind != "Scheduler":
        raise ValueError(f"a {kind.lower()} of a cluster listens there")


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return f"no answer for {CONNECT_S:g} seconds"
    if isinstance(error, MemoryError):  # what was not meant for it, Dask may read as a size
        return "what listens there does not speak Dask's language"
    return first_line(error)


@contextmanager
def _local(distributed: Any, workers: int, threads: int | None) -> Iterator[Any]:
    """Start processes that end with the block, or with this process, however it ends."""
    import dask

    if sys.platform != "win32":
        # It would lift the block below where the first process begins it.
        resource_tracker.ensure_running()
    with ExitStack() as stack:
        folder = str(stack.enter_context(scratch_folder()))
        # Else some of its parts make a folder for all runs, which is never removed.
        stack.enter_context(dask.config.set({"temporary-directory": folder}))
        try:
            with block_signals(signal.SIGINT):  # this process ends its workers itself
                cluster = distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=threads_each(workers, threads),
                    processes=True,
                    host=LOOPBACK,
                    scheduler_kwargs={"dashboard": False, "dashboard_address": f"{LOOPBACK}:0"},
                    memory_limit=None,
                    silence_logs=logging.CRITICAL,
                    local_directory=folder,
                    preload=["exwarp_cli.farm.cluster_work"],
                )
        except (OSError, RuntimeError) as error:
            raise ClusterError(
                f"cannot start {workers} worker processes on this machine ({first_line(error)}); "
                "use fewer --workers, or none"
            ) from error
        # Taken now, as one that is being closed lists them no more.
        stack.enter_context(clean_up_after(partial(_kill, tuple(cluster.workers.values()))))
        stack.callback(_close, cluster)
        yield cluster


def _leave(client: Any) -> None:
    """Disconnect."""
    with suppress(*_LATE):
        client.close(timeout=STOP_S)


def _close(cluster: Any) -> None:
    """Close a local cluster; those of its processes that do not end are killed afterwards."""
    note_progress()
    with suppress(*_LATE):
        cluster.close(timeout=STOP_S)


def _kill(nannies: Iterable[Any]) -> None:
    """End a local cluster's processes: nothing is lost by it, as what they wrote is whole."""
    for nanny in nannies:
        if nanny.pid:
            with suppress(OSError):  # ended meanwhile
                os.kill(nanny.pid, signal.SIGTERM if os.name == "nt" else signal.SIGKILL)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep to ourselves what Dask says: whatever matters ends in a sentence of our own."""
    import dask

    # Its loggers have levels of their own, and one handler.
    handlers = [(handler, handler.level) for handler in logging.getLogger("distributed").handlers]
    settings = {
        "distributed.comm.timeouts.connect": f"{CONNECT_S}s",
        # Of processes of our own: no user looks at their pages.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    try:
        for handler, _ in handlers:
            handler.setLevel(logging.CRITICAL + 1)
        with dask.config.set(settings), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for handler, level in handlers:
            handler.setLevel(level)
