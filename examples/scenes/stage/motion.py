"""Motion, keyed at every instant of 1/120 s from smooth formulas of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from stage.blender import bpy, mathutils

FPS = 120
MARGIN = 8
"""Instants that are keyed before the first and after the last one, so that vectors over 1/30 s
have neighbours everywhere."""

LINEAR = 1
Vector, Euler = mathutils.Vector, mathutils.Euler
Pose = Callable[[float], tuple[Sequence[float], Sequence[float]]]


def keyed(thing: bpy.types.Object, pose: Pose, last: int) -> None:
    """Key an object's location and rotation at every instant.

    Parameters
    ----------
    thing : bpy.types.Object
        What moves; its pose is relative to its parent if it has one.
    pose : callable
        Takes seconds (0 is the first instant) and returns location (metres) and XYZ Euler angles
        (radians). It must be smooth, and is asked for a little more than the shot.
    last : int
        The last instant.
    """
    instants = np.arange(-MARGIN, last + MARGIN + 1)
    rows = []
    before = None
    for instant in instants:
        where, turn = pose(float(instant) / FPS)
        angles = Euler(turn, "XYZ")
        if before is not None:
            angles.make_compatible(before)
        before = angles
        rows.append((*where, *angles))
    thing.rotation_mode = "XYZ"
    values = np.array(rows, np.float32)
    for first, path in ((0, "location"), (3, "rotation_euler")):
        for axis in range(3):
            _curve(thing, path, axis, instants, values[:, first + axis])


def keyed_value(
    owner: bpy.types.ID, path: str, value: Callable[[float], float], last: int, index: int = 0
) -> None:
    """Key one number, such as a light's energy, at every instant; `value` takes seconds."""
    instants = np.arange(-MARGIN, last + MARGIN + 1)
    values = np.array([value(float(instant) / FPS) for instant in instants], np.float32)
    _curve(owner, path, index, instants, values)


def _curve(
    owner: bpy.types.ID, path: str, index: int, instants: np.ndarray, values: np.ndarray
) -> None:
    motion = owner.animation_data or owner.animation_data_create()
    if motion.action is None:
        motion.action = bpy.data.actions.new(owner.name)
    curve = motion.action.fcurve_ensure_for_datablock(owner, path, index=index)
    points = curve.keyframe_points
    points.add(len(instants))
    points.foreach_set("co", np.stack([instants, values], axis=1).astype(np.float32).ravel())
    points.foreach_set("interpolation", [LINEAR] * len(instants))
    curve.update()


def looking(at: Sequence[float], start: Sequence[float], roll: float = 0.0) -> Euler:
    """Return the rotation of a camera at `start` that looks at a point, rolled by radians."""
    along = Vector(at) - Vector(start)
    turn = along.to_track_quat("-Z", "Y")
    return (turn @ mathutils.Quaternion((0, 0, 1), roll)).to_euler("XYZ")


def ramp(seconds: float, start: float, end: float) -> float:
    """Rise smoothly from 0 before `start` to 1 after `end`, with a continuous acceleration."""
    share = min(1.0, max(0.0, (seconds - start) / (end - start)))
    return share**3 * (share * (6 * share - 15) + 10)


def along(points: Sequence[Sequence[float]], share: float) -> Vector:
    """Return the point at a share 0..1 of a smooth curve through points (Catmull-Rom)."""
    count = len(points) - 1
    place = min(max(share, 0.0), 1.0) * count
    first = min(int(place), count - 1)
    t = place - first
    a, b, c, d = (Vector(points[min(max(first + step, 0), count)]) for step in (-1, 0, 1, 2))
    return 0.5 * (
        2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3
    )


def shake(seconds: float, seed: float, rate: float = 1.0) -> Vector:
    """Return a smooth wobble within about -1..1 in each axis, as of a camera held by hand."""
    turn = 2 * math.pi * rate * seconds
    return Vector(
        [
            0.6 * math.sin(1.07 * turn + 2.1 * seed + axis * 1.9)
            + 0.4 * math.sin(1.93 * turn + 3.7 * seed + axis * 0.8)
            for axis in range(3)
        ]
    )


def film(pose: Pose, last: int, angle: float = 60.0) -> bpy.types.Object:
    """Add the camera and key it.

    Parameters
    ----------
    pose : callable
        As of `keyed`; see `looking` for its rotation.
    last : int
        The last instant.
    angle : float
        Horizontal field of view, degrees.
    """
    lens = bpy.data.cameras.new("camera")
    lens.angle = math.radians(angle)
    lens.clip_start, lens.clip_end = 0.03, 2000.0
    camera = bpy.data.objects.new("camera", lens)
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    keyed(camera, pose, last)
    return camera


def sunlight(
    towards: Sequence[float], strength: float, colour: Sequence[float], degrees: float = 0.6
) -> bpy.types.Object:
    """Add a sun that shines in a direction, with an apparent size that softens its shadows."""
    light = bpy.data.lights.new("sun", "SUN")
    light.energy, light.angle, light.color = strength, math.radians(degrees), colour
    sun = bpy.data.objects.new("sun", light)
    sun.rotation_euler = Vector(towards).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(sun)
    return sun
