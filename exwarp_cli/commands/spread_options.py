"""Options of ``upsample`` that spread a job over processes, machines and chunks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])


def spread_options(command: Command) -> Command:
    """Add --workers, --cluster, --chunk-size and --as-chunk.

    The command takes `workers`, `cluster`, `chunk_size` and `as_chunk`.
    """
    for option in reversed(
        [
            click.option(
                "--workers",
                type=click.IntRange(1),
                metavar="N",
                help="Spread the work over N processes on this machine, which share --threads "
                "(extra: cluster).",
            ),
            click.option(
                "--cluster",
                metavar="ADDRESS",
                help="Spread it over the workers of a running Dask scheduler, tcp://host:port or "
                "tls://host:port; --threads is then for each worker (extra: cluster).",
            ),
            click.option(
                "--chunk-size",
                type=click.IntRange(1),
                metavar="N",
                help="Key frames that a worker is given at a time; else 1 to 10, by the length and "
                "the number of workers.",
            ),
            click.option(
                "--as-chunk",
                is_flag=True,
                help="This is one chunk of a job: put its report into a folder of its own below "
                "--report, which 'exwarp merge-reports' joins.",
            ),
        ]
    ):
        command = option(command)
    return command
