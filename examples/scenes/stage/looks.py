"""Materials and skies, all procedural; materials come with roughness and metallic AOVs."""

from __future__ import annotations

from typing import Any

from stage.blender import bpy

Colour = tuple[float, float, float]
AOVS = ("Roughness", "Metallic")


class Nodes:
    """A thin layer over a node tree: make a node, set or link its inputs, in one call."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree
        tree.nodes.clear()

    def add(self, kind: str, inputs: dict[str | int, Any], **settings: Any) -> bpy.types.Node:
        """Add a node; inputs are values or the sockets to link from."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in settings.items():
            setattr(node, name, value)
        for key, value in inputs.items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[key])
            elif isinstance(value, tuple) and node.inputs[key].type == "RGBA":
                node.inputs[key].default_value = (*value[:3], 1.0)
            else:
                node.inputs[key].default_value = value
        return node

    def math(self, operation: str, *values: Any) -> bpy.types.NodeSocket:
        """Apply a scalar operation."""
        return self.add("Math", dict(enumerate(values)), operation=operation).outputs[0]

    def mix(self, factor: Any, first: Any, second: Any, how: str = "MIX") -> bpy.types.NodeSocket:
        """Blend two colours."""
        inputs = {0: factor, 6: first, 7: second}
        return self.add("Mix", inputs, data_type="RGBA", blend_type=how).outputs[2]

    def step(self, value: Any, low: float, high: float) -> bpy.types.NodeSocket:
        """Map low..high smoothly to 0..1, clamped."""
        inputs = {"Value": value, "From Min": low, "From Max": high}
        return self.add("MapRange", inputs, interpolation_type="SMOOTHSTEP").outputs[0]

    def noise(self, where: Any, scale: float, detail: float = 4.0) -> bpy.types.NodeSocket:
        """Fractal noise around 0.5."""
        inputs = {"Vector": where, "Scale": scale, "Detail": detail}
        return self.add("TexNoise", inputs).outputs[0]

    def spot(self) -> bpy.types.NodeSocket:
        """Position in the object's own space, metres."""
        return self.add("TexCoord", {}).outputs["Object"]

    def wall(self) -> bpy.types.NodeSocket:
        """Coordinates (x + y, z) on upright faces along either axis, metres."""
        axes = self.add("SeparateXYZ", {0: self.spot()}).outputs
        inputs = {0: self.math("ADD", axes[0], axes[1]), 1: axes[2]}
        return self.add("CombineXYZ", inputs).outputs[0]

    def bump(
        self, height: Any, distance: float = 0.04, strength: float = 0.7
    ) -> bpy.types.NodeSocket:
        """Normal of a surface with a relief; a height of 1 is `distance` metres."""
        inputs = {"Height": height, "Distance": distance, "Strength": strength}
        return self.add("Bump", inputs).outputs[0]


def finish(
    nodes: Nodes,
    colour: Any,
    roughness: Any = 0.8,
    metallic: float = 0.0,
    normal: Any = None,
    glow: Any = 0.0,
    light: Any = None,
    ior: float = 1.5,
) -> bpy.types.Node:
    """Close a material: principled surface, which is returned, and the two AOV outputs.

    It emits `glow`, a number or a socket, times `light`, or times its own colour without.
    """
    inputs = {"Base Color": colour, "Roughness": roughness, "Metallic": metallic, "IOR": ior}
    if normal is not None:
        inputs["Normal"] = normal
    if glow:
        inputs |= {"Emission Color": colour if light is None else light, "Emission Strength": glow}
    shader = nodes.add("BsdfPrincipled", inputs)
    nodes.add("OutputMaterial", {0: shader.outputs[0]})
    for name, value in zip(AOVS, (roughness, metallic), strict=True):
        nodes.add("OutputAOV", {"Value": value}, aov_name=name)
    return shader


def new(name: str) -> tuple[bpy.types.Material, Nodes]:
    """Make an empty material."""
    material = bpy.data.materials.new(name)
    return material, Nodes(material.node_tree)


def paint(
    name: str, colour: Colour, roughness: float = 0.6, metallic: float = 0.0, glow: float = 0.0
) -> bpy.types.Material:
    """Paint or metal with a little dirt, so that its motion can be seen."""
    material, nodes = new(name)
    dirt = nodes.step(nodes.noise(nodes.spot(), 9.0, 3.0), 0.3, 0.75)
    worn = tuple(0.55 * part + 0.02 for part in colour)
    shade = colour if glow else nodes.mix(dirt, colour, worn)
    finish(nodes, shade, roughness, metallic, glow=glow)
    return material


