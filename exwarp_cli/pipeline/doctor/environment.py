"""Variables of the environment that change what ExWarp and its libraries do."""

from __future__ import annotations

import os

PREFIXES = ("EXWARP_", "NUMBA_", "OMP_", "KMP_", "OPENIMAGEIO_", "ORT_")
"""Of names of variables."""

NAMES = ("CUDA_VISIBLE_DEVICES", "IMAGEIO_FFMPEG_EXE", "LD_LIBRARY_PATH", "TMPDIR")
"""Of other variables."""


def variables() -> dict[str, str]:
    """Return those that are set, by name."""
    found = (name for name in os.environ if name.startswith(PREFIXES) or name in NAMES)
    return {name: os.environ[name] for name in sorted(found)}
