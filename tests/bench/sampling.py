"""Which kernel colour is best sampled by, and in which light: one table for both methods.

``python -m tests.bench.sampling``: on the rendered example, every second key interval.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np

from exwarp_cli.domain.frame import Float32, KeyFrame
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import GEOMETRY, SURFACE, read_raw
from exwarp_cli.io.shot import open_shot
from exwarp_cli.kernels.resample import PHASES, RADIUS
from exwarp_cli.metrics.registry import score_frame
from exwarp_cli.pipeline.motion_convention import motion_names, parse_motion
from exwarp_cli.synthesis import warp
from exwarp_cli.synthesis.history import older_key_frames
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS
from exwarp_cli.synthesis.motion_fields import settle_motion
from tests.bench.quality import shown_pixels

Curve = Callable[[Float32], Float32]


def lanczos(radius: int) -> Curve:
    return lambda x: np.where(np.abs(x) < radius, np.sinc(x) * np.sinc(x / radius), 0)


def catmull_rom(x: Float32) -> Float32:
    size = np.abs(x)
    inner, outer = 1.5 * size**3 - 2.5 * size**2 + 1, -0.5 * size**3 + 2.5 * size**2 - 4 * size + 2
    return np.where(size < 1, inner, np.where(size < 2, outer, 0))


def bilinear(x: Float32) -> Float32:
    return np.maximum(1 - np.abs(x), 0)


KERNELS = {
    "bilinear": bilinear, "Catmull-Rom": catmull_rom,
    "Lanczos-2": lanczos(2), "Lanczos-3": lanczos(3),
}  # fmt: skip


def to_log(pixels: Float32) -> Float32:
    return np.asarray(np.sign(pixels) * np.log1p(np.abs(pixels)))


def from_log(codes: Float32) -> Float32:
    return np.asarray(np.sign(codes) * np.expm1(np.abs(codes)))


LIGHTS = {
    "linear": (np.copy, np.asarray), "log": (to_log, from_log),
    "as shown": (warp.linear_to_srgb, warp.srgb_to_linear),
}  # fmt: skip
"""Codes of scene-linear colour, and back. Those of alpha are taken for colour's."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser("python -m tests.bench.sampling", description=__doc__)
    parser.add_argument("--keys", default="examples/market/keys")
    parser.add_argument("--truth", default="examples/market/truth")
    options = parser.parse_args(arguments)
    shot, truth = open_shot(options.keys), open_shot(options.truth)
    convention = parse_motion(
        "previous=X,-Y next=-Z,W", motion_names(shot), (shot.display.width, shot.display.height)
    )
    keys = []
    for number in shot.sequence.numbers:
        frame = read_raw(shot, number, (Role.COLOUR, *GEOMETRY, *SURFACE)).key(convention)
        assert frame.gbuffer is not None
        keys.append(replace(frame, gbuffer=settle_motion(frame.gbuffer)))
    files = [truth.sequence.files[number] for number in truth.sequence.numbers]
    print("| kernel | light | softsplat: PSNR dB, SSIM, pulse % | s6 |\n|---|---|---|---|")
    for light, (codes, back) in LIGHTS.items():
        for name, kernel in KERNELS.items():
            with (
                mock.patch.object(warp, "LANCZOS", _weights(kernel)),
                mock.patch.object(warp, "as_shown", codes),
                mock.patch.object(warp, "as_light", back),
            ):
                cells = [_cell(method, keys, files) for method in ("softsplat", "s6")]
            print(f"| {name} | {light} | {' | '.join(cells)} |", flush=True)


def _weights(kernel: Curve) -> Float32:
    """Return what `lanczos_weights` returns, of another kernel; its values need not sum to 1."""
    offset = np.arange(1 - RADIUS, RADIUS + 1)[None] - np.arange(PHASES + 1)[:, None] / PHASES
    weights = kernel(offset)
    weights /= weights.sum(axis=1, keepdims=True)
    weights[[0, -1]] = 0
    weights[0, RADIUS - 1] = weights[-1, RADIUS] = 1
    return weights.astype(np.float32)


def _cell(method: str, keys: Sequence[KeyFrame], truth: Sequence[Path]) -> str:
    """Return mean PSNR, SSIM and pulse of every second key interval's frames."""
    rows = []
    for k in range(2, len(keys) - 1, 2):
        past = older_key_frames(keys[k - 2 : k + 1][::-1])
        interval = Interval(keys[k], keys[k + 1] if method == "softsplat" else None, past=past)
        for slot in range(1, FACTOR):
            wanted = shown_pixels(truth[FACTOR * k + slot])
            made = np.ascontiguousarray(METHODS[method].predict(interval, slot).pixels[..., :3])
            found = score_frame(wanted, made, None)[0]
            rows.append((found.psnr_db, found.ssim, found.pulse))
    psnr, ssim, pulse = np.mean(rows, axis=0)
    return f"{psnr:.2f}, {ssim:.3f}, {pulse:+.1f}"


if __name__ == "__main__":
    main()
