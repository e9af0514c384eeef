"""Take the screenshots of docs/renderers/blender.md in Blender's own window.

On a screen, or under ``xvfb-run -s '-screen 0 1000x1180x24'``::

    blender --factory-startup --window-geometry 0 0 1000 1180 \\
        --python examples/blender/screenshots.py -- docs/images

Blender's module for Python has no window.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

HERE = Path(__file__).resolve().parent

# Seconds between steps: the window is drawn in between.
PAUSE = 2.0


def main() -> None:
    """Load the add-on, and take a picture of each page in turn."""
    sys.path.insert(0, str(HERE))
    import exwarp_blender

    exwarp_blender.register()
    folder = Path(sys.argv[sys.argv.index("--") + 1]).resolve()
    bpy.context.preferences.view.show_splash = False
    steps = take(folder)

    def go_on() -> float | None:
        return next(steps, None)

    bpy.app.timers.register(go_on, first_interval=PAUSE)


def take(folder: Path) -> Iterator[float]:
    """Yield the seconds to wait after each step."""
    window = bpy.context.window_manager.windows[0]
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.filepath = "//render/shot.####"
    area = next(area for area in window.screen.areas if area.type == "PROPERTIES")
    with bpy.context.temp_override(window=window, area=area):
        bpy.ops.screen.screen_full_area()
    yield PAUSE
    bpy.ops.exwarp.set_up()
    for name, tab in (("blender_output", "OUTPUT"), ("blender_passes", "VIEW_LAYER")):
        area = next(area for area in window.screen.areas if area.type == "PROPERTIES")
        area.spaces.active.context = tab
        area.tag_redraw()
        yield PAUSE
        with bpy.context.temp_override(window=window):
            bpy.ops.screen.screenshot(filepath=str(folder / f"{name}.png"))
    bpy.ops.wm.quit_blender()


if __name__ == "__main__":
    main()
