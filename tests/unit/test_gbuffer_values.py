"""Steps that G-buffers were rounded to, and holes and composed motion on such G-buffers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.colour import encode_display
from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.metrics.registry import METRICS
from exwarp_cli.synthesis import motion_fields
from exwarp_cli.synthesis.gbuffer_values import (
    EXACT,
    HALF,
    PXR24,
    SINGLE,
    depth_step,
    normal_step,
    relative_step,
)
from exwarp_cli.synthesis.motion_fields import SlotField, compose, field_between
from exwarp_cli.synthesis.trajectory import trace_points
from exwarp_cli.synthesis.warp import Mover
from tests.cli import street
from tests.cli.street import Street

WIDTH, HEIGHT = 160, 90
WINDOW = Window(0, 0, WIDTH, HEIGHT)
STREET = Street(WIDTH, HEIGHT, speed=1.5)
KEY_TIME = 1.0


def gbuffer(time: float) -> GBuffer:
    """What a game engine writes: depth and vectors over a slot, no positions, no ids."""
    seen = STREET.geometry(time)
    return GBuffer(
        WINDOW,
        depth=seen["depth"].astype(np.float32),
        to_previous=seen["slot_previous"].astype(np.float32),
    )


def in_steps(depth: np.ndarray, levels: int) -> np.ndarray:
    """Depth as so many even levels up to the furthest surface."""
    far = depth[np.isfinite(depth)].max()
    return np.where(np.isinf(depth), depth, np.round(depth / far * levels) / levels * far).astype(
        np.float32
    )


def in_inverse_steps(depth: np.ndarray, levels: int) -> np.ndarray:
    """Depth out of a channel that holds near / depth in so many even levels."""
    near = depth.min()
    with np.errstate(divide="ignore"):
        level = np.maximum(np.round(near / depth * levels), 1)
    return np.where(np.isinf(depth), depth, near * levels / level).astype(np.float32)


@pytest.mark.parametrize("time", [0.0, 1.0, 1.75])
def test_exact_depth_has_no_step_that_counts(time):
    depth = gbuffer(time).depth
    linear, inverse = depth_step(depth)
    known = depth[np.isfinite(depth)]
    assert np.all(linear + inverse * known**2 < 0.05 * known)  # at most that from row to row


@pytest.mark.parametrize("levels", [106, 255])
def test_the_step_of_even_levels_is_measured(levels):
    exact = np.random.default_rng(1).uniform(2, 40, (90, 160)).astype(np.float32)
    linear, inverse = depth_step(in_steps(exact, levels))
    assert linear == pytest.approx(exact.max() / levels, rel=0.02)
    assert inverse == 0


@pytest.mark.parametrize("levels", [106, 255])
def test_the_step_of_an_inverse_is_measured(levels):
    exact = np.random.default_rng(2).uniform(3, 30, (90, 160)).astype(np.float32)
    linear, inverse = depth_step(in_inverse_steps(exact, levels))
    assert inverse == pytest.approx(1 / (exact.min() * levels), rel=0.02)
    assert linear == 0


def test_random_and_flat_depths_are_exact():
    rng = np.random.default_rng(3)
    assert depth_step(rng.uniform(1, 9, (90, 160)).astype(np.float32)) == EXACT
    cards = rng.choice(np.float32([2, 4, 6, 8, 10]), (90, 160))
    assert depth_step(cards) == EXACT
    assert depth_step(np.full((90, 160), np.inf, np.float32)) == EXACT


def test_positions_have_the_step_of_their_type():
    values = np.random.default_rng(4).normal(0, 50, (20, 30, 3)).astype(np.float32)
    assert relative_step(values) == SINGLE
    assert relative_step(values.astype(np.float16).astype(np.float32)) == HALF
    cut = (values.view(np.uint32) & np.uint32(0xFFFFFF00)).view(np.float32)
    assert relative_step(cut) == PXR24


def test_normals_have_the_step_of_their_levels():
    normals = np.random.default_rng(5).normal(0, 1, (90, 160, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    assert normal_step(normals.astype(np.float32)) == 0
    coarse = (np.round((normals + 1) * 127.5) / 127.5 - 1).astype(np.float32)
    assert normal_step(coarse) == pytest.approx(1 / 127.5, rel=0.01)


@pytest.fixture
def deep(monkeypatch):
    """The street as a long one, whose far end has few levels."""
    monkeypatch.setattr(street, "WALL", 150.0)
    monkeypatch.setattr(street, "EAVES", -27.0)
    for drawn in (street._colour, street._geometry):  # others keep what the short one shows
        monkeypatch.setattr(street, drawn.__name__, drawn.__wrapped__)


def slots(kind: str) -> tuple[tuple[GBuffer, ...], GBuffer]:
    """Slots 1 to 3, and the key frame, with depth as it was rounded."""
    kinds = {"exact": lambda d: d, "even": lambda d: in_steps(d, 106),
             "inverse": lambda d: in_inverse_steps(d, 255)}  # fmt: skip
    each = [gbuffer(KEY_TIME + i / 4) for i in range(4)]
    key, *rest = (replace(g, depth=kinds[kind](g.depth)) for g in each)
    return tuple(rest), key


@pytest.mark.parametrize("kind", ["even", "inverse"])
def test_rounded_depth_makes_no_holes(kind, deep, monkeypatch):
    exact, rounded = (compose(*slots(name), -1).hole.mean() for name in ("exact", kind))
    assert exact > 0.05
    assert rounded == pytest.approx(exact, abs=0.01)
    monkeypatch.setattr(motion_fields, "depth_step", lambda _: EXACT)
    assert compose(*slots(kind), -1).hole.mean() > exact + 0.02  # so it is the step that helps


@pytest.mark.parametrize("kind", ["exact", "even", "inverse"])
def test_composed_motion_is_no_worse_than_plain_composition(kind, deep):
    each, key = slots(kind)
    colour = STREET.colour(KEY_TIME).astype(np.float32)
    own = [compose(each[:count], key, -1) for count in range(1, len(each) + 1)]
    plain = plainly_composed(each, key)
    for i, (found, expected) in enumerate(zip(own, plain, strict=True), start=1):
        truth = encode_display(STREET.colour(KEY_TIME + i / 4).astype(np.float32))
        scores = [
            METRICS["psnr_db"](truth, encode_display(Mover(source).warp_alone(colour))).value()
            for source in (found, expected)
        ]
        assert scores[0] > scores[1] - 0.3


def plainly_composed(each: tuple[GBuffer, ...], key: GBuffer) -> list[SlotField]:
    """Compose vectors bilinearly, whatever surface they are of."""
    fields: list[np.ndarray] = []
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    for slot in each:
        field = slot.to_previous.copy()
        if fields:
            x, y = columns + field[..., 0], rows + field[..., 1]
            left, top = np.clip(np.floor(x), 0, WIDTH - 2), np.clip(np.floor(y), 0, HEIGHT - 2)
            right, down = np.clip(x - left, 0, 1)[..., None], np.clip(y - top, 0, 1)[..., None]
            p, q, last = left.astype(int), top.astype(int), fields[-1]
            above = (1 - right) * last[q, p] + right * last[q, p + 1]
            below = (1 - right) * last[q + 1, p] + right * last[q + 1, p + 1]
            field += (1 - down) * above + down * below
        fields.append(field.astype(np.float32))
    return [
        field_between(slot, key, field, count)
        for count, (slot, field) in enumerate(zip(each, fields, strict=True), start=1)
    ]


@pytest.mark.parametrize("kind", ["exact", "rounded"])
def test_what_the_renderer_wrote_counts_and_not_what_was_expected(kind):
    """All vectors on the way say 2 pixels, where the point's own foretell 3."""
    depth = np.full((HEIGHT, WIDTH), 5, np.float32)
    if kind == "rounded":
        depth += np.arange(WIDTH, dtype=np.float32) // 8

    def moving(speed: float) -> GBuffer:
        vectors = np.full((HEIGHT, WIDTH, 2), (speed, 0), np.float32)
        return GBuffer(WINDOW, depth=depth, to_previous=vectors)

    found = trace_points(moving(3.0), [moving(2.0), moving(2.0)], -1)
    np.testing.assert_allclose(found[:, 8:-8], np.full_like(found, (7, 0))[:, 8:-8], atol=1e-5)