def glass(name: str, colour: Colour, opacity: float, glow: float = 0.0) -> bpy.types.Material:
    """Glass or a field of light for EEVEE: blended over what lies behind, absent from data passes.

    Games do the same: what is see-through has no depth, vector or id of its own.
    """
    material, nodes = new(name)
    inputs = {"Base Color": colour, "Roughness": 0.05, "Alpha": opacity}
    if glow:
        inputs |= {"Emission Color": colour, "Emission Strength": glow}
    shader = nodes.add("BsdfPrincipled", inputs)
    nodes.add("OutputMaterial", {0: shader.outputs[0]})
    material.surface_render_method = "BLENDED"
    return material


def plaster(name: str, colour: Colour) -> bpy.types.Material:
    """House plaster: stains running down, patches of other age."""
    material, nodes = new(name)
    where = nodes.wall()
    streaks = nodes.add("Mapping", {0: where, 3: (3.0, 0.5, 1.0)}).outputs[0]
    stain = nodes.step(nodes.noise(streaks, 1.6, 4.0), 0.42, 0.78)
    patch = nodes.step(nodes.noise(where, 1.1, 5.0), 0.45, 0.6)
    fine = nodes.noise(where, 12.0, 2.0)
    lighter = tuple(min(1.0, 1.25 * part + 0.03) for part in colour)
    darker = tuple(0.4 * part for part in colour)
    shade = nodes.mix(stain, nodes.mix(patch, colour, lighter), darker)
    shade = nodes.mix(0.35, shade, nodes.mix(fine, darker, lighter))
    finish(nodes, shade, 0.9)
    return material


def brick(
    name: str, first: Colour, second: Colour, size: tuple[float, float], mortar: Colour
) -> bpy.types.Material:
    """Bricks, tiles or shingles of the given width and height in metres."""
    material, nodes = new(name)
    where = nodes.wall()
    inputs = {
        "Vector": where,
        "Color1": first,
        "Color2": second,
        "Mortar": mortar,
        "Scale": 1.0,
        "Brick Width": size[0],
        "Row Height": size[1],
        "Mortar Size": 0.13 * size[1],
        "Mortar Smooth": 0.2,
    }
    bricks = nodes.add("TexBrick", inputs)
    dirt = nodes.step(nodes.noise(where, 2.3, 5.0), 0.35, 0.75)
    shade = nodes.mix(nodes.math("MULTIPLY", dirt, 0.6), bricks.outputs[0], (0.06, 0.05, 0.05))
    finish(nodes, shade, 0.85)
    return material


def cobbles(name: str) -> bpy.types.Material:
    """Paving of the square: rounded stones of many greys, sandy joints, damp stains."""
    material, nodes = new(name)
    where = nodes.spot()
    inputs = {"Vector": where, "Scale": 3.1, "Randomness": 0.8}
    edge = nodes.add("TexVoronoi", inputs, feature="DISTANCE_TO_EDGE", voronoi_dimensions="2D")
    cell = nodes.add("TexVoronoi", inputs, feature="F1", voronoi_dimensions="2D")
    grain = nodes.noise(where, 11.0, 3.0)
    stone = nodes.step(edge.outputs[0], 0.02, 0.12)
    tone = nodes.add("SeparateColor", {0: cell.outputs["Color"]}).outputs[0]
    shade = nodes.mix(tone, (0.15, 0.145, 0.16), (0.50, 0.43, 0.36))
    shade = nodes.mix(nodes.step(grain, 0.35, 0.7), shade, (0.10, 0.09, 0.09))
    shade = nodes.mix(stone, (0.07, 0.055, 0.04), shade)
    damp = nodes.step(nodes.noise(where, 0.45, 3.0), 0.52, 0.66)
    shade = nodes.mix(nodes.math("MULTIPLY", damp, 0.55), shade, (0.04, 0.04, 0.045))
    rough = nodes.math("SUBTRACT", 0.85, nodes.math("MULTIPLY", damp, 0.35))
    height = nodes.math("ADD", stone, nodes.math("MULTIPLY", grain, 0.3))
    finish(nodes, shade, rough, normal=nodes.bump(height))
    return material


def checker(
    name: str, first: Colour, second: Colour, size: float, roughness: float = 0.8
) -> bpy.types.Material:
    """Checked cloth or tiles with squares of the given size in metres."""
    material, nodes = new(name)
    where = nodes.spot()
    raised = nodes.add("VectorMath", {0: where, 1: (0.0013, 0.0017, 0.0011)}).outputs[0]
    inputs = {"Vector": raised, "Color1": first, "Color2": second, "Scale": 1.0 / size}
    squares = nodes.add("TexChecker", inputs).outputs[0]
    wear = nodes.step(nodes.noise(where, 5.0, 4.0), 0.35, 0.8)
    shade = nodes.mix(nodes.math("MULTIPLY", wear, 0.5), squares, (0.12, 0.10, 0.09))
    finish(nodes, shade, roughness)
    return material


