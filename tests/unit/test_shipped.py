"""The network that comes with ExWarp, on a shot that it never saw."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.domain.frame import SURFACE_PARTS
from exwarp_cli.domain.network_api import Extrapolator
from exwarp_cli.io.dataset import open_scene
from exwarp_cli.metrics.registry import score_frame
from exwarp_cli.models.picture_network import load_extrapolator
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.synthesis.methods import METHODS
from tests.matrix import combinations
from tests.unit.filled import without

SHOT = Path(__file__).parents[1] / "data" / "miniature" / "variety-0074"
LEFT_OUT = {
    "nothing": (),
    "specular": SURFACE_PARTS[1:],
    "surface": SURFACE_PARTS,
    "normals and ids": ("normal", "stencil"),
}


@pytest.fixture(scope="module")
def network() -> Extrapolator:
    return load_extrapolator(None, 1, "cpu")


@pytest.fixture(scope="module")
def footage() -> SceneClip:
    return SceneClip(open_scene(SHOT))


@pytest.mark.parametrize(("left_out", "setting"), combinations([*LEFT_OUT], ["key", "slot"]))
def test_it_is_better_than_the_warp(network, footage, setting, left_out):
    interval = without(footage.causal(2, setting), *LEFT_OUT[left_out])
    interval = replace(interval, extrapolator=network)
    gains = []
    for slot in (2, 3):
        truth = footage.truth(2, slot).pixels
        scores = [
            score_frame(truth, METHODS[name].predict(interval, slot).pixels, None)[0]
            for name in ("s3", "s6")
        ]
        gains.append(scores[0].psnr_db - scores[1].psnr_db)
    assert np.mean(gains) > 0
