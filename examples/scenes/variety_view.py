"""The camera of a shot: a place with much to see, and a motion of a given speed in the picture."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace

import numpy as np
from stage import motion
from stage.blender import bpy, mathutils
from variety_set import Set

Matrix, Vector = mathutils.Matrix, mathutils.Vector
SPAN = 0.1
"""Seconds that a shot lasts."""
KEY = 1 / 30
WIDTH = 427
FAR = 1000.0
GRID = [(x / 8 - 0.9375, y / 4.5 - 0.89) for y in range(9) for x in range(16)]
AROUND = [
    Vector((math.sqrt(1 - z * z) * math.cos(2.4 * n), math.sqrt(1 - z * z) * math.sin(2.4 * n), z))
    for n, z in ((n, 1 - (2 * n + 1) / 60) for n in range(60))
]


@dataclass(frozen=True)
class Path:
    """A camera's motion.

    Attributes
    ----------
    eye : Vector
        Position at the middle of the shot.
    frame : Matrix
        Rotation at the middle of the shot; the camera looks along -z.
    angle : float
        Horizontal field of view, degrees.
    move : Vector
        Metres along the camera's own axes over the shot.
    turn : Vector
        Radians about the camera's own axes over the shot.
    gain : float
        Change of speed: 0 for none, 1 for from rest to twice the mean speed.
    wobble : float
        Share of a hand's trembling in it all.
    phase : float
        Of the trembling.
    """

    eye: mathutils.Vector
    frame: mathutils.Matrix
    angle: float
    move: mathutils.Vector
    turn: mathutils.Vector
    gain: float
    wobble: float
    phase: float

    def pose(self, seconds: float) -> tuple[mathutils.Vector, mathutils.Euler]:
        """Return position and rotation at a time."""
        place, frame = self.matrix(seconds)
        return place, frame.to_euler("XYZ")

    def matrix(self, seconds: float) -> tuple[mathutils.Vector, mathutils.Matrix]:
        """Return position and rotation matrix at a time."""
        share = seconds / SPAN - 0.5
        share += self.gain * (share * share - 0.25)
        shaken = self.wobble * motion.shake(seconds, self.phase, 4.0)
        turn = self.turn * share + 0.4 * shaken * (self.turn.length + 1e-3)
        move = self.move * share + 0.2 * shaken * self.move.length
        turned = mathutils.Euler(turn, "XYZ").to_matrix()
        return self.eye + self.frame @ move, self.frame @ turned

    def focal(self) -> float:
        """Return the focal length in pixels of a picture 427 wide."""
        return WIDTH / 2 / math.tan(math.radians(self.angle) / 2)

    def ray(self, x: float, y: float, seconds: float) -> tuple[mathutils.Vector, mathutils.Vector]:
        """Return origin and direction through a place in the picture, -1..1 both ways."""
        place, frame = self.matrix(seconds)
        wide = math.tan(math.radians(self.angle) / 2)
        return place, (frame @ Vector((x * wide, y * wide * 9 / 16, -1))).normalized()


def cast(origin: mathutils.Vector, along: mathutils.Vector) -> tuple[float, object, int]:
    """Return how far the first thing is, the thing, and the face's number."""
    scene = bpy.context.scene
    hit, where, _, face, thing, _ = scene.ray_cast(
        bpy.context.evaluated_depsgraph_get(), origin, along, distance=FAR
    )
    return ((where - origin).length, thing, face) if hit else (FAR, None, -1)


@dataclass(frozen=True)
class Footing:
    """A place on a still surface that the camera sees.

    Attributes
    ----------
    at, normal : Vector
        The place, and which way the surface faces there.
    away : float
        Metres from the camera.
    """

    at: mathutils.Vector
    normal: mathutils.Vector
    away: float


def footing(path: Path, chance: random.Random, level: float) -> Footing | None:
    """Draw a place in the picture; None where nothing still is, or it is steeper than `level`.

    `level` is the least upward part of the surface's normal: 1 for level ground, 0 for walls, too.
    """
    scene = bpy.context.scene
    origin, along = path.ray(chance.uniform(-0.9, 0.9), chance.uniform(-0.95, 0.4), SPAN / 2)
    hit, where, normal, _, thing, _ = scene.ray_cast(
        bpy.context.evaluated_depsgraph_get(), origin, along, distance=FAR
    )
    if not hit or thing.pass_index or (where - origin).length > 60:
        return None
    if normal.dot(along) > 0:
        normal = -normal
    return Footing(where, normal, (where - origin).length) if normal.z > level else None


