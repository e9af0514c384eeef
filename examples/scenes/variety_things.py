"""Real things in a shot: shapes, running characters and textures of the list, in Blender."""

from __future__ import annotations

import random
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from stage import looks, render
from stage.blender import bpy, mathutils
from stage.looks import Nodes
from things_list import FIGURE, SHAPE, TEXTURE, Thing, ThingList

Matrix, Vector = mathutils.Matrix, mathutils.Vector
HAND = 7
"""Shapes that a shot chooses from: each takes some tenths of a second to load."""

DARK = 0.02
"""Brightness on the display below which a texture's pixel is black."""

SUITS = {
    "floor": ("floor",),
    "ground": ("floor",),
    "soil": ("floor",),
    "wall": ("wall", "trim"),
    "any": ("wall", "floor", "trim"),
    "metal": ("trim",),
}
"""By role of a material, which textures suit it."""


@dataclass(frozen=True)
class Body:
    """A running character.

    Attributes
    ----------
    points : ndarray
        Frames x n x 3, metres, feet at z = 0, facing x.
    faces, look : ndarray
        Triangles, and the number of the material of each.
    spread : ndarray
        Texture places, n x 2.
    materials : list
        As many as pictures.
    seconds : float
        Of one round of all frames.
    """

    points: np.ndarray
    faces: np.ndarray
    look: np.ndarray
    spread: np.ndarray
    materials: list[bpy.types.Material]
    seconds: float


class Stock:
    """What a shot takes from the list; without a list it gives nothing.

    Attributes
    ----------
    shown : dict of str to Thing
        By name, what was taken.
    """

    def __init__(self, listed: ThingList, seed: int, shapes: bool, textures: bool) -> None:
        self._folder = listed.folder
        self.chance = random.Random(f"real things {seed}")
        found = listed.of_kind(SHAPE) if shapes else []
        self._hand = self.chance.sample(found, min(HAND, len(found)))
        self._figures = listed.of_kind(FIGURE) if shapes else []
        self._textures = listed.of_kind(TEXTURE) if textures else []
        self._meshes: dict[str, bpy.types.Mesh | None] = {}
        self.shown: dict[str, Thing] = {}

    def shape(self, share: float = 1.0) -> bpy.types.Mesh | None:
        """Return a shape one metre long, standing at z = 0; None for an own one, by chance."""
        if not self._hand or self.chance.random() >= share:
            return None
        thing = self.chance.choice(self._hand)
        if thing.name not in self._meshes:
            self._meshes[thing.name] = _load(self._folder / thing.path)
        mesh = self._meshes[thing.name]
        if mesh is not None:
            self.shown[thing.name] = thing
        return mesh

    def figure(self, share: float = 1.0) -> Body | None:
        """Return a running character; None for an own one, by chance."""
        if not self._figures or self.chance.random() >= share:
            return None
        thing = self.chance.choice(self._figures)
        self.shown[thing.name] = thing
        return _body(self._folder, thing)

    def texture(self, role: str, share: float = 0.55) -> tuple[bpy.types.Image, float] | None:
        """Return a picture that tiles, and a factor for its colour; None for a pattern."""
        fits = [t for t in self._textures if t.title.split(":")[0] in SUITS.get(role, ())]
        if not fits or self.chance.random() >= share:
            return None
        for thing in self.chance.sample(fits, min(6, len(fits))):
            image = bpy.data.images.load(str(self._folder / thing.path), check_existing=True)
            if gain := _gain(image, self.chance.uniform(0.1, 0.4)):
                self.shown[thing.name] = thing
                return image, gain
        return None


def _gain(image: bpy.types.Image, wanted: float) -> float:
    """Return by what the picture is multiplied to reflect a wanted mean; 0 for a useless one."""
    values = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
    image.pixels.foreach_get(values)
    bright = values.reshape(-1, image.channels)[:, :3].mean(axis=1)
    if bright.size < 64 * 64 or (bright < DARK).mean() > 0.25 or bright.std() < 0.01:
        return 0.0
    mean = float((bright**2.2).mean())
    return min(8.0, max(0.6, wanted / max(mean, 1e-3)))


