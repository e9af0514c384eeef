"""Loaded by worker processes of this machine when they start: see `distributed.preloading`."""

from __future__ import annotations

import signal


def dask_setup(_worker: object) -> None:
    """Leave Ctrl-C to the coordinator, and load what chunks need while the others start too."""
    # A terminal sends it to every process of the command; the coordinator ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import exwarp_cli.farm.cluster_work  # noqa: F401
