"""Structural similarity, as Wang et al. (2004) define it and scikit-image computes it."""

from __future__ import annotations

from exwarp_cli.domain.frame import Float32
from exwarp_cli.kernels.ssim import RADIUS, ssim_map
from exwarp_cli.metrics.display import Measured


def measure(reference: Float32, test: Float32) -> Measured:
    """Compare two display-encoded images, float32 [H, W, 3], 0 to 255.

    The map is the mean of the three channels' maps. Over all pixels it is averaged without the 5
    pixels at every edge, where the window would leave the image (as scikit-image does); an image
    with fewer than 11 rows or columns has no such inside, and all its pixels are averaged. Over a
    mask every pixel of the mask counts, edges included.
    """
    channels = ssim_map(reference, test)
    # Added by hand: numpy's mean over a last axis of three is slower than the kernel.
    mean = (channels[..., 0] + channels[..., 1] + channels[..., 2]) / 3
    inside = min(mean.shape) > 2 * RADIUS
    return Measured(mean, margin=RADIUS if inside else 0)
