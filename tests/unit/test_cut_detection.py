"""Cuts between key frames: found where scene, camera or footage change, and nowhere else."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, Image, KeyFrame, Window
from exwarp_cli.domain.timeline import CutOption, parse_cuts
from exwarp_cli.errors import MissingFrameError, UsageError
from exwarp_cli.synthesis.cut_detection import CutEvidence, compare_thumbnails, make_thumbnail
from tests.matrix import combinations
from tests.unit.scenes import Rectangle, Scene, town, vec

GEOMETRY = ("depth", "normal", "position", "stencil")
KNOWN = {
    "all": (),
    "no stencil": ("stencil",),
    "normals": ("position",),
    "depth": ("position", "normal", "stencil"),
    "vectors": GEOMETRY,
    "vectors to previous": ("to_next",),
    "vectors to next alone": (*GEOMETRY, "to_previous"),
    "colour": (*GEOMETRY, "to_previous", "to_next"),
}
"""What a renderer left out."""


def is_cut(before: KeyFrame, after: KeyFrame) -> CutEvidence:
    """What is found."""
    return compare_thumbnails(make_thumbnail(before), make_thumbnail(after))


def shot(index: int = 0) -> Scene:
    """The town, or another place with bricks of its own: level ground and sky as there."""
    scene = town()
    if index == 0:
        return scene
    rng = np.random.default_rng(index)
    quads = [Rectangle(vec(-9, 1.9, 2), vec(18, 0, 1), vec(0, 0, 12), waves=(33.0, 51.0))]
    for _ in range(9):
        corner = vec(rng.uniform(-5, 3), rng.uniform(-2, 0.5), rng.uniform(4, 10))
        across = vec(rng.uniform(1, 3), 0, rng.uniform(-1.5, 1.5))
        colour = tuple(rng.uniform(0.1, 0.9, 3))
        waves = tuple(rng.uniform(5, 25, 2))
        up = vec(0, rng.uniform(0.8, 2.5), 0)
        quads.append(Rectangle(corner, across, up, colour=colour, waves=waves))
    return replace(scene, quads=tuple(quads))


def key(scene: Scene, time: float, missing: tuple[str, ...] = ()) -> KeyFrame:
    return scene.view(time).key(int(time)).without(*missing)


def shown(frame: KeyFrame, pixels: np.ndarray) -> KeyFrame:
    """The frame with other colour."""
    return replace(frame, image=replace(frame.image, pixels=pixels.astype(np.float32)))


def moved(frame: KeyFrame, **vectors: np.ndarray) -> KeyFrame:
    assert frame.gbuffer is not None
    return replace(frame, gbuffer=replace(frame.gbuffer, **vectors))


@pytest.mark.parametrize(
    ("missing", "scene"), combinations(list(KNOWN.values()), [town(), town().still(), shot(1)])
)
def test_neighbours_are_no_cut(scene: Scene, missing: tuple[str, ...]) -> None:
    for time in (0, 3):
        found = is_cut(key(scene, time, missing), key(scene, time + 1, missing))
        assert not found.found, found


@pytest.mark.parametrize("missing", list(KNOWN.values())[:-1], ids=list(KNOWN)[:-1])
def test_other_scenes_are_a_cut(missing: tuple[str, ...]) -> None:
    places = [key(shot(index), 1, missing) for index in range(4)]
    for before, after in zip(places, places[1:] + places[:1], strict=True):
        found = is_cut(before, after)
        assert found.found, found


@pytest.mark.parametrize("missing", list(KNOWN.values())[:-1], ids=list(KNOWN)[:-1])
def test_another_camera_in_the_same_scene_is_a_cut(missing: tuple[str, ...]) -> None:
    """Its world positions, normals and ids are all there, elsewhere."""
    scene = shot(2)
    camera = replace(scene.camera, start=vec(3.5, -0.8, 1.0), yaw=-0.35)
    found = is_cut(key(scene, 1, missing), key(replace(scene, camera=camera), 1, missing))
    assert found.found, found


@pytest.mark.parametrize(
    ("factor", "missing"), combinations([0.05, 0.3, 4.0, 30.0], list(KNOWN.values()))
)
def test_flashes_and_fades_are_no_cut(missing: tuple[str, ...], factor: float) -> None:
    before, after = key(town(), 0, missing), key(town(), 1, missing)
    assert not is_cut(before, shown(after, factor * after.image.pixels)).found


@pytest.mark.parametrize("missing", ["all", "no stencil", "normals", "depth"])
def test_light_that_changes_every_pattern_is_no_cut(missing: str) -> None:
    """Geometry goes on. Without geometry the same pair is a cut."""
    before, after = (key(town(), time, KNOWN[missing]) for time in (0, 1))
    lit = shown(after, key(shot(3), 1).image.pixels)
    found = is_cut(before, lit)
    assert not found.found, found
    assert found.geometry is not None
    assert is_cut(before.without(*GEOMETRY), lit.without(*GEOMETRY)).found


@pytest.mark.parametrize("missing", ["all", "vectors", "vectors to next alone"])
def test_noise_is_no_cut(missing: str) -> None:
    """Noise as path tracing with one sample a pixel leaves it."""
    scene, rng = town((384, 240)), np.random.default_rng(4)
    frames = []
    for time in (0, 1):
        frame = key(scene, time, KNOWN[missing])
        noise = rng.gamma(1.0, 1.0, frame.image.pixels.shape)
        frames.append(shown(frame, frame.image.pixels * noise))
    assert not is_cut(*frames).found


@pytest.mark.parametrize("missing", KNOWN.values(), ids=KNOWN)
def test_black_cuts_and_fades_do_not(missing: tuple[str, ...]) -> None:
    lit, dark = key(town(), 0, missing), key(town(), 1, missing)
    gbuffer = None
    if dark.gbuffer is not None:
        nothing = replace(town(), quads=())
        gbuffer = nothing.view(1).gbuffer().without(*missing)
    black = replace(shown(dark, np.zeros_like(dark.image.pixels)), gbuffer=gbuffer)
    assert is_cut(lit, black).found
    assert is_cut(black, lit).found
    assert not is_cut(black, black).found
    assert not is_cut(shown(lit, 1e-3 * lit.image.pixels), black).found


def panorama(seed: int) -> np.ndarray:
    """Soft blots over three frames' width, float32 [80, 384, 4]; odd seeds are darker."""
    noise = np.random.default_rng(seed).normal(size=(80, 384))
    rate = np.fft.fftfreq(80)[:, None] ** 2 + np.fft.rfftfreq(384) ** 2
    soft = np.fft.irfft2(np.fft.rfft2(noise) * np.exp(-rate / (2 * 0.12**2)), noise.shape)
    level = (soft - soft.min()) / np.ptp(soft)
    return (level[..., None] ** (1 + seed % 2) * [0.9, 0.8, 0.6, 1]).astype(np.float32)


