"""Render the market example: key frames, ground truth and slot G-buffers, with Blender's module.

    python examples/scenes/market.py --what all --out examples/market

keys
    9 multi-layer frames of a true 30 fps scene (vectors span 1/30 s): what a user would have.
truth
    33 colour frames at 120 fps; frame 4k + 1 shows the instant of key k + 1.
gbuffers
    33 multi-layer frames at 120 fps (vectors span 1/120 s) with few samples, whose data passes
    serve as slot G-buffers. They are large and go to the user's cache folder.

Frames that exist are kept, so an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import market_scene
from stage import render
from stage.blender import bpy
from stage.looks import AOVS
from stage.options import count, size
from stage.shooting import default_data, say

NAME = "market"
SEED = 7
QUALITY = 98
"""Of lossy compression (DWAA), percent: the truth stays within 65 dB of what was rendered."""

MAGIC = b"\x76\x2f\x31\x01"
INSTANTS_PER_KEY = 4
GBUFFER_SAMPLES = 32
DATA_PASSES = (
    "z",
    "vector",
    "normal",
    "position",
    "object_index",
    "diffuse_color",
    "glossy_color",
)


@dataclass(frozen=True)
class Product:
    """One kind of frames.

    Attributes
    ----------
    frames : int
        How many.
    step : int
        How far apart, in instants of 1/120 s.
    data : bool
        Whether they hold the data passes, or colour alone.
    codec : str
        Blender's name of the compression. PXR24 keeps 24 of the 32 bits of a data pass, the others
        are sampling noise that nothing can compress: 1.4 MB a frame instead of 2.4.
    samples : int
        Most samples per pixel.
    """

    frames: int
    step: int
    data: bool
    codec: str
    samples: int


def products(samples: int) -> dict[str, Product]:
    """Describe what `--what` may name; `samples` counts for colour."""
    instants = market_scene.LAST_INSTANT
    return {
        "keys": Product(instants // INSTANTS_PER_KEY + 1, INSTANTS_PER_KEY, True, "PXR24", samples),
        "truth": Product(instants + 1, 1, False, "DWAA", samples),
        "gbuffers": Product(instants + 1, 1, True, "ZIP", min(samples, GBUFFER_SAMPLES)),
    }


def build(resolution: tuple[int, int]) -> None:
    """Build the scene and set what all products share."""
    market_scene.build(SEED)
    render.prepare(resolution)
    cycles = bpy.context.scene.cycles
    cycles.use_adaptive_sampling = True
    cycles.adaptive_threshold, cycles.adaptive_min_samples = 0.015, 32
    cycles.use_denoising = True


def configure(product: Product) -> None:
    """Set frame rate, passes and file format for one product."""
    scene = bpy.context.scene
    scene.render.fps = 120 // product.step
    # A true low-rate scene: frame f shows instant f * step, and vectors span a whole step.
    scene.render.frame_map_old, scene.render.frame_map_new = product.step, 1
    scene.cycles.samples = product.samples
    layer = scene.view_layers[0]
    for name in DATA_PASSES:
        setattr(layer, f"use_pass_{name}", product.data)
    for aov in list(layer.aovs):
        layer.aovs.remove(aov)
    for name in AOVS if product.data else ():
        added = layer.aovs.add()
        added.name, added.type = name, "VALUE"
    image = scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE" if product.data else "IMAGE"
    image.file_format = "OPEN_EXR_MULTILAYER" if product.data else "OPEN_EXR"
    if not product.data:
        image.color_mode = "RGB"
    image.color_depth = "16"
    image.exr_codec = product.codec
    image.quality = QUALITY


def is_exr(path: Path) -> bool:
    """Say whether the file exists and starts like an EXR file."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def render_product(what: str, product: Product, folder: Path, seed: int) -> None:
    """Render all missing frames of one product, with progress and the time left."""
    folder.mkdir(parents=True, exist_ok=True)
    targets = [folder / f"{NAME}.{frame + 1:04d}.exr" for frame in range(product.frames)]
    missing = [frame for frame, target in enumerate(targets) if not is_exr(target)]
    say(f"{what}: {len(targets) - len(missing)} of {len(targets)} frames are there, in {folder}")
    configure(product)
    started = time.monotonic()
    for done, frame in enumerate(missing, start=1):
        render.render(frame * product.step, product, targets[frame], seed)
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
    options = parse()
    for what, product in products(options.samples).items():
        if options.what in (what, "all"):
            build(options.resolution)  # anew, as Blender may crash when passes change
            base = options.gbuffers if what == "gbuffers" else options.out
            render_product(what, product, (base / what).resolve(), options.seed * 1000)


if __name__ == "__main__":
    main()