def paint_texture(nodes: Nodes, where: object, found: tuple[bpy.types.Image, float]) -> object:
    """Add a tiling picture at coordinates in tiles; return its colour."""
    image, gain = found
    colour = nodes.add("TexImage", {"Vector": where}, image=image).outputs["Color"]
    inputs = {0: 1.0, 6: colour, 7: (gain, gain, gain)}
    settings = {"data_type": "RGBA", "blend_type": "MULTIPLY", "clamp_result": True}
    return nodes.add("Mix", inputs, **settings).outputs[2]


def _load(path: Path) -> bpy.types.Mesh | None:
    """Load a shape; None where nothing usable is in the file."""
    there = set(bpy.data.objects)
    with render.quiet(1, 2):  # warnings of pictures that a thing's makers had, and we have not
        bpy.ops.wm.obj_import(filepath=str(path), use_split_objects=False, use_split_groups=False)
    loaded = [thing for thing in bpy.data.objects if thing not in there]
    if len(loaded) != 1 or not loaded[0].data.polygons:
        for thing in loaded:
            bpy.data.objects.remove(thing)
        return None
    mesh = loaded[0].data
    mesh.transform(loaded[0].matrix_world)
    bpy.data.objects.remove(loaded[0])
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    low, high = points.reshape(-1, 3).min(axis=0), points.reshape(-1, 3).max(axis=0)
    if not (high - low).max() > 0:
        return None
    foot = Vector(((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]))
    scale = Matrix.Scale(1 / float((high - low).max()), 4)
    mesh.transform(scale @ Matrix.Translation(-foot))
    for slot, material in enumerate(mesh.materials):
        mesh.materials[slot] = _dressed(material)
    mesh.name = path.stem
    return mesh


def _dressed(loaded: bpy.types.Material | None) -> bpy.types.Material:
    """Make a material of ours, with its data passes, out of a loaded one."""
    colour, image, rough, alpha = (0.6, 0.6, 0.6), None, 0.6, 1.0
    for node in loaded.node_tree.nodes if loaded is not None else ():
        if node.type == "BSDF_PRINCIPLED":
            colour = tuple(node.inputs["Base Color"].default_value)[:3]
            rough = node.inputs["Roughness"].default_value
            alpha = node.inputs["Alpha"].default_value
        elif node.type == "TEX_IMAGE" and node.image is not None and node.image.size[0]:
            image = image or node.image
    return picture_look(image, colour, max(0.08, rough), alpha)


def picture_look(
    image: bpy.types.Image | None,
    colour: tuple[float, ...] = (0.6, 0.6, 0.6),
    rough: float = 0.6,
    alpha: float = 1.0,
) -> bpy.types.Material:
    """Make a material that shows a picture at the mesh's own texture places, or a colour."""
    material, nodes = looks.new("real")
    shade: object = tuple(min(0.9, max(0.015, part)) for part in colour)
    if image is not None:
        shade = nodes.add("TexImage", {}, image=image).outputs["Color"]
    else:  # worn a little, so that its motion can be seen
        worn = nodes.step(nodes.noise(nodes.spot(), 5.0, 3.0), 0.35, 0.7)
        shade = nodes.mix(worn, shade, tuple(0.55 * part + 0.01 for part in shade))
    looks.finish(nodes, shade, rough).inputs["Alpha"].default_value = max(0.2, alpha)
    return material


def _body(folder: Path, thing: Thing) -> Body:
    with np.load(folder / thing.path) as stored:
        root = folder / "openarena"
        images = [bpy.data.images.load(str(root / str(p)), check_existing=True)
                  for p in stored["pictures"]]  # fmt: skip
        return Body(
            stored["points"],
            stored["faces"],
            stored["look"],
            stored["spread"],
            [picture_look(image) for image in images],
            float(stored["seconds"]),
        )
