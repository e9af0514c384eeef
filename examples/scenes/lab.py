"""The scene "lab": a robotics laboratory with a polished floor, at dusk.

The camera rolls along the aisle between two benches: it looks to the left at first, hurries on
while it turns to the right, and comes to rest in front of a robot arm.
"""

from __future__ import annotations

import math
import random

import lab_benches
import lab_looks
import lab_machines
import lab_room
from stage import motion
from stage.blender import bpy, mathutils
from stage.looks import Nodes
from stage.options import main
from stage.quality import Quality
from stage.shooting import Script

Euler, Vector = mathutils.Euler, mathutils.Vector


def build(seed: int, last: int) -> dict[int, str]:
    """Build the scene; return what each object id is."""
    chance = random.Random(seed)
    looks = lab_looks.palette()
    lab_room.build(looks, chance)
    lab_benches.build(looks, chance)
    _world()
    _corridor_light()
    motion.film(_view, last, 64.0)
    return lab_machines.build(looks, last)


def _world() -> None:
    """Stand in for light after its second bounce by an even glow, which saves a third of the time.

    The room is closed, so the world is seen nowhere else.
    """
    world = bpy.data.worlds.new("dim")
    bpy.context.scene.world = world
    nodes = Nodes(world.node_tree)
    glow = nodes.add("Background", {"Color": (0.85, 0.95, 1.0), "Strength": 0.36})
    nodes.add("OutputWorld", {0: glow.outputs[0]})
    world.cycles.sampling_method = "NONE"
    world.light_settings.distance = 3.0
    cycles = bpy.context.scene.cycles
    cycles.use_fast_gi, cycles.fast_gi_method = True, "REPLACE"
    cycles.ao_bounces_render = 1


def _corridor_light() -> None:
    """Add the lamp that shines through the opening door onto the floor."""
    data = bpy.data.lights.new("corridor", "SPOT")
    data.energy, data.color = 4200.0, (0.80, 0.92, 1.0)
    data.spot_size, data.spot_blend, data.shadow_soft_size = math.radians(80), 0.3, 0.05
    lamp = bpy.data.objects.new("corridor", data)
    lamp.location = (-0.1, 15.0, 2.75)
    lamp.rotation_euler = Vector((0, -1, -0.42)).to_track_quat("-Z", "Y").to_euler()
    lamp.visible_camera = lamp.visible_glossy = False
    bpy.context.scene.collection.objects.link(lamp)


def _view(seconds: float) -> tuple[Vector, Euler]:
    """Return the camera's pose: calm, then a quick dolly with a turn to the right, then calm."""
    gone = 0.36 * seconds + 2.5 * motion.ramp(seconds, 0.3, 1.7)
    turned = motion.ramp(seconds, 0.38, 1.62)
    wobble = motion.shake(seconds, 2.0, 0.6)
    side = -0.3 + 0.55 * motion.ramp(seconds, 0.2, 1.8)
    where = Vector((side, -0.5 + gone, 1.6 - 0.1 * turned)) + 0.006 * wobble
    yaw = math.radians(11.5 - 2.6 * seconds - 24.3 * turned + 0.1 * wobble.x)
    down = math.radians(7.5 + 1.5 * turned + 0.08 * wobble.y)
    roll = math.radians(0.9 * math.sin(math.pi * turned))
    return where, Euler((math.pi / 2 - down, roll, yaw))


SCENE = Script(
    "lab",
    "A robotics laboratory with a polished floor: robot arm, rover, gyroscope, swinging lamp.",
    build,
    seed=4,
    pace=3.0,
    clean=Quality(32, 6, light_tree=False, clamp=2.0),
)

if __name__ == "__main__":
    main(SCENE)
