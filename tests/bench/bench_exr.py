"""What encoding a frame takes here and in OpenEXR: milliseconds of one core, and size.

``python -m tests.bench.bench_exr [FILE …]``: the first part of each file, noise, and a flat frame,
in every compression that `io.exr_encoding` makes. Both must hold the same bits; that is checked.
"""

from __future__ import annotations

import argparse
import io
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import OpenEXR

from exwarp_cli.io.exr_encoding import LINES, encoded, encoded_by_openexr

Planes = dict[str, np.ndarray]
SHAPE = (1080, 1920)
REPEATS = 5


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.bench_exr", description=__doc__)
    parser.add_argument("files", type=Path, nargs="*")
    options = parser.parse_args(arguments)
    print(f"{'frame':<24}{'compression':<14}{'ours':>16}{'OpenEXR':>18}")
    for name, planes in _frames(options.files):
        height, width = next(iter(planes.values())).shape
        size = sum(plane.nbytes for plane in planes.values())
        corner = np.array([width - 1, height - 1], np.int32)
        window = (np.zeros(2, np.int32), corner)
        for compression in LINES:
            header = {"compression": compression, "type": OpenEXR.scanlineimage}
            parts = [({**header, "dataWindow": window, "displayWindow": window}, planes)]
            ours, ours_ms = _timed(lambda parts=parts: encoded(parts))
            theirs, theirs_ms = _timed(lambda parts=parts: encoded_by_openexr(parts))
            if not _same(ours, theirs):
                raise RuntimeError(f"{name}: {compression} does not hold what OpenEXR writes")
            print(
                f"{name:<24}{compression.name.removesuffix('_COMPRESSION'):<14}"
                f"{ours_ms:7.1f} ms {len(ours) / size:.3f}{theirs_ms:9.1f} ms "
                f"{len(theirs) / size:.3f}"
            )
    return 0


def _frames(files: Sequence[Path]) -> Iterator[tuple[str, Planes]]:
    for path in files:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = file.parts[0].channels
            yield path.stem, {n: np.ascontiguousarray(c.pixels) for n, c in channels.items()}
    rng = np.random.default_rng(0)
    yield "noise", {c: rng.lognormal(0, 1, SHAPE).astype(np.float16) for c in "RGBA"}
    flat = np.zeros(SHAPE, np.float16)
    flat[300:700, 400:900], flat[100:200] = 0.5, np.linspace(0, 1, SHAPE[1])
    yield "flat", {c: flat for c in "RGBA"}


def _timed(work: Callable[[], bytes | memoryview]) -> tuple[bytes | memoryview, float]:
    """Return what it makes, and the least processor time in milliseconds."""
    took = []
    for _ in range(REPEATS):
        begin = time.process_time()
        made = work()
        took.append(time.process_time() - begin)
    return made, 1e3 * min(took)


def _same(first: bytes | memoryview, second: bytes | memoryview) -> bool:
    held = []
    for data in (first, second):
        with OpenEXR.File(io.BytesIO(bytes(data)), separate_channels=True) as file:
            channels = file.parts[0].channels
            held.append({name: channel.pixels.tobytes() for name, channel in channels.items()})
    return held[0] == held[1]


if __name__ == "__main__":
    sys.exit(main())
