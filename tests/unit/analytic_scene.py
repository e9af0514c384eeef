"""A data set's scene on disk whose content is known exactly: `scenes.town` as Blender writes it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.unit.exr_files import write_parts
from tests.unit.scenes import SKY, Rectangle, Scene, View, town, vec

INSTANTS = 17
STEP = 0.25
MOTION = "previous=X,-Y next=-Z,W"
MIRROR = vec(-1, 1, 1)


def manifest(name: str = "analytic", count: int = INSTANTS, **changes: object) -> dict:
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
            "count": (count - 1) // 4 + 1,
            "step": 4,
        },
    }
    return content | changes


def write_scene(folder: Path, instants: int = INSTANTS, **changes: object) -> Path:
    """Write a scene's folder; `changes` go to the manifest."""
    name = str(changes.get("scene", "analytic"))
    for kind, count, step in (("instants", instants, STEP), ("keys", (instants - 1) // 4 + 1, 1.0)):
        (folder / kind).mkdir(parents=True, exist_ok=True)
        for index in range(count):
            path = folder / kind / f"{name}.{index + 1:04d}.exr"
            write_parts(path, _parts(town().view(index * step), step))
    write_manifest(folder, manifest(name, instants, **changes))
    return folder


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


def mirror_image(scene: Scene) -> Scene:
    """The scene reflected at the plane x = 0, with its camera."""

    def reflected(quad: Rectangle) -> Rectangle:
        # u and v change places, so that the normal u x v is the reflected one.
        waves = quad.waves
        return replace(
            quad,
            origin=quad.origin * MIRROR,
            u=quad.u * MIRROR,
            v=quad.v * MIRROR,
            velocity=quad.velocity * MIRROR,
            waves=waves,
        )

    camera = scene.camera
    reflected_camera = replace(
        camera,
        start=camera.start * MIRROR,
        velocity=camera.velocity * MIRROR,
        acceleration=camera.acceleration * MIRROR,
        yaw=-camera.yaw,
    )
    return replace(scene, quads=tuple(map(reflected, scene.quads)), camera=reflected_camera)


def _parts(view: View, step: float) -> dict:
    gbuffer, more = view.gbuffer(step=step), surface(view)
    before, after = gbuffer.to_previous, gbuffer.to_next
    vector = np.stack([before[..., 0], -before[..., 1], -after[..., 0], after[..., 1]], axis=-1)
    layers = {
        "Combined": ("RGBA", view.colour.astype(np.float16)),
        "Depth": ("Z", np.where(np.isinf(gbuffer.depth), 1e10, gbuffer.depth)),
        "Position": ("XYZ", gbuffer.position),
        "Normal": ("XYZ", gbuffer.normal),
        "Vector": ("XYZW", vector),
        "Object Index": ("X", gbuffer.stencil),
        "Diffuse Color": ("RGB", more["albedo"].astype(np.float16)),
        "Glossy Color": ("RGB", more["specular"].astype(np.float16)),
        "Roughness": ("X", more["roughness"]),
        "Metallic": ("X", more["metallic"]),
    }
    parts = {}
    for name, (letters, image) in layers.items():
        planes = image[..., None] if image.ndim == 2 else image
        kind = image.dtype if image.dtype == np.float16 else np.float32
        named = {
            f"ViewLayer.{name}.{letter}": np.ascontiguousarray(planes[..., i].astype(kind))
            for i, letter in enumerate(letters)
        }
        parts[f"ViewLayer.{name}"] = (named, {})
    return parts