def wood(name: str, colour: Colour, along: int = 0) -> bpy.types.Material:
    """Planks with grain along one axis of the object."""
    material, nodes = new(name)
    where = nodes.spot()
    stretch = [9.0, 9.0, 9.0]
    stretch[along] = 0.9
    grain = nodes.noise(nodes.add("Mapping", {0: where, 3: tuple(stretch)}).outputs[0], 1.7, 3.0)
    light = tuple(min(1.0, 1.5 * part) for part in colour)
    dark = tuple(0.3 * part for part in colour)
    shade = nodes.mix(nodes.step(grain, 0.32, 0.68), light, dark)
    knots = nodes.step(nodes.noise(where, 3.0, 2.0), 0.55, 0.75)
    shade = nodes.mix(nodes.math("MULTIPLY", knots, 0.6), shade, dark)
    finish(nodes, shade, 0.7)
    return material


def foliage(name: str, first: Colour, second: Colour) -> bpy.types.Material:
    """Leaves that differ from place to place."""
    material, nodes = new(name)
    tone = nodes.step(nodes.noise(nodes.spot(), 4.0, 5.0), 0.3, 0.7)
    finish(nodes, nodes.mix(tone, first, second), 0.6)
    return material


def sky(strength: float) -> None:
    """Blue sky with fair-weather clouds, as the world of the scene."""
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    nodes = Nodes(world.node_tree)
    ray = nodes.add("TexCoord", {}).outputs["Generated"]
    axes = nodes.add("SeparateXYZ", {0: ray}).outputs
    rise = nodes.math("MAXIMUM", axes[2], 0.0)
    blue = nodes.mix(nodes.step(rise, 0.0, 0.55), (0.66, 0.76, 0.90), (0.10, 0.27, 0.68))
    flat = nodes.math("ADD", rise, 0.22)
    plane = {0: nodes.math("DIVIDE", axes[0], flat), 1: nodes.math("DIVIDE", axes[1], flat)}
    cloud = nodes.noise(nodes.add("CombineXYZ", plane).outputs[0], 1.7, 5.0)
    cover = nodes.step(cloud, 0.50, 0.66)
    shaded = nodes.mix(nodes.step(cloud, 0.55, 0.8), (1.25, 1.2, 1.12), (0.72, 0.75, 0.82))
    colour = nodes.mix(cover, blue, shaded)
    back = nodes.add("Background", {"Color": colour, "Strength": strength})
    nodes.add("OutputWorld", {0: back.outputs[0]})


def backdrop(
    zenith: Colour, horizon: Colour, strength: float = 1.0, clouds: Colour | None = None
) -> None:
    """Gradient sky with clouds, as the world of the scene.

    The clouds are seen by the camera and in mirrors but light nothing: evaluating them for every
    light sample took a quarter of a frame's time.

    Parameters
    ----------
    zenith, horizon : tuple of float
        Colours straight up and at the horizon (and below), scene-linear.
    strength : float
        Factor on everything.
    clouds : tuple of float, optional
        Colour of the bright side of clouds, values above 1 allowed.
    """
    world = bpy.data.worlds.new("backdrop")
    bpy.context.scene.world = world
    nodes = Nodes(world.node_tree)
    axes = nodes.add("SeparateXYZ", {0: nodes.add("TexCoord", {}).outputs["Generated"]}).outputs
    rise = nodes.math("MAXIMUM", axes[2], 0.0)
    plain = nodes.mix(nodes.math("POWER", rise, 0.5), horizon, zenith)
    light = nodes.add("Background", {"Color": plain, "Strength": strength}).outputs[0]
    if clouds is not None:
        flat = nodes.math("ADD", rise, 0.22)
        plane = {0: nodes.math("DIVIDE", axes[0], flat), 1: nodes.math("DIVIDE", axes[1], flat)}
        cloud = nodes.noise(nodes.add("CombineXYZ", plane).outputs[0], 1.7, 5.0)
        shaded = nodes.mix(nodes.step(cloud, 0.55, 0.8), clouds, tuple(0.6 * c for c in clouds))
        colour = nodes.mix(nodes.step(cloud, 0.50, 0.66), plain, shaded)
        seen = nodes.add("Background", {"Color": colour, "Strength": strength}).outputs[0]
        path = nodes.add("LightPath", {}).outputs
        looked = nodes.math("MAXIMUM", path["Is Camera Ray"], path["Is Glossy Ray"])
        light = nodes.add("MixShader", {0: looked, 1: light, 2: seen}).outputs[0]
    nodes.add("OutputWorld", {0: light})
