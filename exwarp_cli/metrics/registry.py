"""The metrics by name, and the score of a frame that is made of them."""

from __future__ import annotations

from collections.abc import Callable

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.results import Score
from exwarp_cli.metrics import flip, psnr, ssim
from exwarp_cli.metrics.display import encode
from exwarp_cli.metrics.measured import Measured

Metric = Callable[[Float32, Float32], Measured]

METRICS: dict[str, Metric] = {
    "psnr_db": psnr.measure,
    "ssim": ssim.measure,
    "flip": flip.measure,
}
"""Each compares a reference and a test image, both display-encoded; named as in `Score`."""


def score(reference: Float32, test: Float32, mask: Bool | None) -> tuple[Score, Score | None]:
    """Score a frame against ground truth, over all its pixels and over a mask.

    Parameters
    ----------
    reference, test
        float32 [H, W, 3] or more, scene-linear, of one height and width; see
        `exwarp_cli.metrics.display.encode` for what becomes of values that a display cannot show.
    mask
        bool [H, W], the pixels of the second score.

    Returns
    -------
    tuple of Score, and Score or None
        Over all pixels, and over the mask; None without a mask or with an empty one. No value is
        NaN or infinite, whatever the pixels are.
    """
    shown, judged = encode(reference), encode(test)
    everywhere: dict[str, float] = {}
    masked: dict[str, float] = {}
    holes = mask if mask is not None and mask.any() else None
    for name, metric in METRICS.items():
        measured = metric(shown, judged)
        everywhere[name] = measured.overall()
        if holes is not None:
            masked[name] = measured.within(holes)
    return Score(**everywhere), Score(**masked) if holes is not None else None
