"""A real stereo render: Blender's own multi-view files, and the layouts made of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.io.shot import open_shot
from exwarp_cli.pipeline.source import each_view, open_source
from tests.stereo_layouts import convert, read_eyes

SCRIPT = Path(__file__).with_name("stereo_shot")


@pytest.fixture(scope="module")
def shot(script, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("stereo")
    done = script(SCRIPT, folder, "--resolution", "192x108", "--keys", 2)
    assert done.returncode == 0, done.stderr
    return folder


def test_blender_writes_both_views(shot):
    views = [open_shot(str(shot / "keys"), view) for view in ("left", "right")]
    assert [view.view for view in views] == list(views[0].views) == ["left", "right"]
    assert {view.layout.producer for view in views} == {"Blender"}
    eyes = read_eyes(shot / "keys" / "shot.0001.exr")
    apart = np.abs(eyes["left"]["Position.X"] - eyes["right"]["Position.X"])
    assert np.median(apart) > 0, "the eyes see different points"
    assert len(list((shot / "truth").iterdir())) == 5


@pytest.mark.parametrize("layout", ["single", "nuke", "parts"])
def test_vectors_of_either_view_are_measured(shot, tmp_path, layout):
    convert(shot / "keys", tmp_path, (layout,))
    for name in (shot / "keys", tmp_path / layout):
        for settings in each_view(SourceSettings(str(name), view="all")):
            finding = open_source(settings).finding
            assert finding.source == "calibrated"
            assert finding.error < 0.6 * finding.still_error
