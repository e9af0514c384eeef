"""A small ray-traced scene whose geometry, colour and motion are known exactly at every time.

Textured rectangles before sky: a floor, two walls and a moving box, seen by a pinhole camera that
moves and turns. Axes are x right, y down, z forward; the unit of time is a key interval.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from exwarp_cli.domain.frame import GBuffer, Image, KeyFrame, Window

SKY = -1


def vec(*values: float) -> np.ndarray:
    return np.array(values, dtype=np.float64)


@dataclass(frozen=True)
class Rectangle:
    """Points origin + s u + t v, 0 <= s, t <= 1, that move with a constant velocity."""

    origin: np.ndarray
    u: np.ndarray
    v: np.ndarray
    ident: int = 0
    velocity: np.ndarray = field(default_factory=lambda: vec(0, 0, 0))
    colour: tuple[float, float, float] = (0.5, 0.5, 0.5)
    waves: tuple[float, float] = (9.0, 7.0)

    def corner(self, time: float) -> np.ndarray:
        return self.origin + time * self.velocity


@dataclass(frozen=True)
class Camera:
    """A pinhole whose place and angles are polynomials of time."""

    start: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    yaw: float
    pitch: float
    focal: float

    def place(self, time: float) -> np.ndarray:
        return self.start + time * self.velocity + 0.5 * time**2 * self.acceleration

    def rotation(self, time: float) -> np.ndarray:
        """World to camera, [3, 3]."""
        a, b = self.yaw * time, self.pitch * time
        yaw = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
        pitch = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
        return pitch @ yaw


@dataclass(frozen=True)
class View:
    """What one frame shows: a surface number (or SKY) and a place on it for every pixel."""

    scene: Scene
    time: float
    surface: np.ndarray
    place: np.ndarray
    directions: np.ndarray
    depth: np.ndarray

    def world(self, time: float) -> np.ndarray:
        """World positions [H, W, 3], at a time, of the points seen; directions for the sky."""
        out = self.directions.copy()
        for index, quad in enumerate(self.scene.quads):
            mine = self.surface == index
            s, t = self.place[mine].T
            out[mine] = quad.corner(time) + s[:, None] * quad.u + t[:, None] * quad.v
        return out

    def pixels_at(self, time: float) -> np.ndarray:
        """Where the points seen are at another time, [H, W, 2] as (x, y)."""
        camera = self.scene.camera
        away = self.world(time) - np.where((self.surface == SKY)[..., None], 0, camera.place(time))
        seen = away @ camera.rotation(time).T
        return seen[..., :2] / seen[..., 2:] * camera.focal + self.scene.centre

    def motion_to(self, time: float, sky: bool = True) -> np.ndarray:
        """Exact displacement to another time, float32 [H, W, 2]; 0 for the sky unless wanted."""
        out = (self.pixels_at(time) - self.scene.grid).astype(np.float32)
        if not sky:
            out[self.surface == SKY] = 0
        return out

    @property
    def colour(self) -> np.ndarray:
        """float32 [H, W, 4]: fixed to the surfaces, some above 1, some below 0; sky half clear."""
        out = np.empty((*self.surface.shape, 4))
        d = self.directions / np.linalg.norm(self.directions, axis=-1, keepdims=True)
        sky = 0.4 + 0.2 * np.sin(6 * d[..., :1] + 9 * d[..., 1:2])
        out[..., :3], out[..., 3] = 0.5 * sky, 0.5
        for index, quad in enumerate(self.scene.quads):
            mine = self.surface == index
            phase = self.place[mine] * quad.waves
            shade = 1 + 0.5 * np.sin(phase[:, :1] + np.arange(3)) + 0.45 * np.cos(phase[:, 1:])
            out[mine, :3], out[mine, 3] = shade * quad.colour, 1
        return out.astype(np.float32)

    def gbuffer(self, motion: bool = True, sky: bool = False, step: float = 1.0) -> GBuffer:
        """Geometry as a renderer writes it, after cleaning; motion to one step either side."""
        background = self.surface == SKY
        normal = np.zeros((*background.shape, 3), np.float32)
        for index, quad in enumerate(self.scene.quads):
            across = np.cross(quad.u, quad.v)
            normal[self.surface == index] = across / np.linalg.norm(across)
        ids = np.array([quad.ident for quad in self.scene.quads] + [0], np.int32)
        position = np.where(background[..., None], 0, self.world(self.time))
        return GBuffer(
            self.scene.window,
            self.depth.astype(np.float32),
            normal,
            position.astype(np.float32),
            ids[self.surface],
            self.motion_to(self.time - step, sky) if motion else None,
            self.motion_to(self.time + step, sky) if motion else None,
        )

    def inside(self, reach: int) -> np.ndarray:
        """bool [H, W]: no other surface, and no end of the frame, within so many pixels."""
        out = np.ones(self.surface.shape, bool)
        padded = np.pad(self.surface, reach, constant_values=-2)
        height, width = self.surface.shape
        for dy in range(2 * reach + 1):
            for dx in range(2 * reach + 1):
                out &= padded[dy : dy + height, dx : dx + width] == self.surface
        return out

    def source_surface(self, other: View) -> np.ndarray:
        """int [H, W]: what the other view shows where this one's points are there; -2 outside."""
        x, y = np.rint(self.pixels_at(other.time)).astype(int).transpose(2, 0, 1)
        height, width = self.surface.shape
        outside = (x < 0) | (y < 0) | (x >= width) | (y >= height)
        found = other.surface[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
        return np.where(outside, -2, found)

    def key(self, number: int) -> KeyFrame:
        """The frame as synthesis gets it."""
        image = Image(self.colour, self.scene.window, self.scene.window)
        return KeyFrame(number, image, self.gbuffer())


@dataclass(frozen=True)
class Scene:
    """Surfaces, camera and frame size."""

    quads: tuple[Rectangle, ...]
    camera: Camera
    size: tuple[int, int] = (128, 80)

    @property
    def window(self) -> Window:
        return Window(0, 0, *self.size)

    @property
    def centre(self) -> np.ndarray:
        return (np.array(self.size) - 1) / 2

    @property
    def grid(self) -> np.ndarray:
        y, x = np.mgrid[0 : self.size[1], 0 : self.size[0]]
        return np.stack([x, y], axis=-1).astype(np.float64)

    def view(self, time: float) -> View:
        """Trace one ray through every pixel's centre."""
        eye, rotation = self.camera.place(time), self.camera.rotation(time)
        local = np.concatenate(
            [(self.grid - self.centre) / self.camera.focal, np.ones((*self.window.shape, 1))], -1
        )
        rays = local @ rotation  # from camera to world: the transpose of its inverse
        surface = np.full(self.window.shape, SKY)
        depth = np.full(self.window.shape, np.inf)
        place = np.zeros((*self.window.shape, 2))
        for index, quad in enumerate(self.quads):
            # eye + z ray = corner + s u + t v; z is the depth, as the rays have unit depth.
            basis = np.stack([rays, *np.broadcast_arrays(rays * 0 - quad.u, -quad.v)], axis=-1)
            solved = np.linalg.solve(
                basis, np.broadcast_to((quad.corner(time) - eye), rays.shape)[..., None]
            )
            z, s, t = solved[..., 0, 0], solved[..., 1, 0], solved[..., 2, 0]
            hit = (z > 0.1) & (z < depth) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
            surface[hit], depth[hit] = index, z[hit]
            place[hit] = np.stack([s, t], axis=-1)[hit]
        return View(self, time, surface, place, rays, depth)

    def still(self) -> Scene:
        """The scene with nothing moving, the camera included."""
        quads = tuple(replace(quad, velocity=vec(0, 0, 0)) for quad in self.quads)
        zero = vec(0, 0, 0)
        camera = replace(self.camera, velocity=zero, acceleration=zero, yaw=0.0, pitch=0.0)
        return replace(self, quads=quads, camera=camera)


def town(size: tuple[int, int] = (128, 80)) -> Scene:
    """The scene that most tests use: a few pixels of motion an interval."""
    box = {"ident": 3, "velocity": vec(0.35, -0.05, 0.1), "colour": (1.8, 0.4, 0.2)}
    quads = (
        Rectangle(vec(-9, 1.6, 2), vec(18, 0, 0), vec(0, 0, 12), waves=(60.0, 40.0)),
        Rectangle(vec(-6, -2.2, 11), vec(7, 0, 0), vec(0, 3.8, 0), colour=(0.2, 0.6, 0.9)),
        Rectangle(vec(2.2, -1.2, 8), vec(2.5, 0, 1.5), vec(0, 2.8, 0), colour=(-0.1, 0.7, 0.3)),
        Rectangle(vec(-2.1, -0.3, 5), vec(1.4, 0, 0), vec(0, 1.3, 0), waves=(8.0, 6.0), **box),
        Rectangle(vec(-0.7, -0.3, 5), vec(0, 0, 1.2), vec(0, 1.3, 0), waves=(5.0, 6.0), **box),
    )
    camera = Camera(
        vec(0, 0, 0), vec(0.15, -0.03, 0.12), vec(0.03, 0.0, 0.02), 0.012, -0.006, 0.9 * size[0]
    )
    return Scene(quads, camera, size)