def pan(shift: int, vectors: np.ndarray | None = None) -> tuple[KeyFrame, KeyFrame]:
    """Two frames of a camera that turns right by so many pixels."""
    wide, window = panorama(5), Window(0, 0, 128, 80)
    there = np.broadcast_to(np.float32([-shift, 0]), (80, 128, 2)) if vectors is None else vectors
    out = []
    for number, left in enumerate((20, 20 + shift)):
        gbuffer = GBuffer(window, to_next=there, to_previous=-there)
        out.append(KeyFrame(number, Image(wide[:, left : left + 128], window, window), gbuffer))
    return out[0], out[1]


@pytest.mark.parametrize("shift", [1, 30, 64, 110, 125, 200])
def test_whip_pans_with_vectors_are_no_cut(shift: int) -> None:
    assert not is_cut(*pan(shift)).found


@pytest.mark.parametrize("shift", [1, 12, 40])
def test_pans_without_vectors_are_no_cut(shift: int) -> None:
    before, after = pan(shift)
    assert not is_cut(replace(before, gbuffer=None), replace(after, gbuffer=None)).found


def test_cuts_without_vectors() -> None:
    window = Window(0, 0, 128, 80)
    frames = [
        KeyFrame(seed, Image(panorama(seed)[:, 100:228], window, window), None)
        for seed in range(7, 12)
    ]
    assert all(is_cut(a, b).found for a, b in pairwise(frames))


def test_vectors_that_are_wrong_throughout_make_no_cut() -> None:
    """Of another scale or sign: a run of a thousand cuts would hide the mistake."""
    wrong = np.broadcast_to(np.float32([25, 9]), (80, 128, 2))
    found = is_cut(*pan(30, wrong))
    assert not found.found
    assert found.colour is not None
    assert found.colour < 0.15


@pytest.mark.parametrize(("gamma", "cut"), [(1.0, False), (1.5, True)])
def test_what_shifts_half_explain_is_a_cut_where_tones_differ(gamma: float, cut: bool) -> None:
    """A swaying picture with wrong vectors: shifts tell less of it than of a pan."""
    wrong = np.broadcast_to(np.float32([25, 9]), (80, 128, 2))
    before, _ = pan(0, wrong)
    rows, columns = np.indices((80, 128))
    swayed = np.clip(columns + 8 * np.sin(rows / 9), 0, 127).astype(int)
    found = is_cut(before, shown(before, before.image.pixels[rows, swayed] ** gamma))
    assert found.shifted is not None
    assert 0.2 < found.shifted < 0.3
    assert found.found is cut


