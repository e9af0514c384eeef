"""A small shot with known truth at any instant: a wall under the sky, a moving box, a camera.

Everything is ray cast in closed form, so colour, geometry and vectors are exact at every time.
World coordinates are x right, y down, z away from the camera at time 0; time counts key intervals.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

FLOOR, WALL, EAVES = 2.0, 12.0, -2.2
"""Height of the floor (y), distance of the wall (z), upper rim of the wall (y); above it is sky."""

BOX_SIZE, BOX_DEPTH = 1.3, 8.0
SKY, SURROUNDINGS, BOX = -1, 0, 1
RAYS = 4
"""Rays along each side of a pixel that its colour is averaged over."""

DIMMED = 0.5
"""Light of `Dimmed` later on, as a share of what it was."""


@dataclass(frozen=True)
class Street:
    """The scene seen by a camera.

    Attributes
    ----------
    width, height
        Pixels of the frame.
    speed
        Factor on all motion; 0 is a still.
    """

    width: int = 64
    height: int = 36
    speed: float = 1.0

    def colour(self, time: float) -> np.ndarray:
        """Scene-linear R, G, B, A, float64 [H, W, 4], averaged over each pixel."""
        return _colour(self, time).copy()

    def geometry(self, time: float) -> dict[str, np.ndarray]:
        """What a renderer's AOVs hold, at pixel centres, float64.

        `depth` is along the camera's axis, inf for sky; `previous` and `following` are
        displacements in pixels, x right, y down, 0 for sky as renderers write it.
        """
        return {name: plane.copy() for name, plane in _geometry(self, time).items()}

    def _average(self, time: float) -> np.ndarray:
        offsets = (np.arange(RAYS) + 0.5) / RAYS - 0.5
        x, y = self._pixels()
        rays = [self._shade(time, x + dx, y + dy) for dx in offsets for dy in offsets]
        return np.asarray(np.mean(rays, axis=0))

    def _planes(self, time: float) -> dict[str, np.ndarray]:
        x, y = self._pixels()
        what, points, depth = self._cast(time, x, y)
        here = np.stack([x, y], axis=-1)
        sky = (what == SKY)[..., None]
        normal = np.where(
            (what == SURROUNDINGS)[..., None] & self._on_floor(points), [0, -1, 0], [0, 0, -1]
        )
        return {
            "depth": depth,
            "position": np.where(sky, 0, points),
            "normal": np.where(sky, 0, normal).astype(float),
            "id": (what == BOX).astype(float),
            "previous": np.where(sky, 0, self._seen(time - 1, time, what, points) - here),
            "following": np.where(sky, 0, self._seen(time + 1, time, what, points) - here),
            "slot_previous": np.where(sky, 0, self._seen(time - 0.25, time, what, points) - here),
            "slot_following": np.where(sky, 0, self._seen(time + 0.25, time, what, points) - here),
        }

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return 0.9 * self.width

    def _pixels(self) -> tuple[np.ndarray, np.ndarray]:
        y, x = np.mgrid[0 : self.height, 0 : self.width].astype(float)
        return x, y

    def _camera(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return where the camera is, and its rotation from camera to world."""
        t = self.speed * time
        yaw = -0.03 * t - 0.001 * t * t
        c, s = np.cos(yaw), np.sin(yaw)
        return np.array([0.1 * t, 0.15 * t, 0.08 * t]), np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])

    def _box(self, time: float) -> np.ndarray:
        """Return the middle of the box."""
        t = self.speed * time
        return np.array([-1.6 + 0.25 * t + 0.01 * t * t, 0.4 - 0.06 * t, BOX_DEPTH])

    def _cast(self, time: float, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return what is hit, where (for sky the direction), and its depth."""
        centre, turn = self._camera(time)
        local = np.stack(
            [(x - (self.width - 1) / 2) / self.focal, (y - (self.height - 1) / 2) / self.focal,
             np.ones_like(x)], axis=-1,
        )  # fmt: skip
        rays = local @ turn.T
        what = np.full(x.shape, SKY)
        depth = np.full(x.shape, np.inf)

        def hit(kind: int, distance: np.ndarray, inside: np.ndarray) -> None:
            nearer = inside & (distance > 0) & (distance < depth)
            what[nearer], depth[nearer] = kind, distance[nearer]

        with np.errstate(divide="ignore", invalid="ignore"):
            floor = (FLOOR - centre[1]) / rays[..., 1]
            wall = (WALL - centre[2]) / rays[..., 2]
            box = (BOX_DEPTH - centre[2]) / rays[..., 2]
            at = centre + box[..., None] * rays
        off = np.abs(at - self._box(time))[..., :2].max(axis=-1)
        hit(SURROUNDINGS, floor, np.ones(x.shape, bool))
        hit(SURROUNDINGS, wall, centre[1] + wall * rays[..., 1] > EAVES)
        hit(BOX, box, off < BOX_SIZE)
        points = np.where(
            np.isinf(depth)[..., None],
            rays,
            centre + np.where(np.isinf(depth), 0, depth)[..., None] * rays,
        )
        return what, points, depth

    def _shade(self, time: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        what, points, _ = self._cast(time, x, y)
        local = points - np.where((what == BOX)[..., None], self._box(time), 0)
        u, v, w = local[..., 0], local[..., 1], local[..., 2]
        wave = np.sin(2.1 * u + 0.4) * np.cos(1.7 * v) + 0.6 * np.sin(1.3 * w + 0.8 * u)
        tint = {
            SKY: (0.35, 0.5, 0.9),
            SURROUNDINGS: (0.4, 0.35, 0.3),
            BOX: (0.75, 0.2, 0.15),
        }
        colour = np.zeros((*x.shape, 4))
        colour[..., 3] = 1.0
        for kind, base in tint.items():
            shade = 0.3 * wave + 1.0 if kind != SKY else 1.0 + 0.3 * np.sin(6 * u)
            colour[what == kind, :3] = (np.array(base) * shade[..., None])[what == kind]
        return colour

    def _on_floor(self, points: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(points[..., 1:2] - FLOOR) < 1e-9)

    def _seen(self, other: float, time: float, what: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return where points seen at a time are seen at another, pixels."""
        moved = points + np.where((what == BOX)[..., None], self._box(other) - self._box(time), 0)
        centre, turn = self._camera(other)
        local = (moved - centre) @ turn
        with np.errstate(divide="ignore", invalid="ignore"):
            image = local[..., :2] / local[..., 2:] * self.focal
        return np.asarray(image + np.array([self.width - 1, self.height - 1]) / 2)


@dataclass(frozen=True)
class Dimmed(Street):
    """The street, in which the light goes down to `DIMMED` after a time."""

    last_bright: float = 1.0

    def colour(self, time: float) -> np.ndarray:
        light = 1.0 if time <= self.last_bright else DIMMED
        return super().colour(time) * [light, light, light, 1]


@lru_cache(maxsize=128)
def _colour(street: Street, time: float) -> np.ndarray:
    """Render once what many tests write: 10 ms a frame."""
    return street._average(time)


@lru_cache(maxsize=128)
def _geometry(street: Street, time: float) -> dict[str, np.ndarray]:
    return street._planes(time)
