"""Models of id's MD3 format: their vertices in every frame, faces, texture places and tags."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

UNIT = 1 / 64
"""Of a stored coordinate."""


@dataclass(frozen=True)
class Surface:
    """One surface.

    Attributes
    ----------
    name, shader : str
        Its name, and the texture's as the file has it.
    points : ndarray
        Frames x vertices x 3.
    spread : ndarray
        Texture coordinates, vertices x 2; v counts upwards.
    faces : ndarray
        Triangles, counted from 0, turning left when seen from outside.
    """

    name: str
    shader: str
    points: np.ndarray
    spread: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class Model:
    """One file: surfaces, and by name the tags' frames x (origin, 3 axes) x 3."""

    surfaces: tuple[Surface, ...]
    tags: dict[str, np.ndarray]


def read(data: bytes) -> Model:
    """Read a model; raises ValueError for anything else."""
    if data[:4] != b"IDP3":
        raise ValueError("no MD3 model")
    head = struct.unpack_from("<4si64s9i", data)
    frames, tag_count, surface_count = head[4], head[5], head[6]
    tag_place, surface_place = head[9], head[10]
    tags: dict[str, list[np.ndarray]] = {}
    for number in range(frames * tag_count):
        start = tag_place + 112 * number
        axes = np.frombuffer(data, "<f4", 12, start + 64).reshape(4, 3)
        tags.setdefault(_text(data[start : start + 64]), []).append(axes)
    surfaces = []
    for _ in range(surface_count):
        surface, surface_place = _surface(data, surface_place)
        surfaces.append(surface)
    return Model(tuple(surfaces), {name: np.stack(axes) for name, axes in tags.items()})


def _surface(data: bytes, start: int) -> tuple[Surface, int]:
    fields = struct.unpack_from("<4s64s10i", data, start)
    name, (frames, shaders, points, triangles) = _text(fields[1]), fields[3:7]
    face_place, shader_place, spread_place, point_place, end = fields[7:12]
    shader = _text(data[start + shader_place :][:64]) if shaders else ""
    faces = np.frombuffer(data, "<i4", 3 * triangles, start + face_place).reshape(-1, 3)
    spread = np.frombuffer(data, "<f4", 2 * points, start + spread_place).reshape(-1, 2)
    stored = np.frombuffer(data, "<i2", 4 * points * frames, start + point_place)
    places = stored.reshape(frames, points, 4)[..., :3].astype(np.float32) * UNIT
    upward = np.stack([spread[:, 0], 1 - spread[:, 1]], axis=1)
    return Surface(name, shader, places, upward, faces[:, ::-1].copy()), start + end


def _text(data: bytes) -> str:
    return data.split(b"\0")[0].decode("latin-1")


def attach(points: np.ndarray, model: Model, name: str, frames: Sequence[int]) -> np.ndarray:
    """Move points (frames x n x 3) into the space of a model by its tag's frames."""
    tag = model.tags[name][list(frames)]
    return points @ tag[:, 1:] + tag[:, :1]


def to_obj(surfaces: Sequence[Surface], frame: int, looks: Sequence[str], library: str) -> str:
    """Write surfaces as OBJ with y upwards, one material each.

    Parameters
    ----------
    surfaces : sequence of Surface
        What is written.
    frame : int
        Which frame.
    looks : sequence of str
        The material of each surface.
    library : str
        Name of the MTL file.
    """
    lines, first = [f"mtllib {library}"], 1
    for surface, look in zip(surfaces, looks, strict=True):
        lines += [f"v {x:.5f} {z:.5f} {-y:.5f}" for x, y, z in surface.points[frame]]
        lines += [f"vt {u:.5f} {v:.5f}" for u, v in surface.spread]
        lines += [f"usemtl {look}"]
        for face in surface.faces + first:
            lines.append("f " + " ".join(f"{corner}/{corner}" for corner in face))
        first += len(surface.spread)
    return "\n".join(lines) + "\n"
