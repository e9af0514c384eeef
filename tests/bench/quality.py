"""Quality of every method, with and without vectors, and of two colour-only interpolators.

All are scored on the same frames.

``python -m tests.bench.quality``: without options, on the rendered example.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.metric import DEFAULT_METRICS
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.generated_frames import read_picture
from exwarp_cli.io.sequences import find_sequence
from exwarp_cli.metrics.registry import score_frame
from exwarp_cli.pipeline.run import upsample
from exwarp_cli.synthesis.methods import METHODS
from tests.bench.peers import Frames, dis_flow, minterpolate, to_bytes

OWN = ("hold", "blend", "s6", "causal", "softsplat")
PEERS = {"ffmpeg minterpolate": minterpolate, "OpenCV DIS flow": dis_flow}
KINDS = {True: "look-ahead", False: "causal"}


def main(arguments: Sequence[str] | None = None) -> int:
    options = _options(arguments)
    keys, truth = _frames(options.keys), _frames(options.truth)
    made = {name: _own(name, options.keys, options.gbuffers, len(keys)) for name in OWN}
    made["no vectors"] = _estimated(keys)
    made |= {name: peer(keys) for name, peer in PEERS.items()}
    wanted = {
        (k, i): truth[FACTOR * k + i]
        for k in range(len(keys) - 1)
        for i in range(1, FACTOR)
        if FACTOR * k + i < len(truth)
    }
    shared = sorted(set(wanted).intersection(*made.values()))
    for name, frames in made.items():
        if absent := [slot for slot in wanted if slot not in frames]:
            print(f"{name} does not make (key, slot) {absent}: left out for every row")
    rows = {name: _mean(frames, wanted, shared) for name, frames in made.items()}
    _print(rows, options.keys, len(shared), truth[0].shape)
    if options.json is not None:
        table = {"keys": options.keys, "frames": len(shared), "quality": rows}
        options.json.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
    return 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m tests.bench.quality", description=__doc__)
    examples = sorted(Path("examples").glob("*/keys"))
    parser.add_argument("--keys", default=str(examples[0]) if examples else None)
    parser.add_argument("--truth", help="at the output rate; default: 'truth' beside the keys")
    parser.add_argument("--gbuffers", help="slot G-buffers for exwarp's methods")
    parser.add_argument("--json", type=Path, help="also write the table there")
    options = parser.parse_args(arguments)
    if options.keys is None:
        parser.error("there is no examples/*/keys; give --keys and --truth")
    if options.truth is None:
        options.truth = str(Path(options.keys).with_name("truth"))
    return options


def _frames(spec: str) -> list[Float32]:
    """Read a sequence's colour, float32 [H, W, 3], scene-linear."""
    sequence = find_sequence(spec)
    return [shown_pixels(sequence.files[number]) for number in sequence.numbers]


def shown_pixels(path: Path) -> Float32:
    """Read the colour of a frame's display window, float32 [H, W, 3], scene-linear."""
    image = read_picture(path)
    return np.ascontiguousarray(image.on(image.display_window).pixels[..., :3])


def _own(method: str, keys: str, gbuffers: str | None, count: int) -> Frames:
    """Make frames with exwarp, through files as a user does."""
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        return _upsampled(UpsampleSettings(SourceSettings(keys, gbuffers), folder, method), count)


def _estimated(keys: Sequence[Float32]) -> Frames:
    """Make frames of the key frames' beauty alone, as stills of 8 bits."""
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        stills, out = Path(folder) / "keys", Path(folder) / "out"
        stills.mkdir()
        for number, linear in enumerate(keys, 1):
            Image.fromarray(to_bytes(linear)).save(stills / f"key.{number:04d}.png")
        return _upsampled(UpsampleSettings(SourceSettings(str(stills)), str(out)), len(keys))


def _upsampled(settings: UpsampleSettings, count: int) -> Frames:
    """Read what is made between so many key frames."""
    return {
        (index // FACTOR, record.slot): shown_pixels(Path(settings.output) / record.file)
        for index, record in enumerate(upsample(settings).frames)
        if record.slot and index // FACTOR < count - 1
    }


def _mean(frames: Frames, truth: Frames, slots: list[tuple[int, int]]) -> dict[str, float]:
    scores = [score_frame(truth[slot], frames[slot], None)[0] for slot in slots]
    return {name: float(np.mean([getattr(s, name) for s in scores])) for name in DEFAULT_METRICS}


def _print(
    rows: dict[str, dict[str, float]], keys: str, frames: int, shape: tuple[int, ...]
) -> None:
    print(f"{keys}: mean of {frames} frames between key frames, {shape[1]}x{shape[0]}, all pixels")
    print(f"{'method':22}{'uses':12}{'PSNR dB':>9}{'SSIM':>9}{'FLIP':>9}{'pulse %':>9}")
    for name, row in rows.items():
        uses = KINDS[METHODS[name].lookahead if name in METHODS else True]
        print(
            f"{name:22}{uses:12}{row['psnr_db']:9.2f}{row['ssim']:9.4f}{row['flip']:9.4f}"
            f"{row['pulse']:+9.2f}",
        )


if __name__ == "__main__":
    sys.exit(main())
