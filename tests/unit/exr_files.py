"""Small OpenEXR files for tests, written with the reference library."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

Planes = Mapping[str, np.ndarray]
ZIP = OpenEXR.ZIP_COMPRESSION


def box(x: int, y: int, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """A window as headers hold it."""
    return np.array([x, y], np.int32), np.array([x + width - 1, y + height - 1], np.int32)


def header(**more: Any) -> dict[str, Any]:
    return {"compression": ZIP, "type": OpenEXR.scanlineimage, **more}


def write_single(path: Path, planes: Planes, **attributes: Any) -> Path:
    OpenEXR.File(header(**attributes), dict(planes)).write(str(path))
    return path


def write_parts(path: Path, parts: Mapping[str, tuple[Planes, Mapping[str, Any]]]) -> Path:
    made = [
        OpenEXR.Part(header(**attributes), dict(planes), name)
        for name, (planes, attributes) in parts.items()
    ]
    OpenEXR.File(made).write(str(path))
    return path


def rgba(height: int, width: int, dtype: type = np.float16, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: rng.random((height, width)).astype(dtype) for name in "RGBA"}


def plane(height: int, width: int, value: float, dtype: type = np.float32) -> np.ndarray:
    return np.full((height, width), value, dtype)
