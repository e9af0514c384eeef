"""What reading a key frame's channels takes here, against OpenImageIO, by compression.

``python -m tests.bench.bench_exr_decoding [FILE …] [--json FILE] [--check]``: a made-up frame of
1920x1080 in parts (colour in half; depth, positions, vectors and an index in float), each file
given, and the made-up frame's channels in one part. One thread each; pixels are checked to be the
same bits.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import OpenEXR

from exwarp_cli.io.exr.header import Channel
from exwarp_cli.io.exr.reader import ExrFile
from exwarp_cli.pipeline.scheduling import use_threads
from tests.bench import goals
from tests.bench.timing import compare

Planes = Mapping[str, np.ndarray]

SHAPE = (1080, 1920)
ROUNDS = 5
COMPRESSIONS = ("ZIPS", "ZIP")
GOALS = {"ZIP": 0.5}
"""Ratios to OpenImageIO."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench.bench_exr_decoding", __doc__)
    parser.add_argument("files", type=Path, nargs="*")
    options = parser.parse_args(arguments)
    use_threads(1)
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        files = dict(_made(Path(folder))) | {path.name: path for path in options.files}
        for name, path in files.items():
            _check(name, path)
        works = {
            name: (lambda path=path: _here(path), lambda path=path: _by_openimageio(path))
            for name, path in files.items()
        }
        ratios = compare(works, ROUNDS)
    title = "reading a key frame, one thread"
    return goals.finish(goals.table("exr_decoding", title, "OpenImageIO", ratios, GOALS), options)


def _frame() -> dict[str, Planes]:
    """Channels by part: what a renderer writes, with its noise."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    light = 0.3 + 0.2 * np.sin(x / 90) * np.cos(y / 70)
    noise = {c: light * rng.normal(1, 0.05, SHAPE) for c in "RGB"}
    colour = {c: plane.astype(np.float16) for c, plane in noise.items()}
    shapes = (x // 240 + 8 * (y // 180)).astype(np.float32)
    depth = 10 + shapes % 7 + 0.01 * y
    return {
        "colour": colour | {"A": np.ones(SHAPE, np.float16)},
        "depth": {"depth.Z": depth},
        "position": {"p.X": x * depth / 1000, "p.Y": y * depth / 1000, "p.Z": depth},
        "vector": {f"v.{c}": (x - 960) / depth * (k + 1) for k, c in enumerate("XYZW")},
        "index": {"index.X": shapes},
    }


def _made(folder: Path) -> Iterator[tuple[str, Path]]:
    frame = _frame()
    for name in COMPRESSIONS:
        header = {
            "compression": getattr(OpenEXR, f"{name}_COMPRESSION"),
            "type": OpenEXR.scanlineimage,
        }
        parts = [OpenEXR.Part(dict(header), dict(planes), part) for part, planes in frame.items()]
        path = folder / f"{name}.exr"
        OpenEXR.File(parts).write(str(path))
        yield name, path
        if name in GOALS:
            every = {channel: p for planes in frame.values() for channel, p in planes.items()}
            OpenEXR.File(dict(header), every).write(str(folder / f"one-{name}.exr"))
            yield f"{name}, one part", folder / f"one-{name}.exr"


def _here(path: Path) -> dict[Channel, np.ndarray]:
    with ExrFile(path) as file:
        return file.read(*(part.channels for part in file.parts))


def _by_openimageio(path: Path) -> dict[Channel, np.ndarray]:
    with ExrFile(path, by_openimageio=True) as file:
        return file.read(channel for part in file.parts for channel in part.channels)


def _check(name: str, path: Path) -> None:
    ours, theirs = _here(path), _by_openimageio(path)
    for channel, plane in theirs.items():
        if ours[channel].tobytes() != plane.tobytes():
            raise RuntimeError(f"{name}: {channel.name} is not what OpenImageIO reads")


if __name__ == "__main__":
    sys.exit(main())