def choose(scene: Set, speed: float, last: int) -> Path:
    """Choose a view and film it at a median speed in pixels per key interval; 0 for still."""
    bpy.context.view_layer.update()
    angle = scene.within(35, 85)
    views = [_view(scene, eye, aim, angle) for eye, aim in scene.eyes]
    ranked = sorted(views, key=_worth, reverse=True)
    best = None
    for attempt in range(16):
        start = ranked[min(attempt // 4, len(ranked) - 1)]
        path = _calibrated(_moving(scene, start, attempt), speed)
        room = _clearance(path)
        if best is None or room > best[0]:
            best = (room, path)
        if room > 0.08 * scene.reach:
            break
    path = best[1]
    motion.film(path.pose, last, path.angle)
    return path


def _view(scene: Set, eye: object, aim: object, angle: float) -> Path:
    roll = scene.chance.choice((0.0, 0.0, 0.0, scene.chance.gauss(0, 0.15)))
    frame = motion.looking(aim, eye, roll).to_matrix()
    still = Vector((0, 0, 0))
    return Path(Vector(eye), frame, angle, still, still, 0.0, 0.0, 0.0)


def _worth(path: Path) -> float:
    """Judge a view: many materials, all depths, little sky, and nothing too near."""
    rays = [cast(*path.ray(x, y, SPAN / 2)) for x, y in GRID]
    away = np.array([ray[0] for ray in rays])
    kinds = [_kind(thing, face) for _, thing, face in rays]
    seen = away < FAR
    if not seen.any():
        return -99.0
    depth = np.log(away[seen] + 0.05)
    largest = max(kinds.count(kind) for kind in set(kinds)) / len(kinds)
    near = float(np.quantile(away, 0.02))
    worth = len(set(kinds)) / 6 + 2 * float(depth.std()) - 4 * max(0.0, largest - 0.3)
    worth -= 6 * max(0.0, float((~seen).mean()) - 0.35) + 3 * max(0.0, 0.25 - float(depth.std()))
    crowd = float((away < 0.25 * np.median(away)).mean())
    return worth - 3 * max(0.0, crowd - 0.2) - (8 if near < 0.12 else 0)


def _kind(thing: object, face: int) -> tuple[str, int]:
    if thing is None:
        return ("sky", 0)
    return (thing.name, thing.data.polygons[face].material_index)


def _moving(scene: Set, start: Path, attempt: int) -> Path:
    """Draw a motion of about one metre or a tenth of a radian."""
    chance, reach = scene.chance, scene.reach
    kinds = ("dolly", "truck", "crane", "pan", "tilt", "roll", "orbit", "free", "free", "hand")
    kind = chance.choice(kinds if attempt % 4 < 2 else ("pan", "tilt", "roll", "pan"))
    sign = chance.choice((-1, 1))
    moves = {
        "dolly": ((0.1, 0.05, -1), (0.01, 0.02, 0.01)),
        "truck": ((1, 0.1, 0.1), (0.0, 0.02, 0.0)),
        "crane": ((0.2, 1, -0.3), (-0.05, 0.0, 0.0)),
        "pan": ((0.1, 0.0, -0.1), (0.1, 1, 0.05)),
        "tilt": ((0, 0.1, 0.1), (1, 0.2, 0.0)),
        "roll": ((0.05, 0.0, -0.3), (0.1, 0.2, 1)),
        "orbit": ((1, 0.0, 0.0), (0.0, 1 / reach, 0.0)),
        "hand": ((0.1, 0.1, -0.1), (0.2, 0.2, 0.1)),
    }
    if kind == "free":
        move = Vector([chance.gauss(0, 0.6) for _ in range(3)])
        turn = Vector([chance.gauss(0, 0.3) for _ in range(3)]) / reach
    else:
        move, turn = (sign * Vector(part) for part in moves[kind])
    wobble = chance.choice((0.0, 0.0, 0.15, 0.4)) if kind != "hand" else 1.5
    return replace(
        start,
        move=move * reach * 0.2,
        turn=turn * 0.2,
        gain=chance.uniform(-0.9, 0.9),
        wobble=wobble,
        phase=chance.uniform(0, 50),
    )


def _speed(path: Path, away: np.ndarray) -> float:
    """Return the median motion in the picture over a key interval, for the depths of the grid."""
    found = []
    for first in (0.0, KEY, 2 * KEY):
        places = [path.ray(x, y, first) for x, y in GRID]
        place, frame = path.matrix(first + KEY)
        back = frame.transposed()
        for (origin, along), distance, (x, y) in zip(places, away, GRID, strict=True):
            local = back @ (origin + along * distance - place)
            wide = math.tan(math.radians(path.angle) / 2) * max(1e-3, -local.z)
            found.append(math.hypot(local.x / wide - x, local.y / wide - y * 9 / 16) * WIDTH / 2)
    return float(np.median(found))


def _calibrated(path: Path, speed: float) -> Path:
    """Scale a motion so that the picture moves at a speed."""
    if speed == 0:
        return replace(path, move=path.move * 0, turn=path.turn * 0, wobble=0.0)
    away = np.array([cast(*path.ray(x, y, SPAN / 2))[0] for x, y in GRID])
    for _ in range(5):
        factor = min(20.0, max(0.05, speed / max(1e-4, _speed(path, away))))
        path = replace(path, move=path.move * factor, turn=path.turn * factor)
    return path


def _clearance(path: Path) -> float:
    """Return the least distance from the camera to anything, on its whole way."""
    least = FAR
    times = [-0.05, 0.0, KEY, 2 * KEY, SPAN, 0.15]
    places = [path.matrix(seconds)[0] for seconds in times]
    for seconds, place in zip(times, places, strict=True):
        rays = AROUND if seconds in (0.0, SPAN) else AROUND[::3]
        least = min([least, *(cast(place, along)[0] for along in rays)])
        if 0 <= seconds <= SPAN:
            seen = [cast(*path.ray(x, y, seconds))[0] for x, y in GRID[::2]]
            least = min(least, *seen)
    way = places[-1] - places[0]
    if way.length > 1e-3 and cast(places[0], way.normalized())[0] < way.length:
        return 0.0
    return least


def in_picture(path: Path, chance: random.Random) -> tuple[mathutils.Vector, float]:
    """Return a free place that the camera sees, and how far it is from the camera."""
    x, y = chance.uniform(-0.85, 0.85), chance.uniform(-0.8, 0.6)
    origin, along = path.ray(x, y, SPAN / 2)
    away = min(cast(origin, along)[0], 25.0)
    share = chance.uniform(0.35, 0.85)
    return origin + along * away * share, away * share
