"""Run times of the kernels beside OpenCV's remap and scikit-image's SSIM, at 1920x1080.

``python -m tests.bench.bench_kernels``
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from skimage.metrics import structural_similarity

from exwarp_cli.domain.frame import Float32, GBuffer, KeyFrame
from exwarp_cli.kernels import edges, gather, holes, jit, splat
from exwarp_cli.kernels.ssim import SIGMA, ssim_map
from exwarp_cli.metrics import flip, psnr, ssim
from exwarp_cli.metrics.display import PEAK, encode
from exwarp_cli.metrics.registry import score
from exwarp_cli.synthesis.geometry import (
    STATIC_TOLERANCE,
    TURN_PER_SLOT,
    SlotField,
    displacement,
    reproject,
    settle_motion,
)
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS
from exwarp_cli.synthesis.warp import fill_background, warp
from tests.bench.street import key_frame
from tests.bench.timing import ROUNDS, Work, compare, print_ratios

SLOT, TIME = 2, 0.5
GOALS = {
    "gather + hole mask, RGB": "goal 2 (1 without the mask)",
    "gather + hole mask, RGBA": "goal 2 (1 without the mask)",
    "row_reach + splat": "goal 3",
    "ssim_map": "goal 0.125",
}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.bench_kernels", description=__doc__)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args(arguments)
    jit.set_threads(options.threads)
    cv2.setNumThreads(options.threads)
    raw = [key_frame(instant) for instant in (1, 2)]
    keys = [_settled(key) for key in raw]
    works = {**_warping(keys), **_geometry(raw[0], keys[0]), **_methods(keys)}
    title = f"1920x1080, float32, {options.threads} threads, {options.rounds} rounds"
    _table(title, "cv2.remap", works, options.rounds)
    reference, test = (np.ascontiguousarray(key.image.pixels[..., :3]) for key in raw)
    rounds = max(3, options.rounds // 3)  # these take seconds
    _table("SSIM", "scikit-image", _ssim(encode(reference), encode(test)), rounds)
    _table("score()", "score()", _scoring(reference, test), rounds)
    return 0


def _table(title: str, base: str, works: dict[str, tuple[Work, Work]], rounds: int) -> None:
    ratios = compare(works, rounds)
    print_ratios(title, base, {name: (r, GOALS.get(name, "")) for name, r in ratios.items()})


def _settled(key: KeyFrame) -> KeyFrame:
    return replace(key, gbuffer=settle_motion(_gbuffer(key)))


def _gbuffer(key: KeyFrame) -> GBuffer:
    assert key.gbuffer is not None
    return key.gbuffer


def _remap(image: Float32, field: Float32) -> Work:
    """Return OpenCV's work on the same field; a pixel without a source samples itself."""
    y, x = np.mgrid[0 : field.shape[0], 0 : field.shape[1]].astype(np.float32)
    at = np.stack([x, y], axis=-1) + np.nan_to_num(field)
    out = np.empty_like(image)
    return lambda: cv2.remap(image, at, None, cv2.INTER_LINEAR, out, cv2.BORDER_REPLICATE)


def _warping(keys: list[KeyFrame]) -> dict[str, tuple[Work, Work]]:
    """Colour along a motion field."""
    rgba = keys[0].image.pixels
    rgb = np.ascontiguousarray(rgba[..., :3])
    source = reproject(_gbuffer(keys[0]), TIME)
    base, base_rgba = _remap(rgb, source.field), _remap(rgba, source.field)
    warped = warp(rgb, source)
    return {
        "cv2.remap, RGBA": (base_rgba, base),
        "gather + hole mask, RGB": (_gather(rgb, source), base),
        "gather + hole mask, RGBA": (_gather(rgba, source), base_rgba),
        "warp(), RGB": (lambda: warp(rgb, source), base),
        "warp(), RGBA": (lambda: warp(rgba, source), base_rgba),
        "fill_background()": (lambda: fill_background(warped), base),
    }


def _gather(image: Float32, source: SlotField) -> Work:
    out, hole = np.empty_like(image), np.empty(image.shape[:2], np.bool_)
    return lambda: gather.gather_bilinear(image, source.field, out, hole)


def _geometry(raw: KeyFrame, settled: KeyFrame) -> dict[str, tuple[Work, Work]]:
    """Motion fields and hole masks."""
    buffers, moving = _gbuffer(raw), _gbuffer(settled)
    motion, depth, stencil = displacement(moving, TIME), buffers.depth, buffers.stencil
    assert depth is not None and stencil is not None and buffers.to_next is not None
    field, near = np.empty_like(motion), np.empty_like(depth)
    reach = np.empty((depth.shape[0], 2), np.float32)
    edge, mask, out = np.empty(depth.shape, np.bool_), np.empty(depth.shape, np.bool_), motion * 0
    splat.row_reach(motion, reach)
    source = reproject(moving, TIME)
    edges.find_edges(depth, stencil, edge)
    tolerance = np.float32(STATIC_TOLERANCE)
    vectors, rigid = buffers.to_next, moving.to_next

    def splat_all() -> None:
        splat.row_reach(motion, reach)
        splat.splat(motion, depth, reach, field, near)

    cosine = np.float32(np.cos(SLOT * TURN_PER_SLOT))
    pairs = [(a, a) for a in (depth, stencil, buffers.position, buffers.normal)]
    works: dict[str, Work] = {
        "row_reach": lambda: splat.row_reach(motion, reach),
        "row_reach + splat": splat_all,
        "mark": lambda: holes.mark(source.field, *pairs, cosine, mask),
        "find_edges": lambda: edges.find_edges(depth, stencil, edge),
        "unmix": lambda: edges.unmix(vectors, rigid, depth, stencil, edge, tolerance, out),
        "find_fringe": lambda: edges.find_fringe(source.field, source.depth, depth, mask),
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

    alone = [method.name for method in METHODS.values() if not method.extrapolates]
    return {f"{name}, a whole slot": (predict(name), base) for name in alone}


def _ssim(reference: Float32, test: Float32) -> dict[str, tuple[Work, Work]]:
    """Return SSIM maps of display-encoded images."""
    doubles = [image.astype(np.float64) for image in (reference, test)]

    def peer() -> object:
        return structural_similarity(
            *doubles,
            channel_axis=-1,
            gaussian_weights=True,
            sigma=SIGMA,
            use_sample_covariance=False,
            data_range=PEAK,
            full=True,
        )

    return {
        "ssim_map": (lambda: ssim_map(reference, test), peer),
        "ssim_map, one thread": (lambda: ssim_map(reference, test, threads=False), peer),
    }


def _scoring(reference: Float32, test: Float32) -> dict[str, tuple[Work, Work]]:
    """Parts of a frame's score."""
    shown, judged = encode(reference), encode(test)

    def whole() -> object:
        return score(reference, test, None)

    return {
        "encode, both frames": (lambda: (encode(reference), encode(test)), whole),
        "PSNR": (lambda: psnr.measure(shown, judged).overall(), whole),
        "SSIM": (lambda: ssim.measure(shown, judged).overall(), whole),
        "FLIP": (lambda: flip.measure(shown, judged).overall(), whole),
    }


if __name__ == "__main__":
    sys.exit(main())
