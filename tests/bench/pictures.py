"""Where frames are wrong: PSNR of each method in holes, at silhouettes, in changing light.

``python -m tests.bench.pictures --out FOLDER``: on the judged scenes, as far as they are rendered.
`--exwarp` names another version's command, for a table of before and after.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from exwarp_cli.domain.colour import encode_display
from exwarp_cli.domain.frame import Bool, GBuffer, Image
from exwarp_cli.domain.metric import DEFAULT_METRICS
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.dataset import RenderedScene, find_scenes
from exwarp_cli.metrics.registry import psnr_from_mse, score_frame
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.synthesis.motion_fields import SlotField
from exwarp_cli.synthesis.warp import sample_bilinear
from tests.bench.quality import shown_pixels

METHODS = ("s6", "softsplat", "causal")

PLACES = ("everywhere", "holes", "silhouettes", "light", "edges")
"""Where pixels are: holes of a warp from the key frame before; moving outlines and the pixels
around them; still surfaces whose light changes by more than `CHANGE`; the frame's edge."""

JUMP = 1.1
"""Factor between the depths of neighbours that are two surfaces."""

APART = 1.0
"""Pixels a key interval by which two surfaces must move apart for a moving outline."""

CHANGE = 6
"""Steps of 255 by which the mean of 5x5 pixels of a still surface changes where light moves.
"""

FAR = 1e6
"""Depth from which on there is sky."""

BORDER = 1 / 24
"""Width of the frame's edge, as a share of its height."""


