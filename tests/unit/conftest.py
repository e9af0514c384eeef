"""A rendered scene whose content is known exactly."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from exwarp_cli.io.dataset import open_scene
from exwarp_cli.kernels import _row_bands
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.synthesis import trajectory
from tests.unit.analytic_scene import write_scene


@pytest.fixture(autouse=True)
def bands_of_small_arrays(monkeypatch) -> None:
    """Let several threads share the small arrays of tests, as they share large ones."""
    monkeypatch.setattr(_row_bands, "SMALL", 0)


@pytest.fixture(scope="session")
def footage(tmp_path_factory) -> SceneClip:
    """The analytic scene as it is played; read only."""
    return SceneClip(open_scene(write_scene(tmp_path_factory.mktemp("data") / "analytic")))


@pytest.fixture(scope="module")
def loose_objects() -> Iterator[None]:
    """Let objects move by their vectors alone: fitting their poses takes most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory, "MIN_OBJECT_PIXELS", 10**9)
        yield
