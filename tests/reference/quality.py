"""Naive twins of the quality metrics: slow, plain numpy, straight from the definitions."""

from __future__ import annotations

import math

import numpy as np


def srgb_255(linear: float) -> float:
    """Encode one scene-linear value: IEC 61966-2-1, clipped, on the 255 scale."""
    if math.isnan(linear):
        return 0.0
    value = min(max(linear, 0.0), 1.0)
    encoded = 12.92 * value if value <= 0.0031308 else 1.055 * value ** (1 / 2.4) - 0.055
    return 255 * encoded


def psnr_db(reference: np.ndarray, test: np.ndarray) -> float:
    """10 log10(255^2 / MSE), at most 100, over arrays of any shape."""
    mse = float(np.mean((reference.astype(np.float64) - test.astype(np.float64)) ** 2))
    return 100.0 if mse == 0 else min(100.0, 10 * math.log10(255.0**2 / mse))


def ssim_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Wang's SSIM at every pixel of [H, W, C]: an explicit 11x11 window, reflected borders."""
    offsets = np.arange(-5, 6)
    line = np.exp(-(offsets**2) / (2 * 1.5**2))
    window = np.outer(line, line)
    window /= window.sum()
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    out = np.empty(reference.shape)
    for c in range(reference.shape[2]):
        x = np.pad(reference[..., c].astype(np.float64), 5, mode="symmetric")
        y = np.pad(test[..., c].astype(np.float64), 5, mode="symmetric")
        for i in range(reference.shape[0]):
            for j in range(reference.shape[1]):
                a, b = x[i : i + 11, j : j + 11], y[i : i + 11, j : j + 11]
                ma, mb = (window * a).sum(), (window * b).sum()
                va = (window * (a - ma) ** 2).sum()
                vb = (window * (b - mb) ** 2).sum()
                covariance = (window * (a - ma) * (b - mb)).sum()
                top = (2 * ma * mb + c1) * (2 * covariance + c2)
                out[i, j, c] = top / ((ma * ma + mb * mb + c1) * (va + vb + c2))
    return out
