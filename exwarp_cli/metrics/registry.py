"""The image metrics by name, and the score of a frame.

PSNR; SSIM (Wang et al. 2004, as scikit-image computes it); FLIP and HDR-FLIP, with the numbers of
their authors' package:

Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild, "FLIP: A Difference Evaluator for
Alternating Images", Proceedings of the ACM on Computer Graphics and Interactive Techniques 3(2),
2020. Andersson, Nilsson, Shirley, Akenine-Möller, "Visualizing Errors in Rendered High Dynamic
Range Images", Eurographics 2021 (short papers).

And PSNR and SSIM as ExtraNet's authors published theirs, to compare with their tables:

Guo, Fu, Lin, Ma, Liu, Han, Liu, Wang, Yan, "ExtraNet: Real-time Extrapolated Rendering for
Low-latency Temporal Supersampling", ACM Transactions on Graphics 40(6), 2021; the folder Metric of
its release. Frames are tone-mapped by Mitsuba's ``mtsutil tonemap`` with its defaults (the sRGB
curve, clipped) into 8-bit PNG. PSNR is over the three channels. SSIM is scikit-image's of that time
with its defaults: a uniform window of 7x7 pixels, sample covariance, the three channels' mean. The
tool's own metrics do not round, and weight by a Gaussian.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.colour import PEAK, encode_display, round_display
from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.metric import DEFAULT_METRICS
from exwarp_cli.domain.results import Score
from exwarp_cli.kernels import picture_errors
from exwarp_cli.metrics.temporal import REC_709, mean_gradient, pulse

MAX_DB = 100.0  # PSNR of equal images, in place of infinity, and the largest of any pair

WINDOW = 7  # side of the window of ExtraNet's SSIM, pixels

SSIM_C1, SSIM_C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2  # of ExtraNet's SSIM


@dataclass(frozen=True)
class MetricMap:
    """A metric's map for one pair of images."""

    per_pixel: npt.NDArray[np.floating]  # [H, W], finite: what is averaged
    margin: int = 0  # pixels left out at every edge, unless a mask selects pixels
    finish: Callable[[float], float] = float  # turns the average into the metric's value

    def value(self, mask: Bool | None = None) -> float:
        """Return the value over all pixels, or over those of a mask, bool [H, W], not empty."""
        inner = tuple(slice(self.margin, size - self.margin) for size in self.per_pixel.shape)
        chosen = self.per_pixel[inner if mask is None else mask]
        return self.finish(float(chosen.mean(dtype=np.float64)))


def measure_psnr(reference: Float32, test: Float32) -> MetricMap:
    """Return the map of ``10 log10(255^2 / MSE)`` in dB over the three channels, at most MAX_DB."""
    error = np.zeros(reference.shape[:2])
    for c in range(3):
        difference = np.subtract(reference[..., c], test[..., c], dtype=np.float64)
        error += difference * difference
    return MetricMap(error / 3, finish=psnr_from_mse)


def psnr_from_mse(mean_squared_error: float) -> float:
    """Turn a mean squared error on the 255 scale into decibels, at most MAX_DB."""
    if mean_squared_error <= 0:
        return MAX_DB
    return min(MAX_DB, 10 * math.log10(PEAK**2 / mean_squared_error))


def measure_ssim(reference: Float32, test: Float32) -> MetricMap:
    """Return the map of SSIM, the mean of the three channels' maps."""
    # As in scikit-image, the 5 pixels at every edge are left out, where the window would leave the
    # image; unless the image has fewer than 11 rows or columns. Of a mask every pixel counts.
    channels = picture_errors.ssim_map(reference, test)
    # Added by hand: numpy's mean over a last axis of three is slower than the kernel.
    mean = (channels[..., 0] + channels[..., 1] + channels[..., 2]) / 3
    inside = min(mean.shape) > 2 * picture_errors.SSIM_RADIUS
    return MetricMap(mean, margin=picture_errors.SSIM_RADIUS if inside else 0)


def _raise_flip_error(images: tuple[Float32, Float32], gain: float, error: Float32) -> None:
    """Raise an error map to the FLIP error of a pair of images; `gain` as in `write_opponent`."""
    planes = np.empty((picture_errors.OPPONENT_PLANES, *error.shape), np.float32)
    views = []
    for image in images:
        picture_errors.write_opponent(image, np.float32(gain), planes)
        view = np.empty((picture_errors.PERCEIVED_PLANES, *error.shape), np.float32)
        picture_errors.write_perceived(planes, view)
        views.append(view)
    picture_errors.raise_flip_error(*views, error)


def measure_flip(reference: Float32, test: Float32) -> MetricMap:
    """Return the map of LDR-FLIP at 67 pixels per degree, 0 (equal) to 1."""
    error = np.zeros(reference.shape[:2], np.float32)
    images = np.ascontiguousarray(reference, np.float32), np.ascontiguousarray(test, np.float32)
    _raise_flip_error(images, 0, error)
    return MetricMap(error)


MAX_COLOUR = 65504.0  # the largest half float, as EXR colour mostly is

DARK_LUMINANCE = 1e-6  # a reference below this luminance everywhere counts as black

MIN_MEDIAN = np.float32(2.0**-23)  # least median luminance, as of an image that is mostly black


def hdr_flip_colour(pixels: Float32) -> Float32:
    """Return colour as HDR-FLIP takes it: float32 [H, W, 3], finite, 0 to MAX_COLOUR.

    NaN and negative values count as 0, infinities as MAX_COLOUR; alpha is dropped.
    """
    colour = np.nan_to_num(pixels[..., :3].astype(np.float32), nan=0.0, posinf=MAX_COLOUR)
    return np.ascontiguousarray(np.clip(colour, 0, np.float32(MAX_COLOUR)))


