"""Objects that move rigidly, against scenes whose motion is known exactly."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, Image, KeyFrame, Window, place_on_canvas
from exwarp_cli.research.training.augmentation import Look, deliver, reverse_time
from exwarp_cli.synthesis.holds import adapt_motion_to_holds
from exwarp_cli.synthesis.motion_fields import settle_motion
from exwarp_cli.synthesis.trajectory import (
    MIN_OBJECT_PIXELS,
    displacement,
    fit_pose,
)
from tests.matrix import combinations
from tests.unit.scenes import Camera, vec

HEIGHT, WIDTH, FOCAL = 80, 104, 130.0
CENTRE = vec((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
MIDDLE = vec(0.4, -0.2, 6.0)
"""Where the object is, in the world: x right, y down, z forward."""

Mask = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Face:
    """A flat part of an object: its middle, two axes, and which of their multiples it covers."""

    middle: np.ndarray
    u: np.ndarray
    v: np.ndarray
    mask: Mask = lambda s, t: (np.abs(s) <= 1) & (np.abs(t) <= 1)


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation about an axis by radians, [3, 3]."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


@dataclass(frozen=True)
class Motion:
    """A rigid motion at constant speed: degrees and scene units a frame."""

    axis: np.ndarray
    degrees: float
    shift: np.ndarray

    def place(self, points: np.ndarray, time: float) -> np.ndarray:
        turn = rotation(self.axis, math.radians(self.degrees) * time)
        return (points - MIDDLE) @ turn.T + MIDDLE + time * self.shift


def grid() -> np.ndarray:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([x, y], axis=-1).astype(np.float64)


CAMERA = Camera(vec(0, 0, 0), vec(0.12, -0.05, 0.1), vec(0, 0, 0), 0.01, -0.006, FOCAL)


@dataclass(frozen=True)
class View:
    """What a frame shows: which object, 0 for the ground, and where in the world."""

    pixels: np.ndarray
    ident: np.ndarray
    world: np.ndarray
    motions: tuple[Motion, ...]

    def motion_to(self, time: float) -> np.ndarray:
        """Exact displacements to another time, float32 [H, W, 2]."""
        moved = self.world.copy()
        for number, motion in enumerate(self.motions, start=1):
            mine = self.ident == number
            moved[mine] = motion.place(self.world[mine], time)
        seen = (moved - CAMERA.place(time)) @ CAMERA.rotation(time).T
        return (seen[..., :2] / seen[..., 2:] * FOCAL + CENTRE - self.pixels).astype(np.float32)


@dataclass(frozen=True)
class Scene:
    """Objects before ground that is folded, so that it determines a camera."""

    objects: tuple[tuple[list[Face], Motion], ...]

    def view(self, aside: tuple[float, float] = (0.0, 0.0)) -> View:
        """Trace one ray a pixel, through its centre or so many pixels aside."""
        pixels = grid() + aside
        rays = np.concatenate([(pixels - CENTRE) / FOCAL, np.ones((HEIGHT, WIDTH, 1))], axis=-1)
        depth = 11 / (1 - 0.5 * np.abs(rays[..., 0]) - 0.4 * rays[..., 1])
        ident = np.zeros((HEIGHT, WIDTH), np.int32)
        for number, (faces, _) in enumerate(self.objects, start=1):
            for face in faces:
                across, middle = np.cross(face.u, face.v), MIDDLE + face.middle
                with np.errstate(divide="ignore"):
                    z = (middle @ across) / (rays @ across)
                place = z[..., None] * rays - middle
                s, t = (place @ axis / (axis @ axis) for axis in (face.u, face.v))
                hit = (z > 0) & (z < depth) & face.mask(s, t)
                depth, ident = np.where(hit, z, depth), np.where(hit, np.int32(number), ident)
        motions = tuple(motion for _, motion in self.objects)
        return View(pixels, ident, depth[..., None] * rays, motions)

    def rendered(self) -> GBuffer:
        """Return the frame as a renderer writes it.

        Vectors are filtered as colour is, by Blackman and Harris's filter, 1.5 pixels wide.
        """
        seen = self.view()
        vectors, total = np.zeros((2, HEIGHT, WIDTH, 2)), 0.0
        for dx, dy in itertools.product(np.linspace(-0.6, 0.6, 5), repeat=2):
            weight, part = blackman_harris(dx) * blackman_harris(dy), self.view((dx, dy))
            total += weight
            for way, time in enumerate((-1, 1)):
                vectors[way] += weight * part.motion_to(time)
        before, after = (vectors / total).astype(np.float32)
        return GBuffer(
            Window(0, 0, WIDTH, HEIGHT),
            depth=seen.world[..., 2].astype(np.float32),
            position=seen.world.astype(np.float32),
            stencil=seen.ident,
            to_previous=before,
            to_next=after,
        )


def blackman_harris(distance: float) -> float:
    angle = 2 * math.pi * (distance / 1.5 + 0.5)
    terms = (0.35875, -0.48829, 0.14128, -0.01168)
    return sum(a * math.cos(k * angle) for k, a in enumerate(terms))


def turned(faces: list[Face], axis: np.ndarray, degrees: float) -> list[Face]:
    """Turn an object about its middle."""
    turn = rotation(axis, math.radians(degrees)).T
    return [Face(f.middle @ turn, f.u @ turn, f.v @ turn, f.mask) for f in faces]


def block() -> list[Face]:
    x, y, z = np.diag([0.9, 0.5, 0.7])
    sides = [Face(s * c, u, v) for c, u, v in ((x, y, z), (y, z, x), (z, x, y)) for s in (-1, 1)]
    return turned(sides, vec(1, 1, 0.3), 40)


def plate(x: float = 0.0, width: float = 1.0, height: float = 0.7, z: float = 0.0) -> list[Face]:
    return [Face(vec(x, 0, z), vec(width, 0, 0), vec(0, height, 0))]


def spokes(pixels: float = 2.0, count: int = 6) -> list[Face]:
    """Return a wheel's spokes, so many pixels wide."""
    half = pixels * MIDDLE[2] / FOCAL / 2

    def mask(s: np.ndarray, t: np.ndarray) -> np.ndarray:
        angles = np.pi * np.arange(count)[:, None, None] / count + 0.2
        beside = np.abs(s * np.sin(angles) - t * np.cos(angles)).min(axis=0)
        return (beside <= half) & (np.hypot(s, t) <= 1.6)

    return [Face(vec(0, 0, 0), vec(1, 0, 0), vec(0, 1, 0), mask)]


