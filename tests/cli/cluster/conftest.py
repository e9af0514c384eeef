"""A shot, and a cluster that does what is asked of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.cluster.dask_cluster import DaskCluster
from tests.cli.cluster.results import KEYS
from tests.cli.conftest import run_quietly
from tests.cli.shots import FORWARD, SMALL


@pytest.fixture(scope="package")
def keys(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("keys") / "keys"
    return shots.sequence(folder, shots.plain, range(1, KEYS + 1), SMALL)


@pytest.fixture(scope="package")
def whole(tmp_path_factory, keys) -> Path:
    """The frames of `s6`, made in one process; read only."""
    out = tmp_path_factory.mktemp("whole") / "frames"
    run_quietly("upsample", keys, "-o", out, "-m", "s6", *FORWARD)
    return out


@pytest.fixture(scope="package")
def truth(tmp_path_factory) -> Path:
    return shots.truth(tmp_path_factory.mktemp("truth") / "truth", shots.KEYS, 1, SMALL)


@pytest.fixture(scope="package")
def farm(tmp_path_factory) -> Iterator[str]:
    """The address of a scheduler with two workers."""
    with DaskCluster(tmp_path_factory.mktemp("farm")) as cluster:
        for _ in range(2):
            cluster.start_worker()
        yield cluster.address
