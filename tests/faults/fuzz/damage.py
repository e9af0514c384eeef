"""What can be wrong with a shot on disk, drawn by hypothesis so that it shrinks.

Each function takes hypothesis's `draw` and a folder of three key frames, and spoils it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from hypothesis import strategies as st

from tests.blender_layers import FLOAT, multipart
from tests.cli import shots
from tests.cli.street import Street

Draw = Callable[[st.SearchStrategy[Any]], Any]
Damage = Callable[[Draw, Path], None]

STREET = Street(20, 12)
NUMBERS = (1, 2, 3)
COMPRESSIONS = (
    OpenEXR.NO_COMPRESSION,
    OpenEXR.RLE_COMPRESSION,
    OpenEXR.ZIPS_COMPRESSION,
    OpenEXR.ZIP_COMPRESSION,
    OpenEXR.PIZ_COMPRESSION,
    OpenEXR.PXR24_COMPRESSION,
    OpenEXR.B44A_COMPRESSION,
    OpenEXR.DWAA_COMPRESSION,
)
ODD = (
    np.nan, np.inf, -np.inf, 0.0, -0.0, 1e30, -1e30, 3.4e38, 1e-42, -1e-42, 65504.0, 65536.0,
    2.0**24, 2.0**24 + 2, 2.0**31, -1.0, 1e10,
)  # fmt: skip
"""Values that no renderer means, and every one writes some day."""


@cache
def planes_of(time: float) -> list[dict[str, np.ndarray]]:
    """The passes of an instant."""
    return shots.blender_passes(STREET, time)


def draw_shot(draw: Draw, folder: Path) -> None:
    """Write three sound key frames, as one part or several, in any compression."""
    compression = draw(st.sampled_from(COMPRESSIONS))
    several = draw(st.booleans())
    for i, number in enumerate(NUMBERS):
        passes = planes_of(float(i))
        flat = {name: plane for planes in passes for name, plane in planes.items()}
        parts = multipart(passes) if several else {"": flat}
        head = shots.header(compression=compression)
        shots.write(folder / f"shot.{number:04d}.exr", parts, head)


def files(folder: Path) -> list[Path]:
    """Return the frames that are files: what links lead to may have no end."""
    return sorted(path for path in folder.glob("*.exr") if path.is_file())


def _file(draw: Draw, folder: Path) -> Path:
    return Path(draw(st.sampled_from(files(folder))))


def _single(draw: Draw, folder: Path) -> tuple[Path, dict[str, Any], dict[str, np.ndarray]]:
    """Draw a frame; return its path, header and planes as of one part."""
    path = _file(draw, folder)
    planes = {n: p.copy() for group in planes_of(1.0) for n, p in group.items()}
    return path, shots.header(), planes


def flip_bits(draw: Draw, folder: Path) -> None:
    """Turn single bits over, mostly of the header."""
    path = _file(draw, folder)
    data = bytearray(path.read_bytes())
    if not data:
        return
    end = draw(st.sampled_from([min(len(data), 600), len(data)]))
    for _ in range(draw(st.integers(1, 8))):
        data[draw(st.integers(0, end - 1))] ^= 1 << draw(st.integers(0, 7))
    path.write_bytes(data)


def overwrite(draw: Draw, folder: Path) -> None:
    """Put any bytes, or a large number, anywhere."""
    path = _file(draw, folder)
    data = bytearray(path.read_bytes())
    new = draw(
        st.one_of(
            st.binary(min_size=1, max_size=16),
            st.sampled_from([b"\xff\xff\xff\x7f", b"\xff" * 4, b"\x00" * 8, b"\x01\x00\x00\x80"]),
        )
    )
    at = draw(st.integers(0, max(len(data) - len(new), 0)))
    data[at : at + len(new)] = new
    path.write_bytes(data)


def truncate(draw: Draw, folder: Path) -> None:
    """End early: after a power of two of bytes, or anywhere."""
    path = _file(draw, folder)
    data = path.read_bytes()
    powers = st.integers(0, 16).map(lambda n: 2**n)
    path.write_bytes(data[: draw(st.one_of(powers, st.integers(0, len(data))))])


def lengthen(draw: Draw, folder: Path) -> None:
    """Go on after the end, or say everything twice."""
    path = _file(draw, folder)
    data = path.read_bytes()
    path.write_bytes(data + draw(st.sampled_from([b"\0", b"x" * 1000, data])))


def no_exr(draw: Draw, folder: Path) -> None:
    """Put something else under the name."""
    others = [
        b"", b"\n", b"v/1\x01", b"v/1\x01\x02\x00\x00\x00", b"P6\n2 2\n255\n" + bytes(12),
        b"\x89PNG\r\n\x1a\n", b"II*\0" + bytes(40), b"#?RADIANCE\n", b"text\n" * 50, bytes(4096),
    ]  # fmt: skip
    _file(draw, folder).write_bytes(draw(st.one_of(st.sampled_from(others), st.binary())))


def odd_values(draw: Draw, folder: Path) -> None:
    """Write values that mean nothing into any channels, everywhere or in a spot."""
    path, head, planes = _single(draw, folder)
    names = draw(st.lists(st.sampled_from(sorted(planes)), min_size=1, max_size=4, unique=True))
    for name in names:
        value = draw(st.sampled_from(ODD))
        plane = planes[name] = planes[name].astype(
            FLOAT if abs(value) > 6e4 else planes[name].dtype
        )
        if draw(st.booleans()):
            plane[...] = value
        else:
            y, x = draw(st.integers(0, STREET.height - 1)), draw(st.integers(0, STREET.width - 1))
            plane[y, x] = value
    shots.write(path, {"": planes}, head)


def swapped_channels(draw: Draw, folder: Path) -> None:
    """Exchange what channels hold, or their names."""
    path, head, planes = _single(draw, folder)
    names = sorted(planes)
    for _ in range(draw(st.integers(1, 3))):
        a, b = draw(st.sampled_from(names)), draw(st.sampled_from(names))
        planes[a], planes[b] = planes[b], planes[a]
    shots.write(path, {"": planes}, head)


def lost_channels(draw: Draw, folder: Path) -> None:
    """Leave channels out, in one frame or in all."""
    paths = sorted(folder.glob("*.exr")) if draw(st.booleans()) else [_file(draw, folder)]
    planes = {n: p for group in planes_of(1.0) for n, p in group.items()}
    kept = draw(st.lists(st.sampled_from(sorted(planes)), min_size=1, unique=True))
    for path in paths:
        shots.write(path, {"": {name: planes[name] for name in kept}})


def renamed_channels(draw: Draw, folder: Path) -> None:
    """Give channels names that no renderer has, in all frames."""
    letters = st.text(
        st.characters(blacklist_categories=["Cs"], blacklist_characters="\0"),
        min_size=1,
        max_size=12,
    )
    planes = {n: p for group in planes_of(1.0) for n, p in group.items()}
    old = draw(st.sampled_from(sorted(planes)))
    new = draw(letters)
    if len(new.encode()) > 200:
        return
    found = {new if name == old else name: plane for name, plane in planes.items()}
    for path in sorted(folder.glob("*.exr")):
        shots.write(path, {"": found})


def odd_windows(draw: Draw, folder: Path) -> None:
    """Move and resize the windows: single pixels, negative places, far away."""
    paths = sorted(folder.glob("*.exr")) if draw(st.booleans()) else [_file(draw, folder)]
    height = draw(st.sampled_from([1, 2, STREET.height]))
    width = draw(st.sampled_from([1, 3, STREET.width]))
    places = st.sampled_from([0, -5, 7, -100_000, 100_000])
    data = shots.window(draw(places), draw(places), width, height)
    sizes = st.sampled_from([1, 2, 20, 64])
    display = shots.window(draw(places), draw(places), draw(sizes), draw(sizes))
    head = shots.header(dataWindow=data, displayWindow=display)
    planes = {n: p[:height, :width].copy() for g in planes_of(1.0) for n, p in g.items()}
    for path in paths:
        shots.write(path, {"": planes}, head)


def odd_sizes(draw: Draw, folder: Path) -> None:
    """Have the header claim windows of no size, or of far too many pixels."""
    path = _file(draw, folder)
    data = bytearray(path.read_bytes())
    name = draw(st.sampled_from([b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"]))
    at = data.find(name)
    if at < 0:
        return
    ends = st.sampled_from([-2, -1, 0, 1, 19, 2**14, 2**20, 2**30, 2**31 - 1, -(2**31)])
    values = np.array([draw(ends) for _ in range(4)], "<i4").tobytes()
    begin = at + len(name) + 4
    data[begin : begin + 16] = values
    path.write_bytes(data)


def constant(draw: Draw, folder: Path) -> None:
    """Write one number for the depth, the ids or all of a pass, in all frames."""
    name = draw(
        st.sampled_from(["Depth.Z", "Object Index.X", "Normal.X", "Vector.X", "Position.Z"])
    )
    value = draw(st.sampled_from(ODD))
    for i, path in enumerate(sorted(folder.glob("*.exr"))):
        planes = {n: p.copy() for group in planes_of(float(i)) for n, p in group.items()}
        planes[name] = np.full(planes[name].shape, value, FLOAT)
        shots.write(path, {"": planes})


def large_ids(draw: Draw, folder: Path) -> None:
    """Write ids that float32 cannot tell apart, as integers."""
    first = draw(st.sampled_from([2**24 - 1, 2**24, 2**31 - 2, 2**32 - 3]))
    for i, path in enumerate(sorted(folder.glob("*.exr"))):
        planes = {n: p.copy() for group in planes_of(float(i)) for n, p in group.items()}
        planes["Object Index.X"] = (first + planes["Object Index.X"].astype(np.uint64) % 3).astype(
            np.uint32
        )
        shots.write(path, {"": planes})


def missing_frame(draw: Draw, folder: Path) -> None:
    """Take frames away."""
    for path in draw(st.lists(st.sampled_from(sorted(folder.glob("*.exr"))), max_size=3)):
        path.unlink(missing_ok=True)


def duplicate_frame(draw: Draw, folder: Path) -> None:
    """Have a frame twice, under another padding, number or name."""
    names = [
        "shot.1.exr",
        "shot.00001.exr",
        "shot.0009.exr",
        "other.0001.exr",
        "shot.exr",
        "-1.exr",
    ]
    shutil.copy(_file(draw, folder), folder / draw(st.sampled_from(names)))


def another_shot(draw: Draw, folder: Path) -> None:
    """Mix in a frame of another shot: other size, other names, other passes."""
    path = _file(draw, folder)
    write = draw(st.sampled_from([shots.plain, shots.blender5, shots.blender4, shots.colour_only]))
    write(path, Street(draw(st.sampled_from([20, 33])), 12), 0.5)


def links(draw: Draw, folder: Path) -> None:
    """Put links in the place of frames: to themselves, to nothing, to a folder."""
    path = _file(draw, folder)
    path.unlink()
    path.symlink_to(
        draw(st.sampled_from([path.name, "nowhere.exr", "..", "/dev/null", "/dev/zero"]))
    )


def folder_in_the_way(draw: Draw, folder: Path) -> None:
    """Put a folder in the place of a frame."""
    path = _file(draw, folder)
    path.unlink()
    path.mkdir()


def odd_attributes(draw: Draw, folder: Path) -> None:
    """Write attributes that say odd things of the whole frame."""
    path = _file(draw, folder)
    rates = [Fraction(0), Fraction(-1), Fraction(10**9), Fraction(1, 10**9)]
    texts = ["<script>", "%s%n", "\u202e", "x" * 5000, "{{ 7 * 7 }}", "a\nb\x1b[31m"]
    head = shots.header(
        framesPerSecond=draw(st.sampled_from(rates)),
        chromaticities=draw(st.sampled_from([(0.0,) * 8, (float("nan"),) * 8, (1e30,) * 8])),
        comments=draw(st.sampled_from(texts)),
    )
    planes = {n: p for group in planes_of(1.0) for n, p in group.items()}
    shots.write(path, {"": planes}, head)
    data = bytearray(path.read_bytes())
    at = data.find(b"pixelAspectRatio\0float\0") + 27
    aspects = [1.0, 0.0, -1.0, float("nan"), float("inf"), 1e-30]
    data[at : at + 4] = np.array([draw(st.sampled_from(aspects))], "<f4").tobytes()
    path.write_bytes(data)


DAMAGES: tuple[Damage, ...] = (
    flip_bits, overwrite, truncate, lengthen, no_exr, odd_values, swapped_channels, lost_channels,
    renamed_channels, odd_windows, odd_sizes, constant, large_ids, missing_frame, duplicate_frame,
    another_shot, links, folder_in_the_way, odd_attributes,
)  # fmt: skip

FOLDERS = ("keys", "with space", "ünïcödé 帧", "50% #1", "a'b\"c", "[x]{y}", "-dash", "per%20cent")
"""Names of folders that need quoting somewhere."""
