"""Figures of training shots: moving shadows, reflections and thin things."""

from __future__ import annotations

import importlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from exwarp_cli.domain.frame import GBuffer, Image, KeyFrame, Window
from exwarp_cli.io.dataset import open_scene

ROOT = Path(__file__).parents[2]
SHOT = ROOT / "tests" / "data" / "miniature" / "variety-0074"
HIGH, WIDE = 24, 40


@pytest.fixture
def shots(monkeypatch):
    """The module that measures shots."""
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "scenes"))
    return importlib.import_module("survey_shots")


@pytest.fixture
def sheets(monkeypatch):
    """The module that writes contact sheets."""
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "scenes"))
    return importlib.import_module("survey_sheets")


def frame(light: np.ndarray, shift: float = 0.0, **changed: np.ndarray) -> KeyFrame:
    """A still wall 5 m away, of checked paint, whose picture moves by `shift` pixels a frame."""
    rows, columns = np.indices((HIGH, WIDE), np.float32)
    place = np.stack([columns + shift, rows, np.full_like(rows, 5)], axis=-1)
    paint = np.where((rows // 2 + (columns + shift) // 2) % 2, 0.8, 0.2)[..., None]
    paint = np.broadcast_to(paint, (HIGH, WIDE, 3)).astype(np.float32)
    motion = np.zeros((HIGH, WIDE, 2), np.float32)
    parts = {
        "depth": np.full((HIGH, WIDE), 5, np.float32),
        "position": place.astype(np.float32),
        "stencil": np.zeros((HIGH, WIDE), np.int32),
        "to_next": motion,
        "albedo": paint,
        "roughness": np.full((HIGH, WIDE), 0.8, np.float32),
        "metallic": np.zeros((HIGH, WIDE), np.float32),
    }
    pixels = (paint * light[..., None]).astype(np.float32)
    window = Window(0, 0, WIDE, HIGH)
    return KeyFrame(1, Image(pixels, window, window), GBuffer(window, **(parts | changed)))


def shaded(left: int) -> np.ndarray:
    """Light of 1 with a shadow 6 columns wide from a column on, in rows 6 to 17."""
    light = np.ones((HIGH, WIDE), np.float32)
    light[6:18, left : left + 6] = 0.3
    return light


def test_a_shadow_that_moves_is_found_where_it_was_and_where_it_is(shots):
    shadow, mirrored = shots.changed_light(frame(shaded(8)), frame(shaded(20)))
    expected = np.zeros((HIGH, WIDE), np.bool_)
    expected[6:18, 8:14] = expected[6:18, 20:26] = True
    assert (shadow & expected).sum() > 0.8 * expected.sum()
    assert shadow[:, 16:18].sum() == shadow[:3].sum() == 0
    assert not mirrored.any()


def test_a_still_shadow_and_still_paint_do_not_count(shots):
    shadow, mirrored = shots.changed_light(frame(shaded(8)), frame(shaded(8)))
    assert not shadow.any() and not mirrored.any()


def test_what_moves_and_what_lies_elsewhere_does_not_count(shots):
    moving = np.ones((HIGH, WIDE), np.int32)
    first = frame(shaded(8), stencil=moving)
    assert not shots.changed_light(first, frame(shaded(20)))[0].any()
    elsewhere = frame(shaded(20))
    elsewhere = replace(
        elsewhere, gbuffer=replace(elsewhere.gbuffer, position=elsewhere.gbuffer.position + 1)
    )
    assert not shots.changed_light(frame(shaded(8)), elsewhere)[0].any()


def test_on_glossy_things_it_is_a_reflection(shots):
    glossy = np.full((HIGH, WIDE), 0.1, np.float32)
    first, second = (frame(shaded(left), roughness=glossy) for left in (8, 20))
    shadow, mirrored = shots.changed_light(first, second)
    assert not shadow.any() and mirrored.sum() > 80


def test_vectors_are_followed(shots):
    to_next = np.zeros((HIGH, WIDE, 2), np.float32)
    to_next[..., 0] = -4
    light = shaded(20)
    first = frame(light, 0.0, to_next=to_next)
    second = frame(np.roll(light, -4, axis=1), 4.0)
    shadow, _ = shots.changed_light(first, second)
    assert not shadow.any()


def test_thin_things_stand_before_both_sides(shots):
    depth = np.full((HIGH, WIDE), 5, np.float32)
    depth[:, 10:12] = 2  # a pole
    depth[:, 20:30] = 2  # a wall
    found = shots.thin(frame(shaded(8), depth=depth))
    assert found[:, 10:12].all()
    found[:, 10:12] = False
    assert not found.any()


def test_sampling_is_bilinear_and_ends_at_the_edge(shots):
    values = np.arange(12, dtype=np.float32).reshape(3, 4, 1)
    where = np.array([[[1.5, 0.5], [3.0, 2.0], [3.1, 0.0], [-0.1, 1.0]]], np.float32)
    found = shots.sample(values, where)[0, :, 0]
    np.testing.assert_allclose(found[:2], [3.5, 11.0])
    assert np.isnan(found[2:]).all()


def test_a_rendered_shot_is_measured_and_summed_up(shots, loose_objects, tmp_path):
    row = shots.measure(open_scene(SHOT))
    assert row["shot"] == "variety-0074" and row["engine"] == "Cycles"
    assert row["motion_p99_px"] >= row["motion_median_px"] > 0
    for key in ("hole_share", "shadow_share", "thin_share", "moving_share"):
        assert 0 <= row[key] < 1
    still = row | {"shadow_share": 0.0, "features": ["wind"], "shot": "variety-0075"}
    total = shots.summary([row | {"shadow_share": 0.2}, still])
    assert total["shots_with_shadows"] == 1 and total["features"] == {"wind": 1}
    assert total["shadow_share"]["median"] == pytest.approx(0.1)
    shots.write_rows([row, still], tmp_path / "SHOTS.md")
    text = (tmp_path / "SHOTS.md").read_text(encoding="utf-8")
    assert text.count("| variety-00") == 2 and "| 20.0 |" not in text


def test_a_sheet_shows_only_shots_that_may_be_committed(sheets, tmp_path, capsys):
    data = tmp_path / "data"
    for name, licence in (("free", "CC0"), ("game", "GPL-2+")):
        shutil.copytree(SHOT, data / name)
        manifest = data / name / "manifest.json"
        content = json.loads(manifest.read_text(encoding="utf-8"))
        manifest.write_text(json.dumps(content | {"things": [{"licence": licence}]}), "utf-8")
    shots = [open_scene(data / name) for name in ("free", "game")]
    for any_licence, count in ((False, 1), (True, 2)):
        path = tmp_path / f"{count}.png"
        sheets.write_shots(shots, 60, path, any_licence)
        assert f"{count} of 2 shots" in capsys.readouterr().out
        wide = sheets.TILE_WIDTH * sheets.ACROSS
        assert read_still(path).shape == (round(sheets.TILE_WIDTH * 36 / 64), wide, 3)
    with pytest.raises(SystemExit, match="nothing for it is rendered"):
        sheets.write_shots(shots[1:], 60, tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


def read_still(path: Path) -> np.ndarray:
    return oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)