KINDS = {"block": block, "plate": plate, "spokes": spokes}
AXES = {"towards the camera": vec(0, 0, 1), "upright": vec(0, 1, 0), "aslant": vec(0.3, 0.5, 1)}
DEGREES = (5, 25, 60)
SHIFT = vec(0.3, 0.1, -0.2)

each_kind = pytest.mark.parametrize("kind", KINDS)
each_axis = pytest.mark.parametrize("axis", AXES)
each_turn = pytest.mark.parametrize("degrees", DEGREES)
each_axis_and_turn = pytest.mark.parametrize(("axis", "degrees"), combinations(list(AXES), DEGREES))


@functools.cache
def shot(kind: str, axis: str, degrees: int) -> tuple[View, GBuffer, GBuffer]:
    """Return what a frame with one object shows, as rendered, and as settled."""
    scene = Scene(((KINDS[kind](), Motion(AXES[axis], degrees, SHIFT)),))
    raw = scene.rendered()
    return scene.view(), raw, settle_motion(raw)


def spinning() -> tuple[View, GBuffer, GBuffer]:
    return shot("spokes", "aslant", 25)


def error(seen: View, found: np.ndarray, time: float) -> np.ndarray:
    """Return how far displacements of the objects' pixels are off, [N]."""
    return np.linalg.norm(found - seen.motion_to(time), axis=-1)[seen.ident > 0]


def as_one(scene: Scene) -> GBuffer:
    """Render a scene with one id for all objects."""
    raw = scene.rendered()
    return replace(raw, stencil=np.minimum(raw.stencil, 1))


