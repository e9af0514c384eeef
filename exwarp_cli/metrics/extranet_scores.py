"""PSNR and SSIM as ExtraNet's authors published theirs, to compare with their tables.

Guo, Fu, Lin, Ma, Liu, Han, Liu, Wang, Yan, "ExtraNet: Real-time Extrapolated Rendering for
Low-latency Temporal Supersampling", ACM Transactions on Graphics 40(6), 2021; the folder Metric of
its release. Frames are tone-mapped by Mitsuba's ``mtsutil tonemap`` with its defaults (the sRGB
curve, clipped) into 8-bit PNG. PSNR is over the three channels. SSIM is scikit-image's of that time
with its defaults: a uniform window of 7x7 pixels, sample covariance, the three channels' mean. The
tool's own metrics do not round, and weight by a Gaussian.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Float32, UInt8
from exwarp_cli.domain.results import Score
from exwarp_cli.metrics.display import round_display
from exwarp_cli.metrics.registry import psnr_from_mse

WINDOW = 7  # side of the window, pixels

SSIM_C1, SSIM_C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2

F64 = npt.NDArray[np.float64]


def score_like_extranet(reference: Float32, test: Float32) -> Score:
    """Score a frame, float32 [H, W, 3 or more], scene-linear, as ExtraNet's release does.

    PSNR is at most 100 dB, where theirs is infinite. SSIM is None for frames smaller than the
    window.
    """
    shown, judged = round_display(reference), round_display(test)
    difference = shown.astype(np.float64) - judged
    return Score(
        psnr_db=psnr_from_mse(float(np.mean(difference**2))),
        ssim=uniform_ssim(shown, judged),
    )


def uniform_ssim(reference: UInt8, test: UInt8) -> float | None:
    """Return the structural similarity of two uint8 [H, W, C], over whole windows only."""
    if min(reference.shape[:2]) < WINDOW:
        return None
    x, y = reference.astype(np.float64), test.astype(np.float64)
    mean_x, mean_y = _window_means(x), _window_means(y)
    count = WINDOW * WINDOW
    unbiased = count / (count - 1)
    variance_x = unbiased * (_window_means(x * x) - mean_x * mean_x)
    variance_y = unbiased * (_window_means(y * y) - mean_y * mean_y)
    covariance = unbiased * (_window_means(x * y) - mean_x * mean_y)
    top = (2 * mean_x * mean_y + SSIM_C1) * (2 * covariance + SSIM_C2)
    bottom = (mean_x**2 + mean_y**2 + SSIM_C1) * (variance_x + variance_y + SSIM_C2)
    return float((top / bottom).mean())


def _window_means(values: F64) -> F64:
    """Return the mean of every whole window of [H, W, C]; sums of integers, so exact."""
    sums = np.zeros((values.shape[0] + 1, values.shape[1] + 1, values.shape[2]))
    sums[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)
    n = WINDOW
    total: F64 = sums[n:, n:] - sums[:-n, n:] - sums[n:, :-n] + sums[:-n, :-n]
    return total / (n * n)
