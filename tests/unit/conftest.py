"""A rendered scene whose content is known exactly, and a machine without a cache."""

from __future__ import annotations

import numba
import pytest

from exwarp_cli.io.dataset import open_scene
from exwarp_cli.training.footage import Footage
from tests.unit.analytic_scene import write_scene


@pytest.fixture(scope="session")
def footage(tmp_path_factory) -> Footage:
    """The analytic scene as it is played; read only."""
    return Footage(open_scene(write_scene(tmp_path_factory.mktemp("data") / "analytic")))


@pytest.fixture
def unwritable_cache(monkeypatch) -> None:
    """Let numba find no folder to keep what it compiles."""
    njit = numba.njit

    def unwritable(text, cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return njit(text, cache=False, **options)

    monkeypatch.setattr(numba, "njit", unwritable)
