"""Shots on disk as renderers write them, made of the scene in `street`."""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import OpenEXR
import pytest

from tests.blender_layers import (
    FLOAT,
    HALF,
    Planes,
    blender_depth,
    blender_vector,
    layer,
    multipart,
)
from tests.cli.street import Street

SMALL = Street(48, 27)
FORWARD = ("--motion", "next=u,-v")
VECTORS = ("--motion", "previous=X,-Y next=-Z,W")
KEYS = 5
"""Key frames of the shot that extrapolation is tried on."""

HEADER: dict[str, Any] = {
    "compression": OpenEXR.ZIP_COMPRESSION,
    "type": OpenEXR.scanlineimage,
    "framesPerSecond": Fraction(30),
    "owner": "Ada",
    "shot:take": 3,
    "chromaticities": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
}


def write(path: Path, parts: Mapping[str, Planes], header: Mapping[str, Any] = HEADER) -> None:
    """Write a file; one part named "" makes a plain single-part file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if list(parts) == [""]:
        OpenEXR.File(dict(header), dict(parts[""])).write(str(path))
        return
    made = [OpenEXR.Part(dict(header), dict(planes), name) for name, planes in parts.items()]
    OpenEXR.File(made).write(str(path))


def truncate(path: Path) -> None:
    """Cut a file off in its middle, as a copy does that is killed."""
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def read(path: Path) -> tuple[dict[str, Any], Planes]:
    """Return the header and the channels of a file's first part."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        part = file.parts[0]
        return dict(part.header), {name: c.pixels.copy() for name, c in part.channels.items()}


def colour_of(path: Path) -> np.ndarray:
    """float64 [H, W, C] of R, G, B and, if there, A, whatever the layer."""
    _, planes = read(path)
    by_letter = {name.rsplit(".", 1)[-1]: plane for name, plane in planes.items()}
    return np.stack([by_letter[c] for c in "RGBA" if c in by_letter], -1).astype(np.float64)


def header(**more: Any) -> dict[str, Any]:
    """Return the usual header with other or further attributes."""
    return HEADER | more


