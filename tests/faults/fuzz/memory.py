"""How much memory a case may take: what its frames need, and no more."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

MOST_PIXELS = 1_000_000
"""What cases are run with as --max-pixels."""

PROCESS_MB = 600
"""Of a process that has its libraries, networks and kernels, and compiles what is not at hand."""

GROWTH_MB = 300
"""By which a process grows that has most of them, whatever the frames."""

PIXEL_BYTES = 1000
"""Of all that is in memory at once, per pixel of a frame: E at 1920x1080 takes 600."""

STRIDE = 8
"""Of the shipped network: a column of pixels is as much work for it as eight."""

_WINDOW = re.compile(rb"(?:data|display)Window\0box2i\0.{4}(.{16})", re.DOTALL)


def pixels_of(folder: Path) -> int:
    """Return how many pixels are worked on where the frames of a folder lie on one canvas.

    Networks see whole multiples of STRIDE on both sides. Frames that say they have more than is
    allowed are refused, and count as that many.
    """
    windows = [
        np.frombuffer(found, "<i4").astype(np.int64)
        for path in folder.glob("*.exr")
        if path.is_file()
        for found in _WINDOW.findall(path.read_bytes()[:100_000])
    ]
    if not windows:
        return 0
    x0, y0, x1, y1 = np.array(windows).T
    width = max(int(x1.max()) - int(x0.min()) + 1, 0)
    height = max(int(y1.max()) - int(y0.min()) + 1, 0)
    if width * height > MOST_PIXELS:
        return MOST_PIXELS
    return -(-width // STRIDE) * -(-height // STRIDE) * STRIDE**2


def allowed_mb(pixels: int, base: int) -> int:
    """Return how much memory frames of so many pixels may take beside a base, megabytes."""
    return base + pixels * PIXEL_BYTES // 2**20


@dataclass
class Growth:
    """By how much a process grew at its peak, megabytes; 0 until it is known."""

    mb: int = 0


@contextmanager
def watched() -> Iterator[Growth]:
    """Watch by how much this process grows in a block; by nothing where the system tells nothing.

    The peak is the block's own: Linux forgets the one before on request.
    """
    growth = Growth()
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        yield growth
        return
    before = _status("VmRSS")
    try:
        yield growth
    finally:
        growth.mb = (_status("VmHWM") - before) // 1024


def _status(name: str) -> int:
    """Return a line of the process's status, kilobytes."""
    text = Path("/proc/self/status").read_text()
    return int(text.split(f"{name}:", 1)[1].split()[0])
