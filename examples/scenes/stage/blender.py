"""Blender's Python module, or one sentence about how to get it."""

from __future__ import annotations

import sys

try:
    import bpy
    import mathutils
    import OpenEXR
except ModuleNotFoundError as missing:
    sys.exit(
        f"This script needs the Python module {missing.name}; make an environment for it: "
        "python3.11 -m venv blender && blender/bin/pip install bpy==5.0.1 OpenEXR, "
        "then run it with blender/bin/python."
    )

__all__ = ["OpenEXR", "bpy", "mathutils"]