def window(x: int, y: int, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a box as headers hold it."""
    return np.array([x, y], np.int32), np.array([x + width - 1, y + height - 1], np.int32)


def blender_passes(street: Street, time: float, sign: float = 1.0) -> list[Planes]:
    """The passes with Blender's names, without layer, colour first."""
    g = street.geometry(time)
    return [
        layer("Combined", "RGBA", street.colour(time), HALF),
        layer("Depth", "Z", blender_depth(g["depth"])),
        layer("Vector", "XYZW", sign * blender_vector(g["previous"], g["following"])),
        layer("Normal", "XYZ", g["normal"]),
        layer("Position", "XYZ", g["position"]),
        layer("Object Index", "X", g["id"]),
    ]


def blender5(path: Path, street: Street, time: float, sign: float = 1.0) -> None:
    """Multi-part, a part a pass, no frame rate."""
    bare = {k: v for k, v in HEADER.items() if k != "framesPerSecond"}
    write(path, multipart(blender_passes(street, time, sign)), bare)


def blender4(path: Path, street: Street, time: float) -> None:
    """Single part, with the layer name of an artist and the old names of passes."""
    planes = {k: v for group in blender_passes(street, time) for k, v in group.items()}
    old = {name.replace("Object Index", "IndexOB"): plane for name, plane in planes.items()}
    write(path, {"": {f"Hero shot.v2.{name}": plane for name, plane in old.items()}})


def plain_planes(street: Street, time: float) -> Planes:
    """R G B A Z and forward.u, forward.v in pixels, y up as Nuke has it."""
    g = street.geometry(time)
    forward = g["following"] * [1, -1]
    return {
        **layer("", "RGBA", street.colour(time), HALF),
        **layer("", "Z", blender_depth(g["depth"])),
        **layer("forward", "uv", forward),
    }


def plain(path: Path, street: Street, time: float) -> None:
    write(path, {"": plain_planes(street, time)})


def unreal(folder: Path, street: Street, time: float, number: int, rate: float = 1.0) -> None:
    """One file an AOV, as ExtraNet dumps them; `rate` 4 makes vectors to the previous slot."""
    g = street.geometry(time)
    previous = g["previous"] if rate == 1 else g["slot_previous"]
    sky = np.isinf(g["depth"])
    aovs = {
        "PreTonemapHDRColor": (street.colour(time), HALF),
        "MotionVector": (previous * [-1, 1], HALF if rate == 1 else FLOAT),
        "SceneDepth": (np.where(sky, 0, g["depth"])[..., None], FLOAT),
        "WorldNormal": (np.where(sky[..., None], -1, g["normal"]), HALF),
        "WorldPosition": (g["position"], FLOAT),
        "MyStencil": (g["id"][..., None], HALF),
        "BaseColor": (street.colour(time)[..., :3], HALF),
        "Roughness": (np.full((*sky.shape, 1), 0.5), HALF),
        "Metallic": (np.zeros((*sky.shape, 1)), HALF),
    }
    for name, (image, kind) in aovs.items():
        letters = "RGBA"[: image.shape[-1]]
        write(folder / f"P_{name}.{number:04d}.exr", {"": layer("", letters, image, kind)})


def slot_planes(street: Street, time: float) -> Planes:
    """G-buffers of one slot, without colour: vectors to the neighbouring slots."""
    g = street.geometry(time)
    return {
        **layer("Depth", "Z", blender_depth(g["depth"])),
        **layer("Vector", "XYZW", blender_vector(g["slot_previous"], g["slot_following"])),
        **layer("Normal", "XYZ", g["normal"]),
        **layer("Position", "XYZ", g["position"]),
        **layer("IndexOB", "X", g["id"]),
    }


def slot_gbuffer(path: Path, street: Street, time: float) -> None:
    write(path, {"": slot_planes(street, time)})


def colour_planes(street: Street, time: float) -> Planes:
    return layer("", "RGBA", street.colour(time), HALF)


def colour_only(path: Path, street: Street, time: float) -> None:
    write(path, {"": colour_planes(street, time)})


FrameWriter = Callable[[Path, Street, float], None]


def sequence(
    folder: Path,
    frame: FrameWriter = plain,
    numbers: Iterable[int] = (1, 2, 3),
    street: Street | None = None,
    step: float = 1.0,
) -> Path:
    """Write shot.####.exr for these numbers, at times 0, step, 2 step …"""
    for i, number in enumerate(numbers):
        frame(folder / f"shot.{number:04d}.exr", street or Street(), i * step)
    return folder


def truth(folder: Path, keys: int = 3, first: int = 1, street: Street | None = None) -> Path:
    """Write the colour of every slot up to the last key frame."""
    return sequence(folder, colour_only, range(first, first + 4 * keys - 3), street, 0.25)


def names(folder: Path) -> list[str]:
    """Return what lies in a folder, hidden files included."""
    return sorted(entry.name for entry in folder.iterdir()) if folder.exists() else []


def contents(folder: Path) -> dict[str, bytes]:
    """Bytes of every file of a folder, by name."""
    return {name: (folder / name).read_bytes() for name in names(folder)}


def require_part(folder: Path, whole: Path, count: int) -> None:
    """Judge that a folder holds so many of a whole run's files, and no others."""
    found = contents(folder)
    assert len(found) == count and found.items() <= contents(whole).items()


def reads_of(monkeypatch: pytest.MonkeyPatch, module: ModuleType) -> Counter[Path]:
    """Return how often a module reads each frame's file, counted from now on."""
    reads: Counter[Path] = Counter()
    true = module.read_raw

    def read_raw(shot: Any, number: int, *rest: Any, **more: Any) -> Any:
        reads[shot.sequence.files[number]] += 1
        return true(shot, number, *rest, **more)

    monkeypatch.setattr(module, "read_raw", read_raw)
    return reads


def passed_through(source: Path, rate: Fraction | int) -> bytes:
    """Return the bytes of a key frame with another rate in the headers of all parts."""
    value = struct.pack("<Iii", 8, *Fraction(rate).as_integer_ratio())
    parts, known = (
        len(OpenEXR.File(str(source), header_only=True).parts),
        rb"(framesPerSecond\0rational\0).{12}",
    )
    data, count = re.subn(known, lambda m: m[1] + value, source.read_bytes(), flags=re.DOTALL)
    assert count == parts
    return data


def psnr(reference: np.ndarray, test: np.ndarray) -> float:
    """Decibels between scene-linear images clipped to [0, 1]."""
    error = np.clip(reference[..., :3], 0, 1) - np.clip(test[..., :3], 0, 1)
    return float(-10 * np.log10(max(np.mean(error**2), 1e-10)))


def changed_by(run: Callable[[], object], folder: Path) -> set[int]:
    """Numbers of the frames that were written anew."""
    before = {name: (folder / name).stat().st_mtime_ns for name in names(folder)}
    run()
    now = {name: (folder / name).stat().st_mtime_ns for name in names(folder)}
    return {int(name.split(".")[1]) for name, time in now.items() if before.get(name) != time}


def generated(*keys: int) -> set[int]:
    """Numbers of slots 1 to 3 of these key frames."""
    return {4 * (key - 1) + 1 + i for key in keys for i in (1, 2, 3)}