def assert_settled_as_without_positions(raw: GBuffer) -> None:
    found, expected = settle_motion(raw), settle_motion(raw.without("position"))
    mine = raw.stencil > 0
    np.testing.assert_array_equal(found.to_previous[mine], expected.to_previous[mine])
    np.testing.assert_array_equal(found.to_next[mine], expected.to_next[mine])
    assert found.bend is None


class TestOutlines:
    """Vectors at and near outlines are rendered as mixtures."""

    @pytest.mark.parametrize(
        ("kind_and_axis", "degrees"), combinations(list(product(KINDS, AXES)), (25, 60, 5))
    )
    def test_every_pixel_gets_its_exact_motion(self, kind_and_axis, degrees):
        kind, axis = kind_and_axis
        seen, raw, found = shot(kind, axis, degrees)
        assert (seen.ident > 0).sum() > 500
        for time in (-1, 1):
            name = "to_next" if time > 0 else "to_previous"
            assert error(seen, getattr(raw, name), time).max() > 0.5
            assert error(seen, getattr(found, name), time).max() < 0.05

    def test_an_object_that_comes_nearer(self):
        scene = Scene(((block(), Motion(vec(0, 1, 0), 10, vec(0, 0, -1.2))),))
        found = settle_motion(scene.rendered())
        assert error(scene.view(), found.to_next, 1).max() < 0.05
        assert error(scene.view(), found.to_previous, -1).max() < 0.05

    def test_an_object_before_another_one(self):
        near, far = Motion(vec(0, 0, 1), 40, SHIFT), Motion(vec(0, 0, 1), -20, -SHIFT)
        scene = Scene(((spokes(), near), (plate(z=0.5), far)))
        found, seen = settle_motion(scene.rendered()), scene.view()
        assert {*np.unique(seen.ident)} == {0, 1, 2}
        assert error(seen, found.to_next, 1).max() < 0.05

    @each_axis_and_turn
    def test_spokes_of_which_few_vectors_are_unmixed(self, axis, degrees):
        scene = Scene(((spokes(1.5), Motion(AXES[axis], degrees, SHIFT)),))
        seen, raw = scene.view(), scene.rendered()
        found = settle_motion(raw)
        for name, time in (("to_previous", -1), ("to_next", 1)):
            assert (error(seen, getattr(raw, name), time) > 0.05).mean() > 0.5
            assert error(seen, getattr(found, name), time).max() < 0.2

    @each_axis_and_turn
    def test_spokes_that_no_vector_shows_unmixed_are_no_worse_than_before(self, axis, degrees):
        """Half of their vectors are off by a pixel or more, so their motion is not always found."""
        scene = Scene(((spokes(1.0), Motion(AXES[axis], degrees, SHIFT)),))
        seen, raw = scene.view(), scene.rendered()
        found, before = settle_motion(raw), settle_motion(raw.without("position"))
        for name, time in (("to_previous", -1), ("to_next", 1)):
            assert np.median(error(seen, getattr(raw, name), time)) > 0.7
            off, off_before = (error(seen, getattr(g, name), time) for g in (found, before))
            assert off.mean() <= off_before.mean()


@dataclass(frozen=True)
class Bending(Motion):
    """A motion by which a flat object is bent more and more."""

    def place(self, points: np.ndarray, time: float) -> np.ndarray:
        arched = points + time * 0.3 * (points[:, :1] - MIDDLE[0]) ** 2 * vec(0, 1, 0)
        return super().place(arched, time)


@dataclass(frozen=True)
class Hinged(Motion):
    """A turn about the right edge of a plate."""

    def place(self, points: np.ndarray, time: float) -> np.ndarray:
        return super().place(points - vec(1, 0, 0), time) + vec(1, 0, 0)


