"""What is hard in the training shots: motion, holes, moving shadows, reflections, thin things."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from stage import manifest as stage_manifest

from exwarp_cli.domain.frame import Float32, KeyFrame
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.dataset import RenderedScene
from exwarp_cli.research.training.scene_clip import SceneClip

LUMINANCE = np.array((0.2126, 0.7152, 0.0722), np.float32)
CHANGE = 1.25
"""By what factor light on a still surface must change to count; noise of 33 dB stays below it."""

BLACK = 0.01
"""Scene-linear light that is added on both sides: changes in the dark are not seen."""

MATTE = 0.15
"""Roughness above which a surface has shadows, and below which it has reflections."""

SAME = 0.02
"""Share of its depth by which a place may be off and still be the same surface."""

THIN = 0.05
"""Share by which thin things are nearer than what is 2 pixels beside them on both sides."""

MUCH = 0.005
"""Share of the picture from which moving shadows count as seen."""


def measure(shot: RenderedScene) -> dict[str, Any]:
    """Measure one shot that is rendered in full; shares are of the picture."""
    shot.require_complete()
    footage = SceneClip(shot)
    lengths, shares = [], []
    for k in footage.intervals:
        key, after = footage.key(k), footage.key(k + 1)
        assert key.gbuffer is not None and key.gbuffer.to_next is not None
        lengths.append(np.linalg.norm(key.gbuffer.to_next, axis=-1))
        shadow, mirrored = changed_light(key, after)
        shares.append((shadow.mean(), mirrored.mean(), thin(key).mean(), _moving(key)))
    masks = (footage.interval(k, "slot").hole_mask(i) for k in footage.intervals for i in _SLOTS)
    means = np.mean(shares, axis=0)
    content = json.loads((shot.folder / stage_manifest.NAME).read_text(encoding="utf-8"))
    return {
        "shot": shot.name,
        "place": shot.manifest.about.rpartition(": ")[2].rstrip("."),
        "engine": shot.manifest.renderer.rpartition(" ")[2],
        "motion_median_px": round(float(np.nanmedian(lengths)), 2),
        "motion_p99_px": round(float(np.nanpercentile(lengths, 99)), 1),
        "hole_share": round(float(np.mean([m.mean() for m in masks if m is not None])), 4),
        "shadow_share": round(float(means[0]), 4),
        "reflection_share": round(float(means[1]), 4),
        "thin_share": round(float(means[2]), 4),
        "moving_share": round(float(means[3]), 4),
        "dynamic_objects": len(shot.manifest.dynamic),
        "features": content.get("features", []),
        "real_things": len(content.get("things", [])),
    }


_SLOTS = range(1, FACTOR)


def _moving(key: KeyFrame) -> float:
    assert key.gbuffer is not None and key.gbuffer.stencil is not None
    return float((key.gbuffer.stencil != 0).mean())


def changed_light(first: KeyFrame, second: KeyFrame) -> tuple[np.ndarray, np.ndarray]:
    """Find still places that both frames see and whose light differs.

    Light is colour over diffuse colour, each a mean of 3x3 pixels, so that textures do not count.
    A place is the same where the vector leads to the same position in the world and both have
    object id 0.

    Parameters
    ----------
    first, second : KeyFrame
        With all G-buffers; the first one's vectors lead to the second.

    Returns
    -------
    tuple of ndarray
        bool [H, W] each: matte surfaces (moving shadows), and glossy ones (moving reflections).
    """
    here, there = first.gbuffer, second.gbuffer
    assert here is not None and there is not None and here.to_next is not None
    assert here.position is not None and there.position is not None and here.depth is not None
    rows, columns = np.indices(here.depth.shape, np.float32)
    target = np.stack([columns, rows], axis=-1) + np.nan_to_num(here.to_next)
    found = sample(there.position, target)
    gap = np.linalg.norm(found - here.position, axis=-1)
    near = gap < SAME * np.where(np.isfinite(here.depth), here.depth, 0.0)
    led = sample(_still(second).astype(np.float32)[..., None], target)[..., 0]
    same = near & _still(first) & (led > 0.99)
    before = _light(first)
    after = sample(_light(second)[..., None], target)[..., 0]
    ratio = (after + BLACK) / (before + BLACK)
    differs = same & (np.maximum(ratio, 1 / np.maximum(ratio, 1e-6)) > CHANGE)
    assert here.roughness is not None and here.metallic is not None
    matte = (here.roughness > MATTE) & (here.metallic < 0.5)
    # Single pixels are the edges of still shadows, and noise.
    return _gathered(differs & matte), _gathered(differs & ~matte)


def _gathered(marked: np.ndarray) -> np.ndarray:
    """Keep marked pixels with at least four marked neighbours."""
    return marked & (_around(marked.astype(np.int32), np.sum) >= 5)


def _still(frame: KeyFrame) -> np.ndarray:
    """Find pixels all of whose neighbours stand still and lie about as deep."""
    assert frame.gbuffer is not None and frame.gbuffer.depth is not None
    assert frame.gbuffer.stencil is not None
    depth = np.where(np.isfinite(frame.gbuffer.depth), frame.gbuffer.depth, 1e6)
    smooth = _around(depth, np.max) < 1.15 * _around(depth, np.min)
    return smooth & (_around(frame.gbuffer.stencil, np.max) == 0) & (depth < 1e5)


def _light(frame: KeyFrame) -> Float32:
    assert frame.gbuffer is not None and frame.gbuffer.albedo is not None
    colour = frame.image.pixels[..., :3] @ LUMINANCE
    albedo = frame.gbuffer.albedo @ LUMINANCE
    light: Float32 = _around(colour, np.mean) / np.maximum(_around(albedo, np.mean), 0.02)
    return light


def _around(values: np.ndarray, combine: Callable[..., np.ndarray]) -> np.ndarray:
    """Combine each pixel with its 8 neighbours; edges are repeated."""
    padded = np.pad(values, 1, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    return combine(windows, axis=(-2, -1))


def sample(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Sample [H, W, C] bilinearly at pixel places [H, W, 2] (x, y); NaN outside the picture."""
    high, wide = values.shape[:2]
    x, y = where[..., 0], where[..., 1]
    inside = (x >= 0) & (x <= wide - 1) & (y >= 0) & (y <= high - 1)
    x, y = np.where(inside, x, 0), np.where(inside, y, 0)
    left, top = np.minimum(x.astype(int), wide - 2), np.minimum(y.astype(int), high - 2)
    across, down = (x - left)[..., None], (y - top)[..., None]
    upper = values[top, left] * (1 - across) + values[top, left + 1] * across
    lower = values[top + 1, left] * (1 - across) + values[top + 1, left + 1] * across
    found = upper * (1 - down) + lower * down
    return np.where(inside[..., None], found, np.nan)


