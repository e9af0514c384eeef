"""Run times of the metrics at 1920x1080: SSIM beside scikit-image, and the parts of a score.

``python -m tests.bench.bench_metrics``
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from skimage.metrics import structural_similarity

from exwarp_cli.domain.colour import PEAK, encode_display
from exwarp_cli.domain.frame import Float32
from exwarp_cli.kernels import _row_bands
from exwarp_cli.kernels.picture_errors import SSIM_SIGMA, ssim_map
from exwarp_cli.metrics import registry, temporal
from exwarp_cli.metrics.registry import score_frame
from tests.bench import goals
from tests.bench.street import key_frame
from tests.bench.timing import Work, compare

GOALS = {"ssim_map": 1 / 8}
ROUNDS = 3
"""scikit-image takes seconds."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench.bench_metrics", __doc__, ROUNDS, threads=True)
    options = parser.parse_args(arguments)
    _row_bands.set_threads(options.threads)
    linear = [np.ascontiguousarray(key_frame(i).image.pixels[..., :3]) for i in (1, 2)]
    shown, judged = (encode_display(image) for image in linear)
    ratios = compare(_ssim(shown, judged), options.rounds)
    title = f"SSIM, {options.threads} threads, {options.rounds} rounds"
    figures = goals.table("metrics", title, "scikit-image", ratios, GOALS)
    parts = compare(_scoring(linear[0], linear[1]), options.rounds)
    figures += goals.table("metrics", "a frame's score", "score()", parts, {})
    return goals.finish(figures, options)


def _ssim(reference: Float32, test: Float32) -> dict[str, tuple[Work, Work]]:
    """Return SSIM maps of display-encoded images."""
    doubles = [image.astype(np.float64) for image in (reference, test)]

    def peer() -> object:
        return structural_similarity(
            *doubles,
            channel_axis=-1,
            gaussian_weights=True,
            sigma=SSIM_SIGMA,
            use_sample_covariance=False,
            data_range=PEAK,
            full=True,
        )

    return {
        "ssim_map": (lambda: ssim_map(reference, test), peer),
    }


def _scoring(reference: Float32, test: Float32) -> dict[str, tuple[Work, Work]]:
    """Parts of a frame's score."""
    shown, judged = encode_display(reference), encode_display(test)

    def whole() -> object:
        return score_frame(reference, test, None)

    return {
        "encode, both frames": (lambda: (encode_display(reference), encode_display(test)), whole),
        "PSNR": (lambda: registry.measure_psnr(shown, judged).value(), whole),
        "SSIM": (lambda: registry.measure_ssim(shown, judged).value(), whole),
        "FLIP": (lambda: registry.measure_flip(shown, judged).value(), whole),
        "pulse": (lambda: temporal.pulse(*map(temporal.mean_gradient, (test, reference))), whole),
    }


if __name__ == "__main__":
    sys.exit(main())
