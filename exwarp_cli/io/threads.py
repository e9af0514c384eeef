"""Passes the number of cores of this process on to the libraries that start threads.

onnxruntime's sessions, ffmpeg and this package's own thread pools take the number from
`runtime.cores` at each use. OpenCV always has one thread. numpy starts BLAS as it is imported, so
`exwarp_cli.cli` limits BLAS.
"""

from __future__ import annotations

import OpenImageIO as oiio

from exwarp_cli.kernels import _row_bands
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.machine import processors


def use_threads(count: int | None) -> None:
    """Set how many cores this process uses: at least 1, or None for all that it may use."""
    cores.set_count(count, processors().usable)
    oiio.attribute("threads", cores.count())
    oiio.attribute("exr_threads", cores.count())
    limit_kernel_threads()


def limit_kernel_threads() -> None:
    """Limit the kernels that this thread starts to the spare cores.

    Each thread has to call it: the kernels of a new thread use all cores.
    """
    _row_bands.set_threads(cores.spare_count)
