"""Scikit-image's structural similarity, with the settings of Wang et al. that ours follows."""

from __future__ import annotations

import numpy as np
from skimage.metrics import structural_similarity


def ssim(reference: np.ndarray, test: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the mean, without a margin of five pixels, and the map [H, W, C]."""
    mean, full = structural_similarity(
        reference.astype(np.float64),
        test.astype(np.float64),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=255,
        full=True,
        channel_axis=2,
    )
    return float(mean), np.asarray(full)


def uniform_ssim(reference: np.ndarray, test: np.ndarray) -> float:
    """Return the mean of uint8 [H, W, 3] with the defaults: ``multichannel=True`` once."""
    return float(structural_similarity(reference, test, channel_axis=2))
