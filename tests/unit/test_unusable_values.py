"""NaN and infinities in any AOV stay where they are, and never reach a network or a frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import NetworkPictures
from exwarp_cli.io.channels import Role
from exwarp_cli.io.dataset import open_scene
from exwarp_cli.io.frames import SURFACE, read_raw
from exwarp_cli.io.shot import Shot
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.synthesis.extrapolation import Prepared
from tests.matrix import combinations
from tests.unit.analytic_scene import write_scene
from tests.unit.filled import Filled
from tests.unit.reading import changed_planes

K, SLOT = 3, 2
SETTINGS = ("key", "slot")
SHAPE = (Role.COLOUR, Role.DEPTH, Role.NORMAL, Role.POSITION, Role.STENCIL, Role.MOTION)

BLOCKS = {
    np.nan: np.s_[30:36, 20:28],
    np.inf: np.s_[40:46, 90:98],
    -np.inf: np.s_[60:66, 50:58],
}
REACH = 14
"""Pixels around a block that may change: motion over an interval, and holes filled from there."""


FEW = 0.003
"""Share of the other pixels that may change nevertheless: ids decide who hides whom."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    return write_scene(tmp_path_factory.mktemp("data") / "analytic")


def spoil(monkeypatch, *spoiled: Role) -> set[int]:
    """Let blocks of roles be unusable in all frames; return the numbers of those that were."""
    met: set[int] = set()

    def change(_shot: Shot, number: int, role: Role, planes: np.ndarray) -> np.ndarray:
        if role not in spoiled:
            return planes
        met.add(number)
        out = planes.astype(np.float32)
        for value, block in BLOCKS.items():
            out[block] = value
        return out

    changed_planes(monkeypatch, change)
    return met


def prepared(scene: Path, setting: str) -> tuple[Prepared, Float32]:
    """What the network is given and the finished frame."""
    interval = replace(SceneClip(open_scene(scene)).causal(K, setting), extrapolator=Filled())
    return interval.prepared(SLOT), interval.extrapolated(SLOT)


@pytest.fixture(scope="module")
def undisturbed(scene) -> dict[str, tuple[Prepared, Float32]]:
    return {setting: prepared(scene, setting) for setting in SETTINGS}


def around() -> np.ndarray:
    """bool [H, W]: what the blocks may change."""
    out = np.zeros((80, 128), bool)
    for rows, columns in BLOCKS.values():
        out[
            max(rows.start - REACH, 0) : rows.stop + REACH,
            max(columns.start - REACH, 0) : columns.stop + REACH,
        ] = True
    return out


def require_ranges(inputs: NetworkPictures) -> None:
    for name, planes in inputs.pictures.items():
        assert np.isfinite(planes).all(), name
    masks = np.concatenate([inputs.pictures["mask"], inputs.pictures["history"][3::4]])
    assert np.isin(masks, (0, 1)).all()
    normal, rest = inputs.pictures["features"][:3], inputs.pictures["features"][3:]
    assert np.abs(normal).max() <= 1
    assert rest.min() >= 0 and rest.max() <= 1


@pytest.mark.parametrize(
    ("roles", "setting"), combinations([*((role,) for role in SHAPE), tuple(SURFACE)], SETTINGS)
)
def test_it_stays_in_its_block(scene, undisturbed, monkeypatch, roles, setting):
    met = spoil(monkeypatch, *roles)
    found, frame = prepared(scene, setting)
    keys = {4 * k + 1 for k in (K, K - 1, K - 2)}
    slots = {4 * K + 2, 4 * K + 3, 4 * K + 4} if setting == "slot" else set()
    assert met >= keys | slots
    require_ranges(found.inputs)
    assert np.isfinite(frame).all()
    before, expected = undisturbed[setting]
    far = ~around()
    assert (np.abs(frame - expected)[far].max(axis=-1) > 0.03).mean() < FEW
    for name, planes in found.inputs.pictures.items():
        gap = np.abs(planes - before.inputs.pictures[name])[:, far].max(axis=0)
        assert (gap > 0.1).mean() < FEW, name


@pytest.mark.parametrize("role", SURFACE)
def test_surface_is_cleaned_where_it_is_read(scene, monkeypatch, role):
    shot, number = open_scene(scene).instants, 5
    expected = getattr(read_raw(shot, number, (role,)).gbuffer, role.value).copy()
    for block in BLOCKS.values():
        expected[block] = 0
    assert spoil(monkeypatch, role) == set()
    found = getattr(read_raw(shot, number, (role,)).gbuffer, role.value)
    np.testing.assert_array_equal(found, expected)