def hdr_flip_exposures(reference: Float32) -> list[float]:
    """Return the exposures at which a pair is compared, in stops, ascending (section 3).

    The reference comes from `hdr_flip_colour`.
    They go from the one that brings the largest luminance to 0.85 of white to the one that does so
    with the median (the upper one of two), in steps of a stop or a little more. A single one if
    both are equal; [0.0] for a black reference.
    """
    r, g, b = (reference[..., c] * np.float32(REC_709[c]) for c in range(3))
    luminance = (r + g + b).ravel()
    largest = luminance.max()
    if largest < DARK_LUMINANCE:
        return [0.0]
    middle = luminance.size // 2
    median = max(np.partition(luminance, middle)[middle], MIN_MEDIAN)
    # In float32 as the package has it, since near whole stops the last digit decides on the count;
    # numpy's own logarithm of float32 is not always the nearest one.
    start, stop = (
        np.float32(math.log2(picture_errors.SATURATED / value)) for value in (largest, median)
    )
    count = 1 if start == stop else max(2, math.ceil(stop - start))
    return [float(value) for value in np.linspace(start, stop, count)]


def measure_hdr_flip(reference: Float32, test: Float32) -> MetricMap:
    """Return the map of HDR-FLIP of scene-linear images, with any values.

    67 pixels per degree, ACES as the tone mapper, and `hdr_flip_exposures`: the package's defaults.
    The largest FLIP error of each pixel counts, 0 to 1. A black reference is compared as it is.
    """
    images = hdr_flip_colour(reference), hdr_flip_colour(test)
    error = np.zeros(reference.shape[:2], np.float32)
    for stops in hdr_flip_exposures(images[0]):
        _raise_flip_error(images, 2.0**stops, error)
    return MetricMap(error)


Metric = Callable[[Float32, Float32], MetricMap]

# Each compares a reference and a test image, both display-encoded, float32 [H, W, 3], 0 to 255;
# named as in `Score`.
METRICS: dict[str, Metric] = {
    "psnr_db": measure_psnr,
    "ssim": measure_ssim,
    "flip": measure_flip,
}

# Metrics that compare scene-linear images.
LINEAR_METRICS: dict[str, Metric] = {"hdr_flip": measure_hdr_flip}


def score_frame(
    reference: Float32,  # [H, W, 3 or more], scene-linear, as `test`
    test: Float32,
    mask: Bool | None,  # bool [H, W], the pixels of the second score
    names: Collection[str] = DEFAULT_METRICS,  # fields of `Score` to measure
) -> tuple[Score, Score | None]:
    """Score a frame against ground truth, over all its pixels and over a mask.

    Frames are float32 [H, W, 3 or more], scene-linear. The mask's score is None without a mask or
    with an empty one. Metrics of several frames (VMAF, flicker) are left to
    `exwarp_cli.pipeline.scoring`. No value is NaN or infinite, whatever the pixels are.
    """
    overall: dict[str, float] = {}
    masked: dict[str, float] = {}
    holes = mask if mask is not None and mask.any() else None
    encoded: tuple[Float32, Float32] | None = None
    for name in (*METRICS, *LINEAR_METRICS):
        if name not in names:
            continue
        if name in LINEAR_METRICS:
            metric_map = LINEAR_METRICS[name](reference, test)
        else:
            encoded = encoded or (encode_display(reference), encode_display(test))
            metric_map = METRICS[name](*encoded)
        overall[name] = metric_map.value()
        if holes is not None:
            masked[name] = metric_map.value(holes)
    if "pulse" in names:
        overall["pulse"] = pulse(mean_gradient(test), mean_gradient(reference))
    return Score(**overall), Score(**masked) if holes is not None else None


def score_like_extranet(reference: Float32, test: Float32) -> Score:
    """Score a frame, float32 [H, W, 3 or more], scene-linear, as ExtraNet's release does.

    PSNR is at most 100 dB, where theirs is infinite. SSIM is None for frames smaller than the
    window.
    """
    x, y = (round_display(pixels).astype(np.float64) for pixels in (reference, test))
    psnr_db = psnr_from_mse(float(np.mean((x - y) ** 2)))
    if min(x.shape[:2]) < WINDOW:
        return Score(psnr_db=psnr_db)
    # SSIM over whole windows only.
    mean_x, mean_y = _window_means(x), _window_means(y)
    count = WINDOW * WINDOW
    unbiased = count / (count - 1)
    variance_x = unbiased * (_window_means(x * x) - mean_x * mean_x)
    variance_y = unbiased * (_window_means(y * y) - mean_y * mean_y)
    covariance = unbiased * (_window_means(x * y) - mean_x * mean_y)
    top = (2 * mean_x * mean_y + SSIM_C1) * (2 * covariance + SSIM_C2)
    bottom = (mean_x**2 + mean_y**2 + SSIM_C1) * (variance_x + variance_y + SSIM_C2)
    return Score(psnr_db=psnr_db, ssim=float((top / bottom).mean()))


def _window_means(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the mean of every whole window of [H, W, C]; sums of integers, so exact."""
    sums = np.zeros((values.shape[0] + 1, values.shape[1] + 1, values.shape[2]))
    sums[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)
    n = WINDOW
    total: npt.NDArray[np.float64] = sums[n:, n:] - sums[:-n, n:] - sums[n:, :-n] + sums[:-n, :-n]
    return total / (n * n)
