"""Set a small scene up by the add-on's buttons, render it, and print the command that it copies.

Usage: ``python addon_shot.py FOLDER STEP LAST``, by a Python that has Blender's module.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "blender"))
import exwarp_blender as addon

FIRST, LAST = 1, 17


def build_scene(folder: Path) -> None:
    """Make a sphere and a board that move before a textured wall, with what ExWarp dislikes."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 8, True
    scene.render.use_motion_blur = True
    scene.render.resolution_x, scene.render.resolution_y = 96, 54
    scene.render.filepath = f"{folder}/ball.####"
    scene.frame_start, scene.frame_end = FIRST, int(sys.argv[3])
    bpy.ops.mesh.primitive_plane_add(size=20, location=(0, 5, 0), rotation=(1.5708, 0, 0))
    wall = bpy.context.object
    bpy.ops.mesh.primitive_uv_sphere_add(radius=1)
    ball = bpy.context.object
    for thing, scale in ((wall, 0.7), (ball, 3.0)):
        material = bpy.data.materials.new(thing.name)
        nodes = material.node_tree.nodes
        noise = nodes.new("ShaderNodeTexNoise")
        noise.inputs["Scale"].default_value = scale
        colour = nodes["Principled BSDF"].inputs["Base Color"]
        material.node_tree.links.new(noise.outputs["Color"], colour)
        thing.data.materials.append(material)
    for frame, x in ((FIRST, -1.5), (LAST, 1.5)):
        ball.location.x = x
        ball.keyframe_insert("location", frame=frame)
    bpy.ops.object.light_add(type="SUN", rotation=(0.6, 0.3, 0))
    bpy.ops.object.camera_add(location=(0, -8, 0.5), rotation=(1.5, 0, 0))
    scene.camera = bpy.context.object
    for frame, x in ((FIRST, 0.0), (LAST, 0.4)):
        scene.camera.location.x = x
        scene.camera.keyframe_insert("location", frame=frame)


def main() -> None:
    """Press both buttons and render between them."""
    folder, step = Path(sys.argv[1]), sys.argv[2]
    build_scene(folder)
    addon.register()
    scene = bpy.context.scene
    scene.exwarp.step = step
    print("before:", "; ".join(addon.problems_of(scene)))
    assert bpy.ops.exwarp.set_up() == {"FINISHED"}
    print("after:", "; ".join(addon.problems_of(scene)))
    bpy.ops.render.render(animation=True)
    print("command:", addon.command_of(scene))
    addon.unregister()
    assert not hasattr(bpy.types.Scene, "exwarp")


if __name__ == "__main__":
    main()
