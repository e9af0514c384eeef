"""Run times of the kernels of synthesis beside OpenCV's remap, at 1920x1080.

``python -m tests.bench.bench_kernels``
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from exwarp_cli.domain.frame import Float32, GBuffer, KeyFrame
from exwarp_cli.kernels import _row_bands, gather, holes, resample, silhouettes, splat
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS
from exwarp_cli.synthesis.motion_fields import TURN_PER_SLOT, SlotField, reproject, settle_motion
from exwarp_cli.synthesis.trajectory import displacement
from exwarp_cli.synthesis.warp import LANCZOS, Mover, fill_holes
from tests.bench import goals
from tests.bench.street import key_frame
from tests.bench.timing import ROUNDS, Work, compare

SLOT, TIME = 2, 0.5
GOALS = {
    "resample, RGB": 1.0,
    "move(), RGB": 1.5,
    "move(), RGBA": 1.5,
    "row_reach + splat": 3.0,
}
"""`resample` also marks what it could not sample; `move` adds the surfaces' holes."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench.bench_kernels", __doc__, ROUNDS, threads=True)
    options = parser.parse_args(arguments)
    _row_bands.set_threads(options.threads)
    cv2.setNumThreads(options.threads)
    raw = [key_frame(instant) for instant in (1, 2)]
    keys = [_settled(key) for key in raw]
    works = {**_warping(keys), **_geometry(raw[0], keys[0]), **_methods(keys)}
    title = f"1920x1080, float32, {options.threads} threads, {options.rounds} rounds"
    ratios = compare(works, options.rounds)
    return goals.finish(goals.table("kernels", title, "cv2.remap", ratios, GOALS), options)


def _settled(key: KeyFrame) -> KeyFrame:
    return replace(key, gbuffer=settle_motion(_gbuffer(key)))


def _gbuffer(key: KeyFrame) -> GBuffer:
    assert key.gbuffer is not None
    return key.gbuffer


def _remap(image: Float32, field: Float32, kernel: int = cv2.INTER_LINEAR) -> Work:
    """Return OpenCV's work on the same field; a pixel without a source samples itself."""
    y, x = np.mgrid[0 : field.shape[0], 0 : field.shape[1]].astype(np.float32)
    at = np.stack([x, y], axis=-1) + np.nan_to_num(field)
    out = np.empty_like(image)
    return lambda: cv2.remap(image, at, None, kernel, out, cv2.BORDER_REPLICATE)


def _warping(keys: list[KeyFrame]) -> dict[str, tuple[Work, Work]]:
    """Colour along a motion field."""
    rgba = keys[0].image.pixels
    rgb = np.ascontiguousarray(rgba[..., :3])
    source = reproject(_gbuffer(keys[0]), TIME)
    base, base_rgba = _remap(rgb, source.field), _remap(rgba, source.field)
    sharp, sharp_rgba = (_remap(p, source.field, cv2.INTER_LANCZOS4) for p in (rgb, rgba))
    mover = Mover(source)
    warped, hole = mover.move(rgb)
    return {
        "cv2.remap, RGBA": (base_rgba, base),
        "gather, RGB": (_gather(rgb, source), base),
        "gather, RGBA": (_gather(rgba, source), base_rgba),
        "resample, RGB": (_resample(rgb, source), sharp),
        "move(), RGB": (lambda: mover.move(rgb), sharp),
        "move(), RGBA": (lambda: mover.move(rgba), sharp_rgba),
        "fill_holes()": (lambda: fill_holes(warped, source.depth, hole), base),
    }


def _gather(image: Float32, source: SlotField) -> Work:
    out, hole = np.empty_like(image), np.empty(image.shape[:2], np.bool_)
    return lambda: gather.gather_bilinear(image, source.field, out, hole)


def _resample(image: Float32, source: SlotField) -> Work:
    out, hole = np.empty_like(image), np.empty(image.shape[:2], np.bool_)
    return lambda: resample.resample(image, source.field, LANCZOS, out, hole)


def _geometry(raw: KeyFrame, settled: KeyFrame) -> dict[str, tuple[Work, Work]]:
    """Motion fields and hole masks."""
    buffers, moving = _gbuffer(raw), _gbuffer(settled)
    motion, depth, stencil = displacement(moving, TIME), buffers.depth, buffers.stencil
    assert depth is not None and stencil is not None and buffers.to_next is not None
    field, near = np.empty_like(motion), np.empty_like(depth)
    edge, mask = np.empty(depth.shape, np.bool_), np.empty(depth.shape, np.bool_)
    source = reproject(moving, TIME)

    extents = np.empty((len(motion), -(-motion.shape[1] // splat.REACH_SPAN) + 1, 2), np.float32)

    def splat_all() -> None:
        splat.splat_row_extents(motion, extents)
        splat.splat(motion, depth, extents, field, near)

    cosine = np.float32(np.cos(SLOT * TURN_PER_SLOT))
    limits = cosine, *(np.float32(0),) * 3
    pairs = [(a, a) for a in (depth, stencil, buffers.position, buffers.normal)]
    works: dict[str, Work] = {
        "row_reach": lambda: splat.splat_row_extents(motion, extents),
        "row_reach + splat": splat_all,
        "mark": lambda: holes.mark_holes(source.field, *pairs, limits, mask),
        "find_edges": lambda: silhouettes.find_edges(depth, stencil, edge),
        "find_fringe": lambda: silhouettes.find_ghosts(source.field, source.depth, depth, mask),
        "displacement()": lambda: displacement(moving, TIME),
        "settle_motion()": lambda: settle_motion(buffers),
        "reproject()": lambda: reproject(moving, TIME),
    }
    base = _remap(np.ascontiguousarray(raw.image.pixels[..., :3]), source.field)
    return {name: (work, base) for name, work in works.items()}


def _methods(keys: list[KeyFrame]) -> dict[str, tuple[Work, Work]]:
    """Whole frames of a slot, RGBA, from key frames whose motion is settled."""
    base = _remap(keys[0].image.pixels, reproject(_gbuffer(keys[0]), TIME).field)

    def predict(name: str) -> Work:
        made = METHODS[name].predict
        assert made is not None
        return lambda: made(Interval(keys[0], keys[1]), SLOT)

    alone = [m.name for m in METHODS.values() if not (m.extrapolates or m.interpolates)]
    return {f"{name}, a whole slot": (predict(name), base) for name in alone}


if __name__ == "__main__":
    sys.exit(main())
