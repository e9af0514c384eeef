"""Rendered scenes in every variant, against a scene whose content is known exactly."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.errors import InputError, MissingFrameError
from exwarp_cli.io.dataset import open_scene
from exwarp_cli.research.training.augmentation import Variant, reverse_time
from exwarp_cli.research.training.scene_clip import SceneClip
from tests.matrix import combinations, spread
from tests.unit.analytic_scene import INSTANTS, STEP, surface, write_scene
from tests.unit.scenes import SKY, View, town


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return write_scene(tmp_path_factory.mktemp("data") / "analytic")


@pytest.fixture(scope="module")
def everywhere(tmp_path_factory) -> Path:
    """The same scene with every instant as a key frame too."""
    return write_scene(tmp_path_factory.mktemp("data") / "analytic", key_step=1)


@functools.cache
def view(index: int) -> View:
    return town().view(STEP * index)


@pytest.mark.parametrize(
    ("variant", "shown"),
    [
        (Variant(), [0, 1, 2, 3, 4, 5, 6, 7, 8]),
        (Variant(phase=3), [3, 4, 5, 6, 7, 8]),
        (Variant(backwards=True), [8, 7, 6, 5, 4, 3, 2, 1, 0]),
        (Variant(phase=1, backwards=True), [7, 6, 5, 4, 3, 2, 1, 0]),
        (Variant(speed=2), [0, 2, 4, 6, 8]),
        (Variant(phase=1, speed=2, backwards=True), [7, 5, 3, 1]),
    ],
)
def test_which_instants_a_variant_shows(variant, shown):
    assert list(variant.order(9)) == shown


def test_backwards_exchanges_the_vectors():
    found = reverse_time(view(4).gbuffer())
    np.testing.assert_array_equal(found.to_next, view(4).gbuffer().to_previous)
    np.testing.assert_array_equal(found.to_previous, view(4).gbuffer().to_next)
    assert reverse_time(GBuffer(Window(0, 0, 1, 1))).to_next is None


def gap_to(found: np.ndarray, here: View, there: View) -> tuple[float, float]:
    """Largest error of motion in pixels: of what stands still, and of what moves and is seen."""
    wanted = here.motion_to(there.time)
    gap = np.linalg.norm(found - wanted, axis=-1)
    still = here.surface < 3
    seen = here.inside(2) & (here.source_surface(there) == here.surface)
    moving = ~still & seen
    assert moving.sum() > 50
    return float(gap[still].max()), float(gap[moving].max())


def assert_shows(footage: SceneClip, k: int) -> None:
    """Everything that is shown of a key interval is what the analytic scene says."""
    variant = footage.variant
    order = variant.order(INSTANTS)
    shown = [view(index) for index in order[4 * k : 4 * k + 5]]
    for i, here in enumerate(shown[:4]):
        np.testing.assert_allclose(footage.truth(k, i).pixels, here.colour, atol=2e-3)
    frames = [(footage.key(k), 0, 4), (footage.key(k + 1), 4, 0)]
    frames += [(footage.slot(k, i), i, i + 1) for i in (1, 2, 3)]
    for frame, i, there in frames:
        g = frame.gbuffer
        same = g.stencil == shown[i].gbuffer().stencil
        assert same.mean() > 0.998
        np.testing.assert_allclose(g.depth[same], shown[i].depth[same], rtol=1e-3)
        for name, plane in surface(shown[i]).items():
            assert np.mean(getattr(g, name) != plane) < 0.002
        motion = g.to_next if there > i else g.to_previous
        still, moving = gap_to(motion, shown[i], shown[there])
        assert still < 0.02, (variant, i)
        assert moving < 0.1, (variant, i)


VARIANTS = [
    *(Variant(phase) for phase in range(4)),
    Variant(backwards=True),
    Variant(3, backwards=True),
    Variant(speed=2),
    Variant(5, backwards=True, speed=2),
    Variant(7, speed=2),
]


@pytest.mark.parametrize("variant", spread(VARIANTS, 5), ids=str)
def test_every_variant_shows_the_scene(folder, variant):
    footage = SceneClip(open_scene(folder), variant)
    assert_shows(footage, footage.intervals[-1])


def test_intervals_end_where_the_render_ends(folder):
    scene = open_scene(folder)
    assert SceneClip(scene).intervals == range(4)
    assert SceneClip(scene, Variant(phase=1)).intervals == range(3)
    assert SceneClip(scene, Variant(speed=2)).intervals == range(2)
    assert SceneClip(scene, Variant(phase=1, speed=2)).intervals == range(1)


def test_motion_beyond_the_render_is_unknown_unless_rendered(folder):
    scene = open_scene(folder)
    rendered = SceneClip(scene)
    assert rendered.key(0).gbuffer.to_previous is not None
    assert rendered.key(4).gbuffer.to_next is not None
    composed = SceneClip(scene, Variant(phase=1))
    assert composed.key(0).gbuffer.to_previous is None
    assert composed.key(0).gbuffer.to_next is not None
    assert composed.key(3).gbuffer.to_next is None
    turned = SceneClip(scene, Variant(phase=1, backwards=True))
    assert turned.key(0).gbuffer.to_previous is None
    assert turned.slot(0, 1).gbuffer.to_previous is not None


@pytest.mark.parametrize(("backwards", "phase"), combinations([False, True], list(range(4))))
def test_where_every_instant_is_a_key_frame_too_motion_is_that_of_the_render(
    everywhere, phase, backwards
):
    """Also to key frames beyond the render, and of surfaces that are hidden in between."""
    variant = Variant(phase, backwards=backwards)
    footage = SceneClip(open_scene(everywhere), variant)
    order = variant.order(INSTANTS)
    way = -4 if backwards else 4
    for k in (0, len(order) // 4 - 1):
        here, gbuffer = view(order[4 * k]), footage.key(k).gbuffer
        for found, there in ((gbuffer.to_next, way), (gbuffer.to_previous, -way)):
            wanted = here.motion_to(STEP * (order[4 * k] + there))
            gap = np.linalg.norm(found - wanted, axis=-1)
            assert gap[here.surface < 3].max() < 0.02
            assert gap.max() < 0.2


@pytest.mark.parametrize(
    ("setting", "variant"),
    combinations(["key", "slot"], [Variant(), Variant(2, True), Variant(1)]),
)
def test_an_interval_is_ready_for_synthesis(folder, variant, setting):
    footage = SceneClip(open_scene(folder), variant)
    interval = footage.interval(1, setting)
    assert len(interval.slots) == (3 if setting == "slot" else 0)
    order = variant.order(INSTANTS)
    for i in (1, 2, 3):
        here, key = view(order[4 + i]), view(order[4])
        for source, found in ((key, interval.back(i)), (view(order[8]), None)):
            field = (found or interval.forward(i)).field
            seen = here.inside(3) & (here.source_surface(source) == here.surface)
            gap = np.linalg.norm(field - here.motion_to(source.time), axis=-1)[seen]
            assert np.nanpercentile(gap, 99) < 0.2


def test_a_shot_that_is_too_short_is_refused(tmp_path):
    folder = write_scene(tmp_path / "analytic", instants=5)
    assert SceneClip(open_scene(folder)).intervals == range(1)
    with pytest.raises(InputError, match="5 instants, too few"):
        SceneClip(open_scene(folder), Variant(speed=2))


def test_a_missing_frame_is_named(tmp_path):
    folder = write_scene(tmp_path / "analytic", instants=9)
    (folder / "instants" / "analytic.0006.exr").unlink()
    footage = SceneClip(open_scene(folder))
    footage.truth(0, 3)
    with pytest.raises(MissingFrameError, match="lacks frame 6"):
        footage.interval(1, "slot")


def test_the_sky_moves_with_the_camera(folder):
    footage = SceneClip(open_scene(folder), Variant(phase=2))
    sky = view(2).surface == SKY
    wanted = view(2).motion_to(view(6).time)
    np.testing.assert_allclose(footage.key(0).gbuffer.to_next[sky], wanted[sky], atol=0.02)
