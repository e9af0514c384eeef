"""Blender add-on: set a scene up for ExWarp, and write the command that upsamples its render.

Install this file by Edit > Preferences > Add-ons > Install from Disk. The panel is in Properties >
Output > ExWarp. Tested with Blender 5.0.
"""

from __future__ import annotations

import os
import shlex
import subprocess
from pathlib import Path

import bpy

bl_info = {
    "name": "ExWarp",
    "description": "Render a quarter of the frames; ExWarp makes the others",
    "author": "The authors of ExWarp",
    "version": (0, 2, 0),
    "blender": (4, 2, 0),
    "location": "Properties > Output > ExWarp",
    "category": "Render",
}

PASSES = (
    "use_pass_z",
    "use_pass_position",
    "use_pass_normal",
    "use_pass_vector",
    "use_pass_object_index",
    "use_pass_diffuse_color",
    "use_pass_glossy_color",
)
"""Properties of a view layer. EEVEE has no object index pass; Cryptomatte stands in."""

STEPS = (
    ("1", "Every frame", "Render every frame; ExWarp multiplies the frame rate"),
    ("2", "Every second frame", "Render on twos; ExWarp makes the other frame"),
    ("4", "Every fourth frame", "Render on fours; ExWarp makes the three frames between"),
)


class ExWarpSettings(bpy.types.PropertyGroup):
    """What the user chooses; kept in the scene."""

    step: bpy.props.EnumProperty(
        name="Render", description="Which frames are rendered", items=STEPS, default="1"
    )
    factor: bpy.props.IntProperty(
        name="Factor", description="Output frames for each frame", default=4, min=2, max=8
    )
    scene_start: bpy.props.IntProperty(
        name="First frame", description="Of the scene, while its time is stretched", default=0
    )
    scene_end: bpy.props.IntProperty(
        name="Last frame", description="Of the scene, while its time is stretched", default=0
    )
    output: bpy.props.StringProperty(
        name="Output",
        description="Folder of the new frames; empty: beside the render, ending in _exwarp",
        subtype="DIR_PATH",
    )


def problems_of(scene: bpy.types.Scene) -> list[str]:
    """Return what in a scene would spoil the result, a short sentence each."""
    problems = []
    if scene.render.use_motion_blur:
        problems.append("Motion blur is on: no vectors are written")
    if scene.render.image_settings.file_format != "OPEN_EXR_MULTILAYER":
        problems.append("The output is no multi-layer EXR")
    for layer in scene.view_layers:
        if layer.use and not layer.use_pass_vector:
            problems.append(f"View layer {layer.name} has no Vector pass")
    if scene.render.engine == "CYCLES" and not scene.cycles.use_denoising:
        problems.append("Denoising is off: noise will flicker")
    if stretch_of(scene) != int(scene.exwarp.step):
        problems.append("Time is not stretched for these steps: press Set up for ExWarp")
    return problems


def stretch_of(scene: bpy.types.Scene) -> float:
    """Return how many frames of the scene pass from rendered frame to rendered frame."""
    return scene.frame_step * scene.render.frame_map_old / scene.render.frame_map_new