class TestNotRigid:
    """What does not move as one is settled as without world positions."""

    @each_turn
    def test_limbs_with_one_id(self, degrees):
        left = plate(-0.9, 0.85, 0.3), Motion(vec(0, 0, 1), degrees, vec(0, 0, 0))
        right = plate(0.9, 0.85, 0.3), Motion(vec(0, 0, 1), -degrees, vec(0, 0, 0))
        assert_settled_as_without_positions(as_one(Scene((left, right))))

    def test_an_object_that_bends(self):
        scene = Scene(((plate(), Bending(vec(0, 0, 1), 20, SHIFT)),))
        assert_settled_as_without_positions(scene.rendered())

    def test_a_small_part_that_moves_by_itself_keeps_its_vectors(self):
        """Such as the mouth of a head, too small to make the head count as not rigid."""
        head = plate(), Motion(vec(0, 0, 1), 25, SHIFT)
        mouth = plate(0.1, 0.17, 0.11, z=-0.01), Motion(vec(0, 0, 1), 25, SHIFT + vec(0, 0.2, 0))
        scene = Scene((head, mouth))
        seen, raw = scene.view(), as_one(scene)
        found, before = settle_motion(raw), settle_motion(raw.without("position"))
        inside = np.zeros(seen.ident.shape, bool)
        inside[1:-1, 1:-1] = np.lib.stride_tricks.sliding_window_view(seen.ident == 2, (3, 3)).all(
            axis=(-2, -1)
        )
        assert inside.sum() > 8
        assert (seen.ident == 2).sum() < 0.05 * (seen.ident > 0).sum()
        for name, time in (("to_previous", -1), ("to_next", 1)):
            vectors = getattr(found, name)
            np.testing.assert_array_equal(vectors[inside], getattr(before, name)[inside])
            off = np.linalg.norm(vectors - seen.motion_to(time), axis=-1)
            assert off[inside].max() < 0.05
            assert off[seen.ident == 1].mean() < 0.02
        assert found.bend is not None
        assert (found.bend[:, inside] == 0).all()


class TestLessIsKnown:
    def test_without_ids_vectors_are_those_of_surfaces(self):
        seen, raw, _ = spinning()
        found = settle_motion(raw.without("stencil"))
        assert found.bend is None
        assert error(seen, found.to_next, 1).max() > 1

    def test_without_world_positions_too(self):
        seen, raw, _ = spinning()
        found = settle_motion(raw.without("position"))
        assert found.bend is None
        assert error(seen, found.to_next, 1).max() > 1

    @pytest.mark.parametrize("count", [MIN_OBJECT_PIXELS - 1, MIN_OBJECT_PIXELS])
    def test_an_object_of_few_pixels_is_left_as_it_is(self, count):
        seen, raw, _ = shot("plate", "aslant", 25)
        shown = np.flatnonzero(seen.ident)
        hidden = np.delete(shown, np.linspace(0, len(shown) - 1, count).astype(int))
        ids = seen.ident.copy()
        ids.ravel()[hidden] = 2
        found = settle_motion(replace(raw, stencil=ids))
        off = np.linalg.norm(found.to_next - seen.motion_to(1), axis=-1)[ids == 1]
        assert (off.max() < 0.05) == (count == MIN_OBJECT_PIXELS)

    @pytest.mark.parametrize("absent", ["to_previous", "to_next"])
    def test_vectors_one_way_alone(self, absent):
        """As in the first and the last key frame."""
        _, raw, both = spinning()
        found = settle_motion(raw.without(absent))
        assert getattr(found, absent) is None
        kept = "to_next" if absent == "to_previous" else "to_previous"
        np.testing.assert_array_equal(getattr(found, kept), getattr(both, kept))

    def test_unknown_vectors_are_filled_in(self):
        seen, raw, _ = spinning()
        unknown = np.random.default_rng(1).random(seen.ident.shape) < 0.4
        vectors = np.where(unknown[..., None], np.float32(np.nan), raw.to_next)
        found = settle_motion(replace(raw, to_next=vectors))
        assert np.isnan(vectors[seen.ident > 0]).any()
        assert error(seen, found.to_next, 1).max() < 0.05

    def test_an_object_without_any_known_vector_stays_unknown(self):
        seen, raw, _ = spinning()
        vectors = np.where(seen.ident[..., None] > 0, np.float32(np.nan), raw.to_next)
        found = settle_motion(replace(raw, to_next=vectors))
        assert np.isnan(found.to_next[seen.ident > 0]).all()
        assert error(seen, found.to_previous, -1).max() < 0.05


