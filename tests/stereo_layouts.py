"""A stereo shot in the layouts of different writers, from one that Blender wrote.

`python -m tests.stereo_layouts FROM TO` makes a folder of `LAYOUTS` each in TO, of the frames in
FROM: those that `tests/blender/stereo_shot.py` renders, or any with a part for every pass and view.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

Planes = dict[str, np.ndarray]
Eyes = Mapping[str, Planes]
"""Channels by view and by name without it: Combined.R, Vector.X."""
Box = tuple[int, int, int, int]
"""Left, top, width and height."""

HEADER = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
VIEWS = ("left", "right")


def read_eyes(path: Path) -> dict[str, Planes]:
    """Read a multi-part file with a part for each pass and view; the view layer's name goes."""
    eyes: dict[str, Planes] = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            planes = eyes.setdefault(part.header["view"], {})
            for name, channel in part.channels.items():
                planes[name.partition(".")[2]] = channel.pixels.copy()
    return eyes


def single(path: Path, eyes: Eyes, number: int) -> None:
    """One part with `multiView`: the hero's channels go without view."""
    write_single(path, eyes, named_hero=False)


def single_named(path: Path, eyes: Eyes, number: int) -> None:
    """One part with `multiView` in which the hero is named too, but for its colour."""
    write_single(path, eyes, named_hero=True)


def write_single(path: Path, eyes: Eyes, named_hero: bool, views: tuple[str, ...] = VIEWS) -> None:
    """Write one part; colour has no layer."""
    planes: Planes = {}
    for view in views:
        for name, plane in eyes[view].items():
            layer, _, component = name.rpartition(".")
            layer = "" if layer == "Combined" else layer
            shown = view if view != views[0] or (named_hero and layer) else ""
            planes[".".join(filter(None, (layer, shown, component)))] = plane
    OpenEXR.File(HEADER | {"multiView": list(views)}, planes).write(str(path))


def nuke(path: Path, eyes: Eyes, number: int) -> None:
    """One part as Nuke writes it: forward.u, backward.left.u and the like, y up; depth.Z."""
    changed = {}
    for view, planes in eyes.items():
        signs = {"backward.u": ("X", 1), "backward.v": ("Y", 1)}
        signs |= {"forward.u": ("Z", -1), "forward.v": ("W", -1)}
        vectors = {name: sign * planes[f"Vector.{c}"] for name, (c, sign) in signs.items()}
        kept = {f"Combined.{c}": planes[f"Combined.{c}"] for c in "RGBA"}
        changed[view] = kept | {"depth.Z": planes["Depth.Z"]} | vectors
    write_single(path, changed, named_hero=True)


def view_first(path: Path, eyes: Eyes, number: int) -> None:
    """One part as newer Nuke writes it: right.R, right.Depth.Z, right.Vector.X."""
    planes: Planes = {}
    for view in VIEWS:
        start = "" if view == VIEWS[0] else f"{view}."
        for name, plane in eyes[view].items():
            planes[start + name.removeprefix("Combined.")] = plane
    OpenEXR.File(HEADER | {"multiView": list(VIEWS)}, planes).write(str(path))


def parts(path: Path, eyes: Eyes, number: int) -> None:
    """A part for each layer and view, of data windows that move and leave the display window."""
    made = []
    for i, view in enumerate(VIEWS):
        layers: dict[str, Planes] = {}
        for name, plane in eyes[view].items():
            layer, _, component = name.rpartition(".")
            layers.setdefault(layer, {})[component] = plane
        for j, (layer, planes) in enumerate(layers.items()):
            height, width = next(iter(planes.values())).shape
            window = moving(width, height, number, i, j)
            header: dict[str, Any] = HEADER | {"view": view, "dataWindow": corners(window)}
            header["displayWindow"] = corners((0, 0, width, height))
            shown = {name: cropped(plane, window) for name, plane in planes.items()}
            made.append(OpenEXR.Part(header, shown, f"{layer}_{view}"))
    OpenEXR.File(made).write(str(path))


def moving(width: int, height: int, number: int, eye: int, layer: int) -> Box:
    """Return a data window that differs by frame, view and layer, and reaches outside."""
    left = -3 + (number + 2 * eye + layer) % 5
    top = -2 + (2 * number + eye) % 4
    return left, top, width + (number + layer) % 3, height + (number + eye) % 3


def cropped(plane: np.ndarray, window: Box) -> np.ndarray:
    """Cut a plane to a window; beyond its edge, its outermost pixels go on."""
    left, top, width, height = window
    rows = np.clip(np.arange(top, top + height), 0, plane.shape[0] - 1)
    columns = np.clip(np.arange(left, left + width), 0, plane.shape[1] - 1)
    return np.ascontiguousarray(plane[np.ix_(rows, columns)])


def corners(window: Box) -> tuple[np.ndarray, np.ndarray]:
    """Return a window as headers hold it."""
    left, top, width, height = window
    return np.array([left, top], np.int32), np.array([left + width - 1, top + height - 1], np.int32)


def folders(path: Path, eyes: Eyes, number: int) -> None:
    """A file for each view, in a folder of its own: found by %V/shot_%v.####.exr."""
    for view, planes in eyes.items():
        target = path.parent / view / f"shot_{view[0]}.{number:04d}.exr"
        target.parent.mkdir(exist_ok=True)
        OpenEXR.File(dict(HEADER), dict(planes)).write(str(target))


def aovs(path: Path, eyes: Eyes, number: int) -> None:
    """A file for each role, both views in it: colour, mv (X Y Z W, without a layer), z, more."""
    splits = {"colour": ("Combined",), "mv": ("Vector",), "z": ("Depth",)}
    rest = {name.rpartition(".")[0] for name in eyes["left"]} - {"Combined", "Vector", "Depth"}
    for folder, layers in {**splits, "more": tuple(rest)}.items():
        chosen = {}
        for view, planes in eyes.items():
            own = {n: p for n, p in planes.items() if n.rpartition(".")[0] in layers}
            bare = folder in ("mv", "z")
            chosen[view] = {n.rpartition(".")[2] if bare else n: p for n, p in own.items()}
        target = path.parent / folder / f"{folder}.{number:04d}.exr"
        target.parent.mkdir(exist_ok=True)
        write_single(target, chosen, named_hero=False)


LAYOUTS: dict[str, Callable[[Path, Eyes, int], None]] = {
    "single": single,
    "single_named": single_named,
    "nuke": nuke,
    "view_first": view_first,
    "parts": parts,
    "folders": folders,
    "aovs": aovs,
}


def convert(source: Path, target: Path, names: tuple[str, ...] = tuple(LAYOUTS)) -> None:
    """Write the layouts of a folder's frames."""
    for path in sorted(source.glob("*.exr")):
        eyes, number = read_eyes(path), int(path.stem.rpartition(".")[2])
        for name in names:
            folder = target / name
            folder.mkdir(parents=True, exist_ok=True)
            LAYOUTS[name](folder / path.name, eyes, number)


if __name__ == "__main__":
    convert(Path(sys.argv[1]).expanduser(), Path(sys.argv[2]).expanduser())
