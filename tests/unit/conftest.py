"""A rendered scene whose content is known exactly, and a machine without a cache."""

from __future__ import annotations

import pytest
from numba.core.dispatcher import Dispatcher

from exwarp_cli.io.dataset import open_scene
from exwarp_cli.kernels import _compile
from exwarp_cli.training.footage import Footage
from tests.unit.analytic_scene import write_scene


@pytest.fixture(scope="session")
def footage(tmp_path_factory) -> Footage:
    """The analytic scene as it is played; read only."""
    return Footage(open_scene(write_scene(tmp_path_factory.mktemp("data") / "analytic")))


@pytest.fixture
def unwritable_cache(monkeypatch) -> None:
    """Let numba, of a version whose insides are not known, find no folder for what it compiles."""

    def unwritable(self) -> None:
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(_compile, "is_tested", lambda: False)
    monkeypatch.setattr(Dispatcher, "enable_caching", unwritable)
