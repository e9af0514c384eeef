"""Run times of the metrics at 1920x1080: SSIM beside scikit-image, and the parts of a score.

``python -m tests.bench.bench_metrics``
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from skimage.metrics import structural_similarity

from exwarp_cli.domain.frame import Float32
from exwarp_cli.kernels import _row_bands
from exwarp_cli.kernels.ssim import SIGMA, ssim_map
from exwarp_cli.metrics import flip, psnr, pulse, ssim
from exwarp_cli.metrics.display import PEAK, encode
from exwarp_cli.metrics.registry import score
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
    shown, judged = (encode(image) for image in linear)
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
            sigma=SIGMA,
            use_sample_covariance=False,
            data_range=PEAK,
            full=True,
        )

    return {
        "ssim_map": (lambda: ssim_map(reference, test), peer),
    }


def _scoring(reference: Float32, test: Float32) -> dict[str, tuple[Work, Work]]:
    """Parts of a frame's score."""
    shown, judged = encode(reference), encode(test)

    def whole() -> object:
        return score(reference, test, None)

    return {
        "encode, both frames": (lambda: (encode(reference), encode(test)), whole),
        "PSNR": (lambda: psnr.measure(shown, judged).overall(), whole),
        "SSIM": (lambda: ssim.measure(shown, judged).overall(), whole),
        "FLIP": (lambda: flip.measure(shown, judged).overall(), whole),
        "pulse": (lambda: pulse.measure(reference, test), whole),
    }


if __name__ == "__main__":
    sys.exit(main())