def main(arguments: Sequence[str] | None = None) -> int:
    options = _options(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for scene in find_scenes(options.data, None if options.scenes else "benchmark", options.scenes):
        intervals = rendered_intervals(scene)
        if not intervals:
            continue
        footage = SceneClip(scene)
        places = {
            (k, slot): find_places(footage, k, slot)
            for k in range(intervals)
            for slot in range(1, FACTOR)
        }
        for method in options.methods:
            frames = options.out / scene.name / method
            if not frames.is_dir():
                _upsample(scene, method, frames, options)
            row = {"scene": scene.name, "method": method, **_judge(footage, frames, places)}
            rows.append(row)
            print(_line(row), flush=True)
    rows += [_mean(method, rows) for method in options.methods]
    for row in rows[-len(options.methods) :]:
        print(_line(row))
    (options.out / "pictures.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m tests.bench.pictures", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("~/.cache/exwarp/scenes").expanduser())
    parser.add_argument("--scenes", nargs="*", default=[])
    parser.add_argument("--methods", nargs="*", default=METHODS)
    parser.add_argument("--gbuffers", action="store_true", help="with G-buffers of the slots")
    parser.add_argument("--exwarp", default=str(Path(sys.executable).with_name("exwarp")))
    parser.add_argument("--out", type=Path, required=True, help="folder for frames and figures")
    return parser.parse_args(arguments)


def rendered_intervals(scene: RenderedScene) -> int:
    """Return how many key intervals, from the first on, are rendered in full."""
    keys, instants = scene.manifest.keys, scene.manifest.instants

    def is_there(folder: str, number: int) -> bool:
        return (scene.folder / folder / f"{scene.name}.{number:04d}.exr").is_file()

    count = 0
    while is_there("keys", keys.first + count + 1) and all(
        is_there("instants", instants.first + FACTOR * count + i) for i in range(FACTOR + 1)
    ):
        count += 1
    return count


def _upsample(scene: RenderedScene, method: str, out: Path, options: argparse.Namespace) -> None:
    """Make the frames of a scene as a user does, from the key frames that are rendered."""
    command = [options.exwarp, "upsample", str(scene.folder / "keys"), "-o", str(out)]
    command += ["--method", method, "--no-tail"]
    if options.gbuffers:
        command += ["--gbuffers", str(scene.folder / "instants")]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def find_places(footage: SceneClip, k: int, slot: int) -> dict[str, Bool]:
    """Find the pixels of a slot, bool [H, W], that each of `PLACES` consists of.

    Parameters
    ----------
    footage
        With ground truth of the slot.
    k
        Key interval.
    slot
        1 to 3.
    """
    interval = footage.interval(k, "slot")
    back, forward = interval.back(slot), interval.forward(slot)
    gbuffer = interval.slots[slot - 1]
    outline = _moving_outline(gbuffer)
    truth, after = footage.truth(k, slot), interval.following
    assert after is not None
    changes = _changes(truth, interval.key.image, back) | _changes(truth, after.image, forward)
    still = _stands_still(gbuffer) & ~back.hole & ~forward.hole & ~outline
    edge = np.ones_like(outline)
    width = max(1, round(BORDER * len(edge)))
    edge[width:-width, width:-width] = False
    found = np.ones_like(edge), back.hole, outline, still & changes, edge
    return dict(zip(PLACES, found, strict=True))


def _moving_outline(gbuffer: GBuffer) -> Bool:
    """Find pixels within 2 of where two surfaces meet that move apart."""
    assert gbuffer.depth is not None and gbuffer.to_previous is not None
    depth = np.minimum(gbuffer.depth, np.float32(FAR))
    # Settled motion is that of one surface each, never a mixture.
    motion = FACTOR * np.nan_to_num(gbuffer.to_previous)
    jumps = ndimage.maximum_filter(depth, 3) > JUMP * ndimage.minimum_filter(depth, 3)
    spread = [
        ndimage.maximum_filter(motion[..., axis], 3) - ndimage.minimum_filter(motion[..., axis], 3)
        for axis in (0, 1)
    ]
    outline: Bool = ndimage.binary_dilation(jumps & (np.hypot(*spread) > APART))
    return outline


def _stands_still(gbuffer: GBuffer) -> Bool:
    """Find surfaces with nothing that moves within 2 pixels."""
    assert gbuffer.stencil is not None and gbuffer.depth is not None
    still: Bool = (ndimage.maximum_filter(gbuffer.stencil, 5) == 0) & (gbuffer.depth < FAR)
    return still


def _changes(truth: Image, key: Image, field: SlotField) -> Bool:
    """Find where a slot's truth differs from the same surfaces in a key frame."""
    moved, _ = sample_bilinear(encode_display(key.pixels), np.nan_to_num(field.field))
    difference = (moved - encode_display(truth.pixels)).mean(axis=-1)
    changes: Bool = np.abs(ndimage.uniform_filter(difference, 5)) > CHANGE
    return changes


def _judge(
    footage: SceneClip, folder: Path, places: dict[tuple[int, int], dict[str, Bool]]
) -> dict[str, float]:
    """Return PSNR in dB by place, its share of pixels, SSIM, FLIP and pulse of a scene's frames."""
    squares, counts = dict.fromkeys(PLACES, 0.0), dict.fromkeys(PLACES, 0)
    scores = []
    files = sorted(folder.glob("*.exr"))
    for (k, slot), found in places.items():
        truth = footage.truth(k, slot).pixels[..., :3]
        made = shown_pixels(files[FACTOR * k + slot])
        scores.append(score_frame(truth, made, None)[0])
        error = ((encode_display(made) - encode_display(truth)) ** 2).mean(axis=-1)
        for place, mask in found.items():
            squares[place] += float(error[mask].sum())
            counts[place] += int(mask.sum())
    row = {name: float(np.mean([getattr(s, name) for s in scores])) for name in DEFAULT_METRICS}
    for place in PLACES[1:]:
        row[place] = psnr_from_mse(squares[place] / counts[place]) if counts[place] else np.nan
        row[f"{place}_share"] = counts[place] / counts[PLACES[0]]
    return row


def _mean(method: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the mean over scenes of what one method has."""
    of_method = [row for row in rows if row["method"] == method]
    values = {
        key: float(np.nanmean([row[key] for row in of_method]))
        for key in of_method[0]
        if key not in ("scene", "method")
    }
    return {"scene": "mean", "method": method, **values}


def _line(row: dict[str, Any]) -> str:
    parts = [f"{row['scene']:10}{row['method']:10}"]
    parts.append(f"{row['psnr_db']:6.2f} dB {row['ssim']:.4f} {row['flip']:.4f}")
    parts.append(f"pulse {row['pulse']:+6.2f} %")
    parts += [f"{place} {row[place]:5.2f} ({row[f'{place}_share']:.1%})" for place in PLACES[1:]]
    return "  ".join(parts)


if __name__ == "__main__":
    sys.exit(main())
