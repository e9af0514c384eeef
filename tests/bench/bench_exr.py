"""What encoding a frame takes here, as a multiple of OpenEXR's time; and size.

``python -m tests.bench.bench_exr [FILE …]``: noise, a flat frame, and the first part of each file,
in every compression that `io.exr.writer` makes. Ours begins with floats, as frames are made, and
OpenEXR with halfs. Both must hold the same bits; that is checked.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from exwarp_cli.io.exr.writer import LINES, OutputChannel, PendingHalf, encode, encode_by_openexr
from tests.bench import goals
from tests.bench.timing import compare

Planes = dict[str, np.ndarray]
SHAPE = (1080, 1920)
ROUNDS = 5
GOALS = {"noise": {"ZIP": 0.3, "ZIPS": 0.6}, "flat": {"ZIP": 0.3}}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench.bench_exr", __doc__)
    parser.add_argument("files", type=Path, nargs="*")
    options = parser.parse_args(arguments)
    figures = [each for frame in _frames(options.files) for each in _encoding(*frame)]
    return goals.finish(figures, options)


def _encoding(name: str, planes: Planes) -> list[goals.Figure]:
    """Compare the encoding of one frame."""
    height, width = next(iter(planes.values())).shape
    corner = np.array([width - 1, height - 1], np.int32)
    window = (np.zeros(2, np.int32), corner)
    works, sizes = {}, []
    for compression in LINES:
        header = {"compression": compression, "type": OpenEXR.scanlineimage}
        header |= {"dataWindow": window, "displayWindow": window}
        ours, theirs = partial(encode, [(header, _as_made(planes))]), [(header, planes)]
        works[_name(compression)] = ours, partial(encode_by_openexr, theirs)
        ends = b"".join(ours()), encode_by_openexr(theirs)
        if not _same(*ends):
            raise RuntimeError(f"{name}: {compression} does not hold what OpenEXR writes")
        size = sum(plane.nbytes for plane in planes.values())
        shares = " and ".join(f"{len(end) / size:.3f}" for end in ends)
        sizes.append(f"{_name(compression)} {shares}")
    ratios = compare(works, ROUNDS)
    table = goals.table("exr", f"encoding {name}", "OpenEXR", ratios, GOALS.get(name, {}))
    print(f"share of the pixels' bytes, ours and OpenEXR's: {'; '.join(sizes)}")
    return table


def _name(compression: Any) -> str:
    return str(compression.name).removesuffix("_COMPRESSION")


def _as_made(planes: Mapping[str, np.ndarray]) -> dict[str, OutputChannel]:
    """Return halfs as channels of one image of floats, as frames are made; others as they are."""
    halfs = [name for name, plane in planes.items() if plane.dtype == np.float16]
    if not halfs:
        return dict(planes)
    pixels = np.stack([planes[name].astype(np.float32) for name in halfs], axis=-1)
    return {**planes, **{n: PendingHalf(pixels[..., i], True) for i, n in enumerate(halfs)}}


def _frames(files: Sequence[Path]) -> Iterator[tuple[str, Planes]]:
    rng = np.random.default_rng(0)
    yield "noise", {c: rng.lognormal(0, 1, SHAPE).astype(np.float16) for c in "RGBA"}
    flat = np.zeros(SHAPE, np.float16)
    flat[300:700, 400:900], flat[100:200] = 0.5, np.linspace(0, 1, SHAPE[1])
    yield "flat", {c: flat for c in "RGBA"}
    for path in files:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = file.parts[0].channels
            yield path.stem, {n: np.ascontiguousarray(c.pixels) for n, c in channels.items()}


def _same(first: bytes | memoryview, second: bytes | memoryview) -> bool:
    held = []
    for data in (first, second):
        with OpenEXR.File(io.BytesIO(bytes(data)), separate_channels=True) as file:
            channels = file.parts[0].channels
            held.append({name: channel.pixels.tobytes() for name, channel in channels.items()})
    return held[0] == held[1]


if __name__ == "__main__":
    sys.exit(main())