TIMES = (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75)


class TestArcs:
    @each_kind
    @each_axis
    def test_an_object_that_turns_by_sixty_degrees_goes_on_an_arc(self, kind, axis):
        seen, _, found = shot(kind, axis, 60)
        straight = found.without("bend")
        for time in TIMES:
            # At a quarter the path is that of a polynomial through the places at halves.
            limit = 0.03 if abs(time) == 0.5 else 0.12
            assert error(seen, displacement(found, time), time).max() < limit
        off = [error(seen, displacement(straight, time), time).max() for time in TIMES]
        assert max(off) > 0.5

    @pytest.mark.parametrize(
        ("kind", "axis", "way"), combinations(list(KINDS), list(AXES), [-1, 1])
    )
    def test_with_vectors_one_way_it_turns_about_the_middle_of_what_is_seen(self, kind, axis, way):
        """Which is not quite the block's own middle."""
        seen, raw, _ = shot(kind, axis, 60)
        found = settle_motion(raw.without("to_previous" if way > 0 else "to_next"))
        for time in (0.25 * way, 0.5 * way, 0.75 * way):
            off = error(seen, displacement(found, time), time).max()
            assert off < (1.3 if kind == "block" else 0.5)
        halfway = displacement(found.without("bend"), 0.5 * way)
        assert error(seen, halfway, 0.5 * way).max() > 2

    def test_a_door_turns_about_its_hinge(self):
        """Not about the middle of what is seen of it, which itself goes on an arc."""
        scene = Scene(((plate(), Hinged(vec(0, 1, 0), 30, vec(0, 0, 0))),))
        found = settle_motion(scene.rendered())
        for time in TIMES:
            assert error(scene.view(), displacement(found, time), time).max() < 0.03

    @each_kind
    def test_at_the_neighbouring_frames_it_is_where_its_vectors_say(self, kind):
        _, _, found = shot(kind, "aslant", 60)
        np.testing.assert_allclose(displacement(found, 1), found.to_next, atol=1e-5)
        np.testing.assert_allclose(displacement(found, -1), found.to_previous, atol=1e-5)
        assert (displacement(found, 0) == 0).all()

    def test_what_does_not_turn_goes_straight(self):
        scene = Scene(((block(), Motion(vec(0, 0, 1), 0, SHIFT)),))
        assert settle_motion(scene.rendered()).bend is None

    def test_only_what_turns_is_bent(self):
        scene = Scene(
            (
                (block(), Motion(vec(0, 0, 1), 40, SHIFT)),
                (plate(1.5, 0.4), Motion(vec(0, 0, 1), 0, -SHIFT)),
            )
        )
        found, seen = settle_motion(scene.rendered()), scene.view()
        assert found.bend is not None and (seen.ident == 2).sum() > 100
        assert (found.bend[:, seen.ident != 1] == 0).all()
        assert np.abs(found.bend[:, seen.ident == 1]).max() > 0.4


