"""Render the market example: key frames, ground truth and slot G-buffers, with Blender's module.

    python examples/scenes/market.py --what all --out examples/market

keys
    9 multi-layer frames of a true 30 fps scene (vectors span 1/30 s): what a user would have.
truth
    33 colour frames at 120 fps; frame 4k + 1 shows the instant of key k + 1.
gbuffers
    33 multi-layer frames at 120 fps (vectors span 1/120 s) with few samples, whose data passes
    serve as slot G-buffers. They are large and go to the user's cache folder.

Frames that are there and whole are kept, so an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import market_scene
from stage import files, render
from stage.blender import bpy
from stage.manifest import INSTANTS_PER_KEY, default_data
from stage.motion import FPS
from stage.options import count, size
from stage.shooting import say

NAME = "market"
SEED = 7
QUALITY = 98
"""Of lossy compression (DWAA), percent: the truth stays within 65 dB of what was rendered."""

GBUFFER_SAMPLES = 32


@dataclass(frozen=True)
class Kind:
    """One kind of frames.

    Attributes
    ----------
    product : stage.render.Product
        How they are rendered; without passes they hold colour alone.
    codec : str
        Blender's name of the compression. PXR24 keeps 24 of the 32 bits of a data pass, the others
        are sampling noise that nothing can compress: 1.4 MB a frame instead of 2.4.
    """

    product: render.Product
    codec: str

    @property
    def frames(self) -> int:
        """How many."""
        return market_scene.LAST_INSTANT // self.product.step + 1


def kinds(samples: int) -> dict[str, Kind]:
    """Describe what `--what` may name; `samples` counts for colour."""
    few = min(samples, GBUFFER_SAMPLES)
    return {
        "keys": Kind(render.Product(INSTANTS_PER_KEY, render.PASSES, True, samples), "PXR24"),
        "truth": Kind(render.Product(1, (), True, samples), "DWAA"),
        "gbuffers": Kind(render.Product(1, render.PASSES, True, few), "ZIP"),
    }


def build(resolution: tuple[int, int]) -> None:
    """Build the scene and set what all products share."""
    market_scene.build(SEED)
    render.prepare(resolution)
    cycles = bpy.context.scene.cycles
    cycles.use_adaptive_sampling = True
    cycles.adaptive_threshold, cycles.adaptive_min_samples = 0.015, 32


def configure(kind: Kind) -> None:
    """Set frame rate, passes and file format for one kind of frames."""
    render.configure(kind.product, FPS)
    data = bool(kind.product.passes)
    image = bpy.context.scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE" if data else "IMAGE"
    image.file_format = "OPEN_EXR_MULTILAYER" if data else "OPEN_EXR"
    if not data:
        image.color_mode = "RGB"
    image.color_depth = "16"
    image.exr_codec = kind.codec
    image.quality = QUALITY


def render_kind(what: str, kind: Kind, folder: Path, chosen: argparse.Namespace) -> None:
    """Render all missing frames of one kind, with progress and the time left."""
    folder.mkdir(parents=True, exist_ok=True)
    targets = [folder / f"{NAME}.{frame + 1:04d}.exr" for frame in range(kind.frames)]
    missing = [
        frame
        for frame, target in enumerate(targets)
        if not files.is_whole(target, chosen.resolution)
    ]
    say(f"{what}: {len(targets) - len(missing)} of {len(targets)} frames are there, in {folder}")
    configure(kind)
    started = time.monotonic()
    for done, frame in enumerate(missing, start=1):
        instant = frame * kind.product.step
        render.render(instant, kind.product, targets[frame], chosen.seed * 1000)
        pace = (time.monotonic() - started) / done
        left = pace * (len(missing) - done)
        say(f"{what}: {targets[frame].name}  {pace:.1f} s a frame, {left / 60:.1f} min left")


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--what", choices=("keys", "truth", "gbuffers", "all"), default="all")
    folder = Path(__file__).parents[1] / NAME
    add("--out", type=Path, default=folder, help="gets keys/ and truth/ (default: %(default)s)")
    folder = default_data() / NAME
    add("--gbuffers", type=Path, default=folder, help="gets gbuffers/ (default: %(default)s)")
    add("--resolution", type=size, default=(320, 180), metavar="WxH", help="default: 320x180")
    add("--samples", type=count, default=512, help="most samples per pixel (default: 512)")
    add("--seed", type=count, default=SEED, help="of the noise; the scene stays (default: 7)")
    return parser.parse_args()


def main() -> None:
    """Render what was asked for."""
    chosen = parse()
    for what, kind in kinds(chosen.samples).items():
        if chosen.what in (what, "all"):
            build(chosen.resolution)  # anew, as Blender may crash when passes change
            base = chosen.gbuffers if what == "gbuffers" else chosen.out
            render_kind(what, kind, (base / what).resolve(), chosen)


if __name__ == "__main__":
    main()