def stretch_time(scene: bpy.types.Scene, step: int) -> None:
    """Have rendered frame n show the scene's frame `step` times n.

    Blender's vectors span one rendered frame. With a frame step instead, they would span one frame
    of the scene, and say little about how things move until the next rendered frame.
    """
    settings = scene.exwarp
    if scene.render.frame_map_old == scene.render.frame_map_new or not settings.scene_end:
        settings.scene_start, settings.scene_end = scene.frame_start, scene.frame_end
    scene.frame_step = 1
    scene.render.frame_map_old, scene.render.frame_map_new = step, 1
    # Frames before the first multiple of the step, and after the last, are not rendered.
    scene.frame_start = -(-settings.scene_start // step)
    scene.frame_end = settings.scene_end // step


def set_up(scene: bpy.types.Scene) -> None:
    """Set passes, motion blur, time and file format of a scene as ExWarp wants them."""
    scene.render.use_motion_blur = False
    stretch_time(scene, int(scene.exwarp.step))
    has_indices = any(thing.pass_index for thing in scene.objects)
    for layer in scene.view_layers:
        for name in PASSES:
            if hasattr(layer, name):
                setattr(layer, name, True)
        if not has_indices or scene.render.engine != "CYCLES":
            layer.use_pass_cryptomatte_object = True
    image = scene.render.image_settings
    if hasattr(image, "media_type"):  # Blender 5 sorts file formats by media
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format = "OPEN_EXR_MULTILAYER"
    image.color_depth = "16"  # passes of data stay 32 bit floats
    image.exr_codec = "ZIP"
    if scene.render.engine == "CYCLES" and scene.cycles.use_denoising:
        scene.cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"


def render_pattern(scene: bpy.types.Scene) -> Path:
    """Return the pattern of the frames that the scene renders, with # for digits."""
    first = bpy.path.abspath(scene.render.frame_path(frame=scene.frame_start))
    path = Path(os.path.normpath(first))
    digits = len(path.stem) - len(path.stem.rstrip("0123456789"))
    return path.with_name(path.stem[: len(path.stem) - digits] + "#" * digits + path.suffix)


def command_of(scene: bpy.types.Scene) -> str:
    """Return the command line that upsamples the rendered frames of a scene."""
    settings = scene.exwarp
    pattern, step = render_pattern(scene), int(settings.step)
    folder = bpy.path.abspath(settings.output) if settings.output else f"{pattern.parent}_exwarp"
    rate = scene.render.fps / scene.render.fps_base / step
    factor = settings.factor if step == 1 else step
    words = ["exwarp", "upsample", str(pattern), "-o", str(folder), "--fps", f"{rate:g}"]
    words += ["--factor", str(factor)] if factor != 4 else []
    # Output frames then have the numbers of the scene's frames.
    words += ["--start-frame", str(scene.frame_start * step)] if step > 1 else []
    return subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)


class SetUpForExWarp(bpy.types.Operator):
    """Switch on the passes that ExWarp needs, switch motion blur off, and write multi-layer EXR."""

    bl_idname = "exwarp.set_up"
    bl_label = "Set up for ExWarp"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Set the scene up."""
        set_up(context.scene)
        self.report({"INFO"}, "The scene is set up for ExWarp")
        return {"FINISHED"}


class CopyExWarpCommand(bpy.types.Operator):
    """Copy the command that upsamples the rendered frames, to paste it into a terminal."""

    bl_idname = "exwarp.copy_command"
    bl_label = "Copy command"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Copy the command."""
        command = command_of(context.scene)
        context.window_manager.clipboard = command
        self.report({"INFO"}, command)
        return {"FINISHED"}


class ExWarpPanel(bpy.types.Panel):
    """The panel in the output properties."""

    bl_idname = "RENDER_PT_exwarp"
    bl_label = "ExWarp"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "output"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings, what is wrong, and the two buttons."""
        scene, layout = context.scene, self.layout
        layout.use_property_split = True
        layout.prop(scene.exwarp, "step")
        if scene.exwarp.step == "1":
            layout.prop(scene.exwarp, "factor")
        layout.prop(scene.exwarp, "output")
        for problem in problems_of(scene):
            layout.label(text=problem, icon="ERROR")
        layout.operator(SetUpForExWarp.bl_idname)
        layout.operator(CopyExWarpCommand.bl_idname)


CLASSES = (ExWarpSettings, SetUpForExWarp, CopyExWarpCommand, ExWarpPanel)


def register() -> None:
    """Add the panel to Blender."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.exwarp = bpy.props.PointerProperty(type=ExWarpSettings)


def unregister() -> None:
    """Take the panel out of Blender."""
    del bpy.types.Scene.exwarp
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)


if __name__ == "__main__":
    register()
