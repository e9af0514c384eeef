"""A rendered scene whose content is known exactly."""

from __future__ import annotations

import pytest

from exwarp_cli.io.dataset import open_scene
from exwarp_cli.research.training.scene_clip import SceneClip
from tests.unit.analytic_scene import write_scene


@pytest.fixture(scope="session")
def footage(tmp_path_factory) -> SceneClip:
    """The analytic scene as it is played; read only."""
    return SceneClip(open_scene(write_scene(tmp_path_factory.mktemp("data") / "analytic")))
