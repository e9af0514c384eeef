"""A data set's scene on disk whose content is known exactly: `scenes.town` as Blender writes it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from exwarp_cli.domain.timeline import FACTOR
from tests.blender_layers import HALF, Planes, blender_depth, blender_vector, layer, multipart
from tests.unit.exr_files import write_parts
from tests.unit.scenes import SKY, View, town

INSTANTS = 17
STEP = 0.25
MOTION = "previous=X,-Y next=-Z,W"


def manifest(
    name: str = "analytic", count: int = INSTANTS, key_step: int = FACTOR, **changes: object
) -> dict:
    """A manifest as the scenes' scripts write it."""
    scene = town()
    content = {
        "schema": "exwarp.scene/1",
        "scene": name,
        "role": "benchmark",
        "about": "Three walls and a box.",
        "instants": {"pattern": f"instants/{name}.####.exr", "first": 1, "count": count},
        "fps": 120,
        "key_fps": 30,
        "width": scene.size[0],
        "height": scene.size[1],
        "renderer": "rays",
        "samples": 1,
        "denoiser": "",
        "seed": 1,
        "motion": MOTION,
        "dynamic": {"3": "box"},
        "keys": {
            "pattern": f"keys/{name}.####.exr",
            "first": 1,
            "count": _keys(count, key_step),
            "step": key_step,
        },
    }
    return content | changes


def write_scene(
    folder: Path, instants: int = INSTANTS, key_step: int = FACTOR, **changes: object
) -> Path:
    """Write a scene's folder; `changes` go to the manifest."""
    name = str(changes.get("scene", "analytic"))
    kinds = (
        ("instants", instants, 1, STEP),
        ("keys", _keys(instants, key_step), key_step, FACTOR * STEP),
    )
    for kind, count, step, reach in kinds:
        (folder / kind).mkdir(parents=True, exist_ok=True)
        for index in range(count):
            path = folder / kind / f"{name}.{index + 1:04d}.exr"
            parts = multipart(_layers(town().view(index * step * STEP), reach))
            write_parts(path, {part: (planes, {}) for part, planes in parts.items()})
    write_manifest(folder, manifest(name, instants, key_step, **changes))
    return folder


def _keys(instants: int, key_step: int) -> int:
    return (instants - 1) // key_step + 1


def write_manifest(folder: Path, content: object) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "manifest.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def surface(view: View) -> dict[str, np.ndarray]:
    """Reflection colours, roughness and metallic, by surface."""
    index = view.surface
    shade = 0.2 + 0.15 * np.where(index == SKY, 0, index + 1)[..., None]
    return {
        "albedo": (shade * [1.0, 0.5, 0.25]).astype(np.float16).astype(np.float32),
        "specular": (shade * [0.125, 0.25, 0.5]).astype(np.float16).astype(np.float32),
        "roughness": (0.5 * shade[..., 0]).astype(np.float32),
        "metallic": (index % 2).astype(np.float32),
    }


def _layers(view: View, step: float) -> list[Planes]:
    gbuffer, more = view.gbuffer(step=step), surface(view)
    return [
        layer("Combined", "RGBA", view.colour, HALF),
        layer("Depth", "Z", blender_depth(gbuffer.depth)),
        layer("Position", "XYZ", gbuffer.position),
        layer("Normal", "XYZ", gbuffer.normal),
        layer("Vector", "XYZW", blender_vector(gbuffer.to_previous, gbuffer.to_next)),
        layer("Object Index", "X", gbuffer.stencil),
        layer("Diffuse Color", "RGB", more["albedo"], HALF),
        layer("Glossy Color", "RGB", more["specular"], HALF),
        layer("Roughness", "X", more["roughness"]),
        layer("Metallic", "X", more["metallic"]),
    ]
