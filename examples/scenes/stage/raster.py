"""EEVEE, Blender's raster engine, set up as a game engine is; it takes the place of `render`.

A frame is rendered several times wider and higher, with one sample at each pixel's centre. Colour
is the mean of these samples; a data pass holds the sample at the final pixel's centre. Samples of
EEVEE's own cost more in software: each renders its shadows again. Clean frames take four of
them all the same, as the noise of shadows and reflections asks for it.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stage import render as path_tracer
from stage.blender import bpy
from stage.files import View, reduce_grid
from stage.looks import AOVS
from stage.quality import Raster
from stage.render import Product

INDEX = "Object Index"
"""An AOV of all materials, for EEVEE has no such pass: the id plus 1, so that the sky is 0."""

PASSES = ("z", "vector", "normal", "position", "diffuse_color", "glossy_color")

CENTRE = 0.01
"""Width of a filter, in pixels, that puts every sample at its pixel's centre."""

WIDEST_SUN, WIDEST_LAMP = math.radians(1.0), 0.04
"""Greatest apparent size of a sun, radians, and radius of a lamp, metres."""

FLOOR = 4
"""How many times the samples the frame has that others are compared with."""


@dataclass(frozen=True)
class RasterProduct(Product):
    """One kind of frames.

    Attributes
    ----------
    grid : int
        Samples along each side of a pixel; odd, so that one lies at its centre.
    """

    grid: int = 1


def products(samples: int, step: int) -> dict[str, RasterProduct]:
    """Return what a scene consists of; see `render.products`."""
    look = Raster(samples)
    return {
        "instants": RasterProduct(1, PASSES, True, look.own, look.grid),
        "floor": RasterProduct(1, PASSES, True, FLOOR * look.own, look.grid),
        "keys": RasterProduct(step, ("z", "vector"), False, 1),
    }


def settle(size: tuple[int, int], _: Raster | None = None, on_gpu: bool = False) -> None:
    """Set what all frames share; `size` is (width, height) of the written frames.

    `on_gpu` is without effect: EEVEE renders where OpenGL does.
    """
    path_tracer.settle(size)
    scene = bpy.context.scene
    scene.render.engine = "BLENDER_EEVEE"
    scene["size"] = size
    eevee = scene.eevee
    eevee.use_fast_gi = True  # screen-space occlusion and bounced light
    eevee.ray_tracing_options.resolution_scale = "2"
    eevee.ray_tracing_options.trace_max_roughness = 0.5
    eevee.ray_tracing_options.screen_trace_quality = 0.5
    eevee.gi_cubemap_resolution = "256"
    # A shadow map's texel is two samples wide. At full size the arena took 1.8 times as long.
    eevee.shadow_resolution_scale = 0.5
    for lamp in bpy.data.lights:  # wide lights are noisy; games have sharp shadows, too
        if lamp.type == "SUN":
            lamp.angle = min(lamp.angle, WIDEST_SUN)
        elif lamp.type != "AREA":
            lamp.shadow_soft_size = min(lamp.shadow_soft_size, WIDEST_LAMP)
    for material in bpy.data.materials:
        _output_index(material)


def _output_index(material: bpy.types.Material) -> None:
    """Let a material write its object's id plus 1."""
    nodes, links = material.node_tree.nodes, material.node_tree.links
    if any(node.type == "OUTPUT_AOV" and node.aov_name == INDEX for node in nodes):
        return
    thing = nodes.new("ShaderNodeObjectInfo")
    raised = nodes.new("ShaderNodeMath")
    output = nodes.new("ShaderNodeOutputAOV")
    raised.inputs[1].default_value = 1.0
    output.aov_name = INDEX
    links.new(thing.outputs["Object Index"], raised.inputs[0])
    links.new(raised.outputs[0], output.inputs["Value"])


def configure(product: RasterProduct, fps: int) -> None:
    """Set rate, passes and effects for one kind of frames; `fps` is that of the instants."""
    path_tracer.choose_passes(product, fps, (*AOVS, INDEX))


def render(instant: int, product: RasterProduct, target: Path, seed: int) -> None:
    """Render one frame to a file, which appears only once it is whole.

    Parameters
    ----------
    instant : int
        From 0.
    product : RasterProduct
        What is rendered; the scene is configured for it.
    target : Path
        The file to write.
    seed : int
        Without effect: EEVEE's noise is the same in every frame.
    """
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".part-") as folder:
        colour, data = Path(folder, "colour.exr"), Path(folder, "data.exr")
        spread = product.samples > 1
        _sample(product.grid, product.samples, product.shaded)
        path_tracer.render(instant, product, colour, seed)
        if spread:  # over the pixel, where no data pass may be
            _sample(1, 1, False)
            path_tracer.render(instant, product, data, seed)
        exposure = bpy.context.scene.cycles.film_exposure
        reduced = Path(folder, target.name)
        reduce_grid(colour, data if spread else colour, reduced, _view(), exposure)
        reduced.replace(target)


def _sample(grid: int, samples: int, shaded: bool) -> None:
    """Set how often and where a pixel is sampled, and whether there are shadows and reflections."""
    scene = bpy.context.scene
    render, eevee = scene.render, scene.eevee
    render.resolution_x, render.resolution_y = (grid * side for side in scene["size"])
    # One sample lies at the centre of its pixel; several are spread over it.
    render.filter_size = CENTRE if samples == 1 else 1.0
    eevee.taa_render_samples = samples
    eevee.use_raytracing = eevee.use_shadows = shaded


def _view() -> View:
    """Return the camera of the frame that the scene is set to."""
    scene = bpy.context.scene
    camera = scene.camera
    graph = bpy.context.evaluated_depsgraph_get()
    placed = np.array(camera.evaluated_get(graph).matrix_world)
    width, height = scene["size"]
    return View(placed, math.tan(camera.data.angle_x / 2), (width, height))