@pytest.mark.parametrize("way", [1, -1])
def test_the_nearest_instant_is_followed_first(way):
    """The first instant's vectors count at the place that the point's own lead to."""
    depth = np.full((HEIGHT, WIDTH), 5, np.float32)

    def moving(speed: np.ndarray) -> GBuffer:
        vectors = np.zeros((HEIGHT, WIDTH, 2), np.float32)
        vectors[..., 0] = speed
        return GBuffer(WINDOW, depth, **{"to_next" if way > 0 else "to_previous": vectors})

    first = np.where(np.arange(WIDTH) < 80, 2, 4)
    start, last = np.full(WIDTH, 3), np.full(WIDTH, 2)
    found = trace_points(moving(start), [moving(first), moving(last)], way)
    expected = start + np.roll(first, -3) + last
    np.testing.assert_allclose(found[:, :-8, 0], np.tile(expected, (HEIGHT, 1))[:, :-8], atol=1e-5)


@pytest.mark.parametrize("way", [1, -1])
def test_what_comes_nearer_is_followed_if_its_vectors_lead_back(way):
    """An object slows down and comes nearer, by more than its depth alone is believed."""

    def instant(depth: float, ahead: float, back: float) -> GBuffer:
        one_way, other = (np.full((HEIGHT, WIDTH, 2), (x, 0), np.float32) for x in (ahead, back))
        motion = {"to_next": one_way, "to_previous": other}
        if way < 0:
            motion = {"to_next": other, "to_previous": one_way}
        near = np.full((HEIGHT, WIDTH), depth, np.float32)
        return GBuffer(WINDOW, near, stencil=np.ones((HEIGHT, WIDTH), np.int32), **motion)

    start, object_itself = instant(5, 4, -4), [instant(4, 3, -4), instant(3, 2, -3)]
    found = trace_points(start, object_itself, way)
    np.testing.assert_allclose(found[:, 16:-16, 0], 9, atol=1e-5)
    # Another part of it, which hides the point: that continues by its own vectors.
    found = trace_points(start, [instant(4, -3, 3), instant(3, -2, 3)], way)
    np.testing.assert_allclose(found[:, 16:-16, 0], 12, atol=1e-5)
