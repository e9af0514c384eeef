"""OpenArena's running characters: legs, trunk and head put together, as points in every frame."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
import things_md3

RUN = "LEGS_RUN"
STAND = "TORSO_STAND"
FOLDER = "models/players"


def names(archive: zipfile.ZipFile) -> list[str]:
    """List the characters that an archive has with all their parts."""
    there = set(archive.namelist())
    found = {name.split("/")[2] for name in there if name.startswith(f"{FOLDER}/")}
    parts = ("animation.cfg", "lower_default.skin", "upper_default.skin", "head_default.skin")
    return sorted(n for n in found if {f"{FOLDER}/{n}/{part}" for part in parts} <= there)


def convert(archive: zipfile.ZipFile, name: str, target: Path) -> list[str]:
    """Write a running character as an npz file; return its pictures' paths in the archive.

    It holds `points` (frames x n x 3, metres of a person 1.8 m tall, feet at z = 0, facing x, the
    frames making one round), `faces` (triangles), `spread` (n x 2, texture places), `look` (a
    triangle's number in `pictures`), `pictures` (paths within the archive) and `seconds` (of the
    round).
    """
    folder = f"{FOLDER}/{name}"
    lower, upper, head = (
        things_md3.read(archive.read(f"{folder}/{part}.md3")) for part in ("lower", "upper", "head")
    )
    first, count, rate = _animation(archive, folder, RUN)
    stand, _, _ = _animation(archive, folder, STAND)
    shift = _gap(archive, folder)
    frames = [min(first - shift + step, len(lower.tags["tag_torso"]) - 1) for step in range(count)]
    groups = [(surface, surface.points[frames]) for surface in lower.surfaces]
    still = [stand] * count
    for surface in upper.surfaces:
        placed = things_md3.attach(surface.points[still], lower, "tag_torso", frames)
        groups.append((surface, placed))
    for surface in head.surfaces:
        placed = things_md3.attach(surface.points[[0] * count], upper, "tag_head", still)
        groups.append((surface, things_md3.attach(placed, lower, "tag_torso", frames)))
    pictures = _skins(archive, folder)
    points, faces, spread, look = [], [], [], []
    used: list[str] = []
    start = 0
    for surface, placed in groups:
        skin = pictures.get(surface.name, "")
        if not skin:
            continue
        if skin not in used:
            used.append(skin)
        points.append(placed)
        faces.append(surface.faces + start)
        spread.append(surface.spread)
        look.append(np.full(len(surface.faces), used.index(skin)))
        start += len(surface.spread)
    body = np.concatenate(points, axis=1)
    low, high = body[..., 2].min(), body[..., 2].max()
    body = (body - (0, 0, low)) * (1.8 / (high - low))
    target.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        target,
        points=body.astype(np.float32),
        faces=np.concatenate(faces),
        spread=np.concatenate(spread),
        look=np.concatenate(look),
        pictures=np.array(used),
        seconds=count / rate,
    )
    return used


def _rows(archive: zipfile.ZipFile, folder: str) -> dict[str, tuple[int, int, int]]:
    text = archive.read(f"{folder}/animation.cfg").decode("latin-1")
    found = re.findall(r"^(\d+)\s+(\d+)\s+\d+\s+(\d+)\s*//\s*(\w+)", text, re.MULTILINE)
    return {name: (int(first), int(count), int(rate)) for first, count, rate, name in found}


def _animation(archive: zipfile.ZipFile, folder: str, name: str) -> tuple[int, int, int]:
    """Return first frame, count of frames and frames a second of an animation."""
    return _rows(archive, folder)[name]


def _gap(archive: zipfile.ZipFile, folder: str) -> int:
    """Return by how much the legs' frames are counted too high: past the trunk's own frames."""
    rows = _rows(archive, folder)
    first = min(number for name, (number, _, _) in rows.items() if name.startswith("LEGS"))
    return first - min(n for name, (n, _, _) in rows.items() if name.startswith("TORSO"))


def _skins(archive: zipfile.ZipFile, folder: str) -> dict[str, str]:
    """Return the picture of each surface, by the default skins."""
    found = {}
    for part in ("lower", "upper", "head"):
        text = archive.read(f"{folder}/{part}_default.skin").decode("latin-1")
        for line in text.splitlines():
            surface, comma, shader = (cell.strip() for cell in line.partition(","))
            if comma and (path := picture(archive, f"{folder}/{part}", shader)):
                found[surface] = path
    return found


def picture(archive: zipfile.ZipFile, model: str, shader: str) -> str:
    """Return the path of a shader's picture in the archive, or "" if there is none."""
    stem = re.sub(r"\.\w+$", "", shader.replace("\\", "/"))
    names = {name.lower(): name for name in archive.namelist()}
    for base in (stem, f"{model.rpartition('/')[0]}/{stem.rpartition('/')[2]}"):
        for suffix in (".jpg", ".tga", ".png"):
            if base and (found := names.get((base + suffix).lower())):
                return found
    return ""
