"""Run times of what the features are made of, beside OpenCV and SciPy, and of all features.

``python -m tests.bench.bench_features``. Objects are labelled at 1920x1080; OpenCV labels the
mask of them, which is less: it need not tell touching objects apart. Distances are those of two
frames of the rendered example, enlarged to 854x480: SciPy sorts all samples, which is over sooner
where they are as alike as a synthetic scene's. They are laid out for it beforehand.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
from scipy.stats import wasserstein_distance

from exwarp_cli.domain.frame import GBuffer, Int32
from exwarp_cli.kernels import _row_bands, connected_components, frame_statistics
from exwarp_cli.policy.state import observe
from exwarp_cli.synthesis.motion_fields import settle_motion
from tests.bench import goals
from tests.bench.big_input import FAR
from tests.bench.running import module, run
from tests.bench.street import SIZE, key_frame
from tests.bench.timing import ROUNDS, Work, compare

LABELLING_GOALS = {"areas, a block": 1.5, "areas, forty discs": 1.5}
EMD_GOALS = {"distances, normals": 1 / 50, "distances, positions": 1 / 50}
LINES = 480
DISCS = 40
SPAN = 4


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench.bench_features", __doc__, ROUNDS, threads=True)
    options = parser.parse_args(arguments)
    _row_bands.set_threads(options.threads)
    cv2.setNumThreads(options.threads)
    ran = f"{options.threads} threads, {options.rounds} rounds"
    large = [_gbuffer(instant, SIZE) for instant in (1, 2)]
    assert large[1].stencil is not None
    works = {
        "areas, a block": _labelling(large[1].stencil),
        "areas, forty discs": _labelling(_discs()),
    }
    ratios = compare(works, options.rounds)
    title = f"objects at {SIZE[1]}x{SIZE[0]}, {ran}"
    base = "cv2.connectedComponents"
    figures = goals.table("features", title, base, ratios, LABELLING_GOALS)
    ratios = compare(_distances(), max(3, options.rounds // 2))
    title = f"earth mover's distances at 854x{LINES}, {ran}"
    figures += goals.table("features", title, "scipy", ratios, EMD_GOALS)
    ratios = compare(_parts(large[0], large[1]), options.rounds)
    figures += goals.table("features", f"all features, {ran}", "observe()", ratios, {})
    return goals.finish(figures, options)


def _gbuffer(instant: int, size: tuple[int, int]) -> GBuffer:
    gbuffer = key_frame(instant, size=size).gbuffer
    assert gbuffer is not None
    return settle_motion(gbuffer)


def _labelling(stencil: Int32) -> tuple[Work, Work]:
    areas = np.empty(stencil.size + 1, np.int64)
    mask = (stencil > 0).astype(np.uint8)
    theirs = np.empty(stencil.shape, np.int32)

    def ours() -> int:
        return connected_components.measure_component_areas(stencil, areas) - 1

    def peer() -> int:
        return cv2.connectedComponents(mask, theirs, 8, cv2.CV_32S)[0] - 1

    if not ours() >= peer() >= 1:
        raise RuntimeError(f"{ours()} objects, where their mask has {peer()} areas")
    return ours, peer


def _discs() -> Int32:
    """Return ids of seeded discs that lie over one another."""
    seeded = np.random.default_rng(0)
    stencil = np.zeros(SIZE, np.int32)
    for ident in range(1, DISCS + 1):
        centre = [int(seeded.integers(0, end)) for end in SIZE[::-1]]
        cv2.circle(stencil, centre, int(seeded.integers(20, 160)), ident, cv2.FILLED)
    return stencil


def _distances() -> dict[str, tuple[Work, Work]]:
    """Distances of two frames' three channels, without the background."""
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        run(module("tests.bench.big_input", folder, "--height", str(LINES), "--count", "2"))
        before, now = (_planes(file) for file in sorted(Path(folder).iterdir()))
    shown = [planes["Depth.Z"] < FAR for planes in (before, now)]
    works: dict[str, tuple[Work, Work]] = {}
    for layer in ("Normal", "Position"):
        pair = [
            np.stack([planes[f"{layer}.{axis}"] for axis in "XYZ"], axis=-1)
            for planes in (before, now)
        ]
        laid = [
            tuple(values[where][:, c].copy() for values, where in zip(pair, shown, strict=True))
            for c in range(3)
        ]
        works[f"distances, {layer.lower()}s"] = (
            lambda pair=pair: frame_statistics.earth_movers_distances(
                *map(frame_statistics.ValueDistribution, pair, shown)
            ),
            lambda laid=laid: [wasserstein_distance(*samples) for samples in laid],
        )
    return works


def _planes(file: Path) -> dict[str, np.ndarray]:
    """Read channels by layer and component."""
    with OpenEXR.File(str(file), separate_channels=True) as opened:
        return {
            ".".join(name.split(".")[-2:]): np.array(channel.pixels)
            for part in opened.parts
            for name, channel in part.channels.items()
        }


def _parts(before: GBuffer, now: GBuffer) -> dict[str, tuple[Work, Work]]:
    """Features without one of their parts, so that what is missing shows the part's share."""

    def whole() -> object:
        return observe(now, before, SPAN)

    lacking = {
        "without objects": replace(now, stencil=None),
        "without normals": replace(now, normal=None),
        "without positions": replace(now, position=None),
    }
    works: dict[str, tuple[Work, Work]] = {
        name: (lambda less=less: observe(less, before, SPAN), whole)
        for name, less in lacking.items()
    }
    return {**works, "with nothing before": (lambda: observe(now, None, SPAN), whole)}


if __name__ == "__main__":
    sys.exit(main())
