"""Cycles set up for instants and for the vectors of key frames, and one frame rendered."""

from __future__ import annotations

import functools
import importlib
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from stage.blender import bpy
from stage.looks import AOVS
from stage.quality import HURRIED, Quality

PASSES = (
    "z",
    "vector",
    "normal",
    "position",
    "object_index",
    "diffuse_color",
    "glossy_color",
)
VECTOR_SAMPLES = 8
"""For a key frame's vectors alone; they are exact but for the mixing at silhouettes."""


@dataclass(frozen=True)
class Product:
    """One kind of frames.

    Attributes
    ----------
    step : int
        How far their vectors reach, in instants.
    passes : tuple of str
        Data passes beside colour.
    shaded : bool
        Whether there is light; then data passes come with the materials' own AOVs.
    samples : int
        Per pixel.
    """

    step: int
    passes: tuple[str, ...]
    shaded: bool
    samples: int


def products(samples: int, step: int) -> dict[str, Product]:
    """Return what a scene consists of: instants, some of them again, vectors over `step`."""
    instants = Product(1, PASSES, True, samples)
    return {
        "instants": instants,
        "floor": instants,
        "keys": Product(step, ("vector",), False, min(samples, VECTOR_SAMPLES)),
    }


def prepare(size: tuple[int, int]) -> None:
    """Set engine, size (width, height), denoiser, bounces and noise of a newly built scene."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.render.use_motion_blur = False  # with blur there is no Vector pass
    scene.render.use_persistent_data = True
    scene.view_settings.view_transform = "Standard"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.denoiser = "OPENIMAGEDENOISE"
    drop_noisy_image()
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 4, 2, 3
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.sample_clamp_indirect = 3.0
    cycles.use_animated_seed = False


def settle(size: tuple[int, int], quality: Quality = HURRIED, on_gpu: bool = False) -> None:
    """Set what all frames of the long scenes share; see `prepare`.

    Parameters
    ----------
    size : tuple of int
        Width and height.
    quality : Quality
        How lights are sampled and noise is taken out.
    on_gpu : bool
        Whether NVIDIA cards render and denoise.

    Raises
    ------
    SystemExit
        With one sentence, when there is no such card.
    """
    prepare(size)
    if on_gpu:
        _use_gpu()
    scene = bpy.context.scene
    cycles = scene.cycles
    cycles.use_adaptive_sampling = False
    cycles.use_light_tree = quality.light_tree
    cycles.sample_clamp_direct = quality.clamp
    cycles.denoising_prefilter = "ACCURATE" if quality.accurate else "FAST"
    cycles.transmission_bounces, cycles.transparent_max_bounces = 2, 4
    for material in bpy.data.materials:
        material.cycles.emission_sampling = "NONE"
    if scene.world is not None and scene.world.cycles.sampling_method == "AUTOMATIC":
        # Made anew for every frame; at the size that Blender chooses it took 0.2 s of two cores.
        scene.world.cycles.sampling_method = "MANUAL"
        scene.world.cycles.sample_map_resolution = 64
    image = scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format = "OPEN_EXR_MULTILAYER"
    image.color_depth = "16"
    image.exr_codec = "PXR24"  # keeps 24 bits of a data pass; the others are sampling noise


def _use_gpu() -> None:
    preferences = bpy.context.preferences.addons["cycles"].preferences
    preferences.compute_device_type = "CUDA"
    preferences.refresh_devices()
    for device in preferences.devices:
        device.use = device.type == "CUDA"
    if not any(device.use for device in preferences.devices):
        sys.exit("--gpu: Blender finds no NVIDIA card that CUDA can use; leave the option out.")
    bpy.context.scene.cycles.device = "GPU"


def drop_noisy_image() -> None:
    """Keep the layer that denoising adds by itself, "Noisy Image", out of the files."""
    engine = importlib.import_module("cycles.engine")
    listed = getattr(engine.list_render_passes, "__wrapped__", engine.list_render_passes)

    @functools.wraps(listed)
    def without(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> Iterator[tuple]:
        return (layer_pass for layer_pass in listed(scene, layer) if layer_pass[0] != "Noisy Image")

    engine.list_render_passes = without


def configure(product: Product, fps: int) -> None:
    """Set rate, passes and shading for one kind of frames; `fps` is that of the instants."""
    scene = bpy.context.scene
    scene.cycles.samples = product.samples
    scene.cycles.use_denoising = product.shaded
    # Bounces are light alone; through glass, to which these do not apply, data passes look anyway.
    scene.cycles.diffuse_bounces = scene.cycles.glossy_bounces = 4 if product.shaded else 0
    choose_passes(product, fps, AOVS if product.shaded and product.passes else ())


def choose_passes(product: Product, fps: int, aovs: Iterable[str]) -> None:
    """Set the rate, and which passes and AOVs of materials are written, whatever the engine."""
    scene = bpy.context.scene
    scene.render.fps = fps // product.step
    # A true low-rate scene: frame f shows instant f * step, and vectors span a whole step.
    scene.render.frame_map_old, scene.render.frame_map_new = product.step, 1
    layer = scene.view_layers[0]
    for name in PASSES:
        setattr(layer, f"use_pass_{name}", name in product.passes)
    for aov in list(layer.aovs):
        layer.aovs.remove(aov)
    for name in aovs:
        added = layer.aovs.add()
        added.name, added.type = name, "VALUE"


def render(instant: int, product: Product, target: Path, seed: int) -> None:
    """Render one frame to a file, which appears only once it is whole.

    Parameters
    ----------
    instant : int
        From 0.
    product : Product
        What is rendered; the scene is configured for it.
    target : Path
        The file to write.
    seed : int
        Of the noise at instant 0; each instant has its own.
    """
    scene = bpy.context.scene
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".part-") as folder, quiet():
        part = Path(folder, target.name)
        frame, between = divmod(instant, product.step)
        scene.frame_set(frame, subframe=between / product.step)
        scene.cycles.seed = seed + instant
        scene.render.filepath = str(part)
        bpy.ops.render.render(write_still=True)
        part.replace(target)


@contextmanager
def quiet(*streams: int) -> Iterator[None]:
    """Keep Blender's own lines, several a frame, off standard output, or off other streams."""
    kept = {stream: os.dup(stream) for stream in streams or (1,)}
    try:
        with Path(os.devnull).open("wb") as nowhere:
            for stream in kept:
                os.dup2(nowhere.fileno(), stream)
        yield
    finally:
        for stream, copy in kept.items():
            os.dup2(copy, stream)
            os.close(copy)
