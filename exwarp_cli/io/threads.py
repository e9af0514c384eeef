"""The one place that tells libraries how many threads they may have.

`domain.cores` knows the number. onnxruntime's sessions, ffmpeg, and what runs threads here receive
it at each use. OpenCV always has one. numpy starts BLAS as it is imported, so `exwarp_cli.cli` sets
the number for BLAS.
"""

from __future__ import annotations

import OpenImageIO as oiio

from exwarp_cli.domain import cores
from exwarp_cli.io.machine import processors
from exwarp_cli.kernels import _row_bands


def use_threads(count: int | None) -> None:
    """Set how many cores this process uses.

    Parameters
    ----------
    count
        At least 1; None for all that this process may use. Kernels heed it in this thread, and in
        those that begin with `for_kernels`.
    """
    cores.share(count, processors().usable)
    oiio.attribute("threads", cores.count())
    oiio.attribute("exr_threads", cores.count())
    for_kernels()


def for_kernels() -> None:
    """Have kernels that this thread starts use no more threads than cores are left for it.

    A new thread's kernels have threads for all cores, whatever others do.
    """
    _row_bands.set_threads(cores.left)