def test_vectors_of_flow_that_fit_anything_do_not_hide_a_cut() -> None:
    """They make the patterns of another shot agree, but do not lead back."""
    wide, rng = panorama(5), np.random.default_rng(6)
    window, place = Window(0, 0, 128, 80), np.indices((80, 128))[::-1].transpose(1, 2, 0)
    before = Image(wide[:, :128], window, window)
    # Each 8x8 block of the later shot is a copy of some block of the earlier one.
    rows, columns = rng.integers(0, 73, (10, 16)), rng.integers(0, 121, (10, 16))
    origin = np.stack([columns, rows], -1).repeat(8, 0).repeat(8, 1) + place % 8
    after = replace(before, pixels=before.pixels[origin[..., 1], origin[..., 0]])
    to_previous = (origin - place).astype(np.float32)
    flow = rng.uniform(-20, 20, (80, 128, 2)).astype(np.float32)
    frames = (
        KeyFrame(0, before, GBuffer(window, to_next=flow)),
        KeyFrame(1, after, GBuffer(window, to_previous=to_previous)),
    )
    assert is_cut(*frames).found
    one_sided = replace(frames[0], gbuffer=GBuffer(window))
    agreeing = is_cut(one_sided, frames[1])
    assert agreeing.colour is not None
    assert agreeing.colour > 0.9


@pytest.mark.parametrize("vectors", [0.0, np.nan], ids=["still", "missing"])
def test_much_sky_with_wrong_vectors_is_no_cut(vectors: float) -> None:
    """Clouds over nine tenths of a panning frame; only the ground's vectors are right."""
    field = np.full((80, 128, 2), vectors, np.float32)
    field[70:] = (-30, 0)
    before, after = pan(30, field)
    depth = np.full((80, 128), np.inf, np.float32)
    depth[70:] = 5
    found = is_cut(*(moved(frame, depth=depth) for frame in (before, after)))
    assert not found.found
    assert found.colour is not None
    assert found.colour > 0.3, "the ground alone counts"


@pytest.mark.parametrize("left_over", [0, 20])
def test_what_comes_to_fill_the_frame_is_no_cut(left_over: int) -> None:
    """It hides the older frame, all of it or but for a strip, and came from outside."""
    before = key(shot(1).still(), 0)
    near, behind = key(shot(3).still(), 0), key(shot(1).still(), 1)
    assert before.gbuffer is not None
    assert near.gbuffer is not None
    assert behind.gbuffer is not None
    strip = np.arange(128) < left_over
    still = np.broadcast_to(strip[:, None], (80, 128, 1))
    position = np.where(still, behind.gbuffer.position, [0.5, 0.25, 1])
    gbuffer = replace(
        behind.gbuffer,
        depth=np.where(strip, behind.gbuffer.depth, 1).astype(np.float32),
        position=position.astype(np.float32),
        to_previous=np.where(still, 0, [300, 0]).astype(np.float32),
    )
    pixels = np.where(still, behind.image.pixels, near.image.pixels)
    assert not is_cut(before, shown(replace(behind, gbuffer=gbuffer), pixels)).found


def test_a_glance_goes_by_the_display_window() -> None:
    """Overscan and cropped data windows do not shift it."""
    frame = key(town((256, 160)), 0)
    around = frame.on(Window(-7, -5, 280, 171))
    part = frame.on(Window(40, 30, 100, 90))
    whole, wide, narrow = make_thumbnail(frame), make_thumbnail(around), make_thumbnail(part)
    np.testing.assert_array_equal(wide.light, whole.light)
    np.testing.assert_array_equal(wide.to_next, whole.to_next)
    np.testing.assert_array_equal(narrow.light[16:58, 21:69], whole.light[16:58, 21:69])
    assert narrow.light[:14].max() == 0
    assert not narrow.surface[:14].any()


def test_a_glance_is_the_mean_of_its_cells() -> None:
    window = Window(0, 0, 512, 320)
    pixels = np.zeros((320, 512, 3), np.float32)
    pixels[8:12, 4:6] = 4.0  # half of a cell, in luminance 4
    pixels[100, 100] = np.nan
    light = make_thumbnail(KeyFrame(1, Image(pixels, window, window), None)).light
    assert light.shape == (80, 128)
    assert light[2, 1] == pytest.approx(1.0)
    assert np.count_nonzero(light) == 1


@pytest.mark.parametrize(
    ("text", "wish"),
    [
        ("auto", CutOption(True, ())),
        ("none", CutOption(False, ())),
        ("1045,1101", CutOption(False, (1045, 1101))),
        (" 1101, 1045 ", CutOption(False, (1045, 1101))),
        ("AUTO,1045", CutOption(True, (1045,))),
        ("10-12", CutOption(False, (10, 11, 12))),
        ("10-20:5", CutOption(False, (10, 15, 20))),
    ],
)
def test_cuts_are_read(text: str, wish: CutOption) -> None:
    assert parse_cuts(text) == wish


@pytest.mark.parametrize("text", ["", "never", "10.5", "none,5", "5,,x", "1045 1101"])
def test_what_is_no_list_of_cuts_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="--cuts"):
        parse_cuts(text)


def test_given_cuts_are_found_in_the_sequence() -> None:
    numbers = (1001, 1005, 1009, 1013)
    assert parse_cuts("1001,1009").starts_in(numbers) == {2}
    assert parse_cuts("auto").starts_in(numbers) == frozenset()
    with pytest.raises(MissingFrameError, match=r"frame 1010 of --cuts .* 1001-1013x4"):
        parse_cuts("1009,1010").starts_in(numbers)