class TestBend:
    """The bend stays with the vectors that it belongs to."""

    @pytest.mark.parametrize(
        "canvas", [Window(20, 10, 60, 50), Window(-5, -7, WIDTH + 9, HEIGHT + 12)]
    )
    def test_on_another_window(self, canvas):
        _, _, found = spinning()
        moved = displacement(found.on(canvas), 0.5)
        expected = place_on_canvas(displacement(found, 0.5), found.window, canvas, np.nan)
        np.testing.assert_array_equal(moved, expected)

    def test_of_motion_and_depth_alone(self):
        _, _, found = spinning()
        np.testing.assert_array_equal(displacement(found.bare(), 0.5), displacement(found, 0.5))

    @pytest.mark.parametrize("time", TIMES)
    def test_backwards(self, time):
        _, _, found = spinning()
        np.testing.assert_allclose(
            displacement(reverse_time(found), time), displacement(found, -time), atol=1e-5
        )

    @pytest.mark.parametrize("time", TIMES)
    def test_at_half_the_size(self, time):
        _, _, found = spinning()
        image = Image(np.zeros((HEIGHT, WIDTH, 3), np.float32), found.window, found.window)
        frame = deliver(KeyFrame(1, image, found), Look(aliased=True), np.random.default_rng(1))
        expected = displacement(found, time)[::2, ::2] / 2
        np.testing.assert_allclose(displacement(frame.gbuffer, time), expected, atol=1e-5)

    def test_where_a_neighbour_is_held_motion_is_a_straight_line(self):
        _, _, found = spinning()
        image = Image(np.zeros((HEIGHT, WIDTH, 3), np.float32), found.window, found.window)
        held = replace(found, to_previous=np.zeros_like(found.to_previous))
        key, _ = adapt_motion_to_holds(KeyFrame(1, image, held), None, after_hold=True)
        np.testing.assert_array_equal(displacement(key.gbuffer, 0.5), found.to_next / 2)
        ending = replace(found, to_next=np.zeros_like(found.to_next))
        _, following = adapt_motion_to_holds(KeyFrame(1, image, held), KeyFrame(2, image, ending))
        np.testing.assert_array_equal(displacement(following.gbuffer, -0.5), found.to_previous / 2)

    def test_vectors_that_are_turned_round_have_none(self):
        _, _, found = spinning()
        image = Image(np.zeros((HEIGHT, WIDTH, 3), np.float32), found.window, found.window)
        standing = replace(found, to_previous=np.zeros_like(found.to_previous), to_next=None)
        key, _ = adapt_motion_to_holds(
            KeyFrame(1, image, standing), KeyFrame(2, image, found.without("to_next"))
        )
        assert key.gbuffer.to_next is not None and key.gbuffer.bend is None


class TestFitPose:
    CAMERA = np.array([[FOCAL, 0, CENTRE[0], 0], [0, FOCAL, CENTRE[1], 0], [0, 0, 1, 0.0]])

    def seen(self, points: np.ndarray) -> np.ndarray:
        image = points @ self.CAMERA[:, :3].T
        return image[:, :2] / image[:, 2:]

    @pytest.mark.parametrize("degrees", [0, 10, 60])
    def test_noise_and_a_third_of_outliers(self, degrees):
        rng = np.random.default_rng(degrees)
        points = MIDDLE + rng.uniform(-1, 1, (900, 3))
        places = Motion(vec(0.3, 0.5, 1), degrees, SHIFT).place(points, 1)
        ends = self.seen(places) + rng.normal(0, 0.1, (900, 2))
        ends[::3] += rng.uniform(-30, 30, (300, 2))
        pose = fit_pose(points, ends, self.CAMERA)
        assert pose is not None
        assert np.linalg.norm(self.seen(pose.place(points)) - self.seen(places), axis=1).max() < 0.1
        assert np.linalg.norm(pose.turn) == pytest.approx(math.radians(degrees), abs=0.01)

    def test_ends_that_are_not_finite_do_not_count(self):
        rng = np.random.default_rng(2)
        points = MIDDLE + rng.uniform(-1, 1, (100, 3))
        places = Motion(vec(0, 1, 0), 20, SHIFT).place(points, 1)
        ends = self.seen(places)
        ends[::2] = np.nan
        pose = fit_pose(points, ends, self.CAMERA)
        assert pose is not None
        np.testing.assert_allclose(pose.place(points), places, atol=1e-3)

    def test_too_few_points_tell_nothing(self):
        points = MIDDLE + np.random.default_rng(3).uniform(-1, 1, (MIN_OBJECT_PIXELS, 3))
        ends = self.seen(points)
        assert fit_pose(points, ends, self.CAMERA) is not None
        assert fit_pose(points[1:], ends[1:], self.CAMERA) is None
        ends[0] = np.nan
        assert fit_pose(points, ends, self.CAMERA) is None

    def test_points_behind_the_camera_tell_nothing(self):
        points = MIDDLE + np.random.default_rng(4).uniform(-1, 1, (50, 3))
        behind = points - vec(0, 0, 6)
        assert fit_pose(behind, self.seen(points), self.CAMERA) is None