def thin(frame: KeyFrame) -> np.ndarray:
    """Find what is nearer than its surroundings on both sides, 2 pixels away: bool [H, W]."""
    assert frame.gbuffer is not None and frame.gbuffer.depth is not None
    depth = np.minimum(np.nan_to_num(frame.gbuffer.depth, posinf=1e6), 1e6) * (1 + THIN)
    found = np.zeros(depth.shape, np.bool_)
    far = frame.gbuffer.depth
    found[:, 2:-2] |= (depth[:, 2:-2] < far[:, :-4]) & (depth[:, 2:-2] < far[:, 4:])
    found[2:-2] |= (depth[2:-2] < far[:-4]) & (depth[2:-2] < far[4:])
    return found


SPREADS = (
    ("motion per key interval, median px", "motion_median_px"),
    ("the same, 99th percentile", "motion_p99_px"),
    ("hole share, slot G-buffers", "hole_share"),
    ("moving shadows on still ground, share of the picture", "shadow_share"),
    ("moving reflections on still things, share", "reflection_share"),
    ("thin things, share", "thin_share"),
    ("moving things, share", "moving_share"),
    ("moving objects", "dynamic_objects"),
    ("real things", "real_things"),
)
"""What differs from shot to shot: words, and the key of a row."""


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Sum up the rows of `measure`."""
    features = Counter(feature for row in rows for feature in row["features"])
    return {
        **{key: spread([row[key] for row in rows]) for _, key in SPREADS},
        "shots_with_shadows": sum(row["shadow_share"] >= MUCH for row in rows),
        "features": dict(sorted(features.items())),
        "engines": dict(Counter(row["engine"] for row in rows).most_common()),
        "places": dict(sorted(Counter(row["place"] for row in rows).items())),
    }


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return percentiles of values."""
    names = ("least", "p10", "median", "p90", "most")
    found = np.percentile(values, (0, 10, 50, 90, 100))
    return {name: round(float(value), 4) for name, value in zip(names, found, strict=True)}


def write_rows(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Write one line a shot as a Markdown table."""
    lines = ["# The training shots, one by one", "", "Written by `survey.py --training`.", ""]
    lines += [
        "Shares are percents of the picture; motion is in pixels per key interval.",
        "",
        "| shot | place | engine | motion, median | 99 % | holes | moving shadows | reflections "
        "| thin | moving | objects | real things | features |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    shares = ("hole_share", "shadow_share", "reflection_share", "thin_share", "moving_share")
    for row in rows:
        cells = [row["shot"], row["place"], row["engine"]]
        cells += [f"{row['motion_median_px']:.1f}", f"{row['motion_p99_px']:.0f}"]
        cells += [f"{100 * row[key]:.1f}" for key in shares]
        cells += [str(row["dynamic_objects"]), str(row["real_things"]), ", ".join(row["features"])]
        lines.append(f"| {' | '.join(cells)} |")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
