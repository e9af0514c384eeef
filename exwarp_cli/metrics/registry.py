"""The metrics by name, and the score of a frame that is made of them."""

from __future__ import annotations

from collections.abc import Callable, Collection

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.metric import DEFAULT_METRICS
from exwarp_cli.domain.results import Score
from exwarp_cli.metrics import flip, hdr_flip, psnr, pulse, ssim
from exwarp_cli.metrics.display import Measured, encode

Metric = Callable[[Float32, Float32], Measured]

METRICS: dict[str, Metric] = {
    "psnr_db": psnr.measure,
    "ssim": ssim.measure,
    "flip": flip.measure,
}
"""Each compares a reference and a test image, both display-encoded; named as in `Score`."""

LINEAR_METRICS: dict[str, Metric] = {"hdr_flip": hdr_flip.measure}
"""The same for those that compare scene-linear images."""

FRAME_METRICS: dict[str, Callable[[Float32, Float32], float]] = {"pulse": pulse.measure}
"""Those of whole frames, which compare scene-linear images and have no map."""


def score(
    reference: Float32,
    test: Float32,
    mask: Bool | None,
    names: Collection[str] = DEFAULT_METRICS,
) -> tuple[Score, Score | None]:
    """Score a frame against ground truth, over all its pixels and over a mask.

    Parameters
    ----------
    reference, test
        float32 [H, W, 3] or more, scene-linear, of one height and width; see
        `exwarp_cli.metrics.display.encode` and `exwarp_cli.metrics.hdr_flip.usable` for what
        becomes of values that a display cannot show.
    mask
        bool [H, W], the pixels of the second score.
    names
        What is measured, as in `Score`. What takes several frames (VMAF, flicker) is left to
        `exwarp_cli.pipeline.scoring`.

    Returns
    -------
    tuple of Score, and Score or None
        Over all pixels, and over the mask; None without a mask or with an empty one. No value is
        NaN or infinite, whatever the pixels are.
    """
    everywhere: dict[str, float] = {}
    masked: dict[str, float] = {}
    holes = mask if mask is not None and mask.any() else None
    encoded: tuple[Float32, Float32] | None = None
    for name in (*METRICS, *LINEAR_METRICS):
        if name not in names:
            continue
        if name in LINEAR_METRICS:
            measured = LINEAR_METRICS[name](reference, test)
        else:
            encoded = encoded or (encode(reference), encode(test))
            measured = METRICS[name](*encoded)
        everywhere[name] = measured.overall()
        if holes is not None:
            masked[name] = measured.within(holes)
    everywhere |= {name: f(reference, test) for name, f in FRAME_METRICS.items() if name in names}
    return Score(**everywhere), Score(**masked) if holes is not None else None
