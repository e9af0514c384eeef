"""The least that upsampling a sequence can cost: its codecs, with nothing between.

``python -m tests.bench.codec_floor KEYS OUT [--count N] [--normals]``: of every key frame the
needed channels are decoded, its file is copied, and its colour is encoded once per new frame with
the same channels, pixel types and compression. Reading and writing overlap; encoding takes as many
threads as there are cores, a frame each, which was the fastest of the ways tried (110 ms a frame;
all threads on one frame at a time: 130). Nothing of exwarp is used.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio

NEW_FRAMES = 3
BEHIND = 4
COLOUR = "Combined"
NEEDED = (COLOUR, "Depth", "Vector", "Position", "Object Index")
"""Layers that a warp needs; a multi-part file has one part for each."""
NORMALS = "Normal"
"""What the features that a policy sees are made of besides."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.codec_floor", description=__doc__)
    parser.add_argument("keys", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--count", type=int, help="key frames from the first on; default: all")
    parser.add_argument("--normals", action="store_true", help="decode normals too")
    parser.add_argument("--core", type=int, help="the only one to use; default: any")
    options = parser.parse_args(arguments)
    if options.core is not None:
        _keep_to(options.core)
    options.out.mkdir(parents=True, exist_ok=True)
    oiio.attribute("threads", options.threads)
    oiio.attribute("exr_threads", options.threads)
    keys = sorted(options.keys.glob("*.exr"))[: options.count]
    decode = partial(_decode, layers=(*NEEDED, NORMALS) if options.normals else NEEDED)
    waiting: deque[Future[object]] = deque()
    with ThreadPoolExecutor(1) as reader, ThreadPoolExecutor(options.threads) as writers:
        ahead = deque([reader.submit(decode, keys[0])])
        for k, key in enumerate(keys):
            if k + 1 < len(keys):
                ahead.append(reader.submit(decode, keys[k + 1]))
            header, planes = ahead.popleft().result()
            first = 1 + (NEW_FRAMES + 1) * k
            targets = [options.out / f"floor.{first + i:04d}.exr" for i in range(NEW_FRAMES + 1)]
            while len(waiting) > BEHIND + options.threads:
                waiting.popleft().result()
            waiting.append(writers.submit(shutil.copyfile, key, targets[0]))
            waiting.extend(writers.submit(_encode, header, planes, t) for t in targets[1:])
        for write in waiting:
            write.result()
    return 0


def _keep_to(core: int) -> None:
    """Stay on one of the cores that there are, where the system offers that; Linux does."""
    if hasattr(os, "sched_setaffinity"):
        there = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {there[core % len(there)]})


def _decode(path: Path, layers: Sequence[str]) -> tuple[dict[str, object], dict[str, np.ndarray]]:
    """Read the needed parts in their own pixel types; return the colour's header and planes."""
    with OpenEXR.File(str(path), header_only=True) as file:
        headers = [dict(part.header) for part in file.parts]
    source = oiio.ImageInput.open(str(path))
    colour: tuple[dict[str, object], dict[str, np.ndarray]] = {}, {}
    for part, header in enumerate(headers):
        layer = str(header["name"]).split(".")[-1]
        if layer not in layers:
            continue
        spec = source.spec(part, 0)
        pixels = source.read_image(part, 0, 0, spec.nchannels, spec.format)
        if pixels is None:
            raise RuntimeError(f"{path}: {source.geterror()}")
        if layer == COLOUR:
            kept = {"compression": header["compression"], "type": OpenEXR.scanlineimage}
            planes = [np.ascontiguousarray(pixels[..., c]) for c in range(spec.nchannels)]
            colour = kept, dict(zip(spec.channelnames, planes, strict=True))
    source.close()
    return colour


def _encode(header: dict[str, object], planes: dict[str, np.ndarray], target: Path) -> None:
    OpenEXR.File(dict(header), dict(planes), num_threads=0).write(str(target))


if __name__ == "__main__":
    sys.exit(main())
