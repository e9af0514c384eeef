"""Crops of rendered scenes to train an extrapolation network with, kept on disk."""

from __future__ import annotations

import hashlib
import json
import math
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from exwarp_cli.domain.frame import Float32, Window
from exwarp_cli.domain.network_api import HISTORY_FRAMES
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import InputError
from exwarp_cli.io.atomic import make_folder, output_error
from exwarp_cli.io.dataset import RenderedScene, SceneManifest
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.extrapolate import Prepared
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.training.footage import Footage
from exwarp_cli.training.looks import Look, draw_look
from exwarp_cli.training.variant import Variant

VERSION = 11
"""Of what is kept; crops of another version are made again."""

CROPS = 4
"""Of each frame."""

SLOTS = (0.2, 0.4, 0.4)
"""How often slots 1 to 3 are chosen: no path of decisions extrapolates to the first."""

SETTINGS = {"key": 0.75, "slot": 0.25}
"""How often the settings are chosen: with key G-buffers alone, holes are harder."""

IN_HOLES = 0.5
"""Share of crops whose middle lies in a hole, if the frame has any: few pixels of a slow shot do,
but its holes count as much as those of a fast one."""

MOTION_WEIGHT = 1.0
"""How much more likely than still pixels those of the frame's mean motion are to be the middle of
the other crops."""

SHORT_HISTORY = 0.25
"""How likely a frame with fewer than three key frames behind it is chosen, against another one."""

PARTIAL = 0.5
SMALLEST = 0.5
"""Share of frames of which only a part is looked at, and how small its sides may be, as a share of
the frame's: what lies beyond the edge of the frame is the hardest to foretell, and all that
rendering says about it is at the edges of what was rendered."""

MOST_LINEAR = 6e4
"""Linear values are clipped there: half floats end at 65504."""


@dataclass(frozen=True)
class Choice:
    """One frame to take crops of.

    Attributes
    ----------
    variant
        Of the scene.
    k, slot
        Key interval and slot, 1 to 3.
    setting
        "key" or "slot".
    look
        How its frames are delivered.
    """

    variant: Variant
    k: int
    slot: int
    setting: str
    look: Look


SHORT = 16
"""Steps of a scene that as many frames are drawn from as the settings say."""


def share(frames: int, count: int) -> int:
    """Return how many frames to draw of so many instants: longer shots repeat themselves."""
    return round(frames * math.sqrt(max((count - 1) / SHORT, 1)))


def choices(manifest: SceneManifest, frames: int, seed: int, side: int = 1) -> list[Choice]:
    """Choose frames of a scene, always the same ones for the same seed and name.

    Parameters
    ----------
    manifest
        Of the scene; of scenes alike but for the name, other frames are chosen.
    frames
        How many to draw; of one that is drawn twice other crops are taken.
    seed
        Of the choice.
    side
        Height and width of the crops that a frame of any look has to hold, pixels.
    """
    rng = _generator(seed, manifest.scene, 0)
    can_halve = min(manifest.width, manifest.height) >= 2 * side
    variants = [Variant(p, backwards=b) for p in range(FACTOR) for b in (False, True)]
    places = {
        setting: [(v, k) for v in variants for k in _intervals(v, manifest, setting)]
        for setting in SETTINGS
    }
    likely = {
        setting: np.array(
            [1.0 if k >= HISTORY_FRAMES - 1 else SHORT_HISTORY for _, k in of_setting]
        )
        for setting, of_setting in places.items()
    }
    found = []
    for _ in range(frames):
        setting = str(rng.choice(list(SETTINGS), p=list(SETTINGS.values())))
        setting = setting if places[setting] else "slot"
        share_of = likely[setting] / likely[setting].sum()
        variant, k = places[setting][int(rng.choice(len(share_of), p=share_of))]
        slot = 1 + int(rng.choice(len(SLOTS), p=SLOTS))
        found.append(Choice(variant, k, slot, setting, draw_look(rng, can_halve)))
    order = {variant: i for i, variant in enumerate(variants)}
    return sorted(found, key=lambda c: (order[c.variant], c.k, c.setting, c.slot))


def _intervals(variant: Variant, manifest: SceneManifest, setting: str) -> list[int]:
    """Return the key intervals of a variant that are whole.

    With key G-buffers alone the motion to the next key frame has to be known too: without it W is
    some decibels worse, as it is for users at the last key frame only.
    """
    order = variant.order(manifest.instants.count)
    return [
        k
        for k in range(len(order) // FACTOR)
        if setting == "slot" or FACTOR * (k + 1) < len(order) or manifest.has_key(order[FACTOR * k])
    ]


@dataclass(frozen=True)
class CropSettings:
    """Which crops are made of a scene.

    Attributes
    ----------
    frames
        How many frames are prepared of SHORT steps, at most; of longer scenes more, by the square
        root of their length.
    side
        Height and width of a crop, pixels: S below.
    seed
        Of what is chosen.
    """

    frames: int
    side: int
    seed: int


def crops_of(scene: RenderedScene, settings: CropSettings) -> dict[str, np.ndarray]:
    """Prepare frames of a scene as a user's run would, and cut crops out of them.

    Returns
    -------
    dict
        ``colour`` float16 [N, 12, S, S] (filled warp, then F_k, F_k-1, F_k-2 moved to the slot, as
        the network sees them), ``mask`` uint8 [N, 3, S, S] (of the last three), ``features``
        float16 [N, 6, S, S], ``modulation`` and ``target`` float16 [N, 3, S, S] (linear), ``time``
        float32 [N].

    Raises
    ------
    InputError
        When the scene is smaller than a crop.
    """
    manifest, side = scene.manifest, settings.side
    if min(manifest.width, manifest.height) < side:
        raise InputError(
            f"{scene.folder} is {manifest.width}x{manifest.height}, smaller than crops of {side} "
            "pixels; leave it out, or take smaller crops"
        )
    rng = _generator(settings.seed, scene.name, 1)
    parts: dict[str, list[np.ndarray]] = {}
    count = share(settings.frames, manifest.instants.count)
    for footage, choice in _played(scene, choices(manifest, count, settings.seed, side)):
        interval = footage.causal(choice.k, choice.setting)
        view = _view(interval.key.image.data_window, side, rng)
        interval = interval.on(view)
        truth = footage.truth(choice.k, choice.slot).on(view).pixels[..., :3]
        planes = _planes(interval.prepared(choice.slot), truth)
        weight = _weight(interval, choice.slot)
        for _ in range(CROPS):
            y, x = _corner(weight, side, rng)
            for name, array in planes.items():
                cut = array[:, y : y + side, x : x + side]
                parts.setdefault(name, []).append(cut.copy())
            parts.setdefault("time", []).append(np.array(choice.slot / FACTOR, np.float32))
        check_stop()
    return {name: np.stack(arrays) for name, arrays in parts.items()}


def crops_folder(scene: RenderedScene, settings: CropSettings, cache: Path) -> Path:
    """Return where in a cache a scene's crops lie; those of other settings lie beside them."""
    token = {
        "version": VERSION, "crops": CROPS, "settings": asdict(settings),
        "manifest": asdict(scene.manifest),
    }  # fmt: skip
    return cache / f"{scene.name}-{digest_of(token)}"


def digest_of(token: Mapping[str, object]) -> str:
    """Return a short digest of what decides what is kept."""
    text = json.dumps(token, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def is_whole(folder: Path) -> bool:
    """Whether arrays were written there to the end."""
    return folder.exists()


def write_crops(scene: RenderedScene, settings: CropSettings, folder: Path) -> None:
    """Make a scene's crops (:func:`crops_of`) and write them, see `write_arrays`."""
    write_arrays(crops_of(scene, settings), folder)


def write_arrays(arrays: Mapping[str, np.ndarray], folder: Path) -> None:
    """Write arrays, one ``.npy`` each.

    The folder appears when it is whole: trainings may share a cache.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    make_folder(folder.parent)
    try:
        with TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as temporary:
            made = Path(temporary) / "arrays"
            made.mkdir()
            for name, array in arrays.items():
                np.save(made / f"{name}.npy", array)
            if not is_whole(folder):
                made.rename(folder)
    except OSError as error:
        if not is_whole(folder):  # else another training was faster
            raise output_error(folder, error) from error


def _generator(seed: int, name: str, use: int) -> np.random.Generator:
    """Return random numbers that are others for every scene and every use."""
    return np.random.default_rng((seed, zlib.crc32(name.encode()), use))


def _view(whole: Window, side: int, rng: np.random.Generator) -> Window:
    """Choose what of a frame is looked at: all of it, or a part that crops fit in."""
    if rng.random() >= PARTIAL:
        return whole
    width, height = (
        max(side, round(size * rng.uniform(SMALLEST, 1))) for size in (whole.width, whole.height)
    )
    x, y = rng.integers(whole.width - width + 1), rng.integers(whole.height - height + 1)
    return Window(whole.x + int(x), whole.y + int(y), width, height)


def _played(scene: RenderedScene, chosen: list[Choice]) -> Iterator[tuple[Footage, Choice]]:
    """Yield each choice with footage in its variant and look; they share what was read."""
    footage = Footage(scene)
    for choice in chosen:
        footage = footage.seen_as(choice.variant, choice.look)
        yield footage, choice


def _planes(prepared: Prepared, truth: Float32) -> dict[str, np.ndarray]:
    inputs = prepared.inputs.part(slice(None), slice(None))
    history = inputs.history.reshape(HISTORY_FRAMES, 4, *inputs.history.shape[1:])
    colour = np.concatenate([inputs.warped[3:], *history[:, :3]])
    modulation = prepared.modulation
    if modulation is None:
        modulation = np.ones_like(truth)
    # What was not rendered rightly is nothing to learn from.
    truth = np.where(np.isfinite(truth), truth, prepared.finish(inputs.warped[3:])[..., :3])
    return {
        "colour": colour.astype(np.float16),
        "mask": history[:, 3].astype(np.uint8),
        "features": inputs.features.astype(np.float16),
        "modulation": _half(modulation),
        "target": _half(truth),
    }


def _half(linear: Float32) -> np.ndarray:
    return np.clip(linear, -MOST_LINEAR, MOST_LINEAR).transpose(2, 0, 1).astype(np.float16)


def _weight(interval: Interval, slot: int) -> Float32:
    """How likely each pixel is to be the middle of a crop, float32 [H, W]."""
    back = interval.back(slot)
    motion = np.nan_to_num(np.hypot(back.field[..., 0], back.field[..., 1]))
    mean = max(float(motion.mean()), 0.25)
    weight = 1 + MOTION_WEIGHT * np.minimum(motion / mean, 4)
    weight /= weight.sum()
    if back.hole.any():
        weight += IN_HOLES / (1 - IN_HOLES) * back.hole / back.hole.sum()
    return np.asarray(weight, np.float32)


def _corner(weight: Float32, side: int, rng: np.random.Generator) -> tuple[int, int]:
    """Draw the upper left corner (row, column) of a crop by the weight of its middle."""
    height, width = weight.shape
    total = np.cumsum(weight.ravel(), dtype=np.float64)
    index = int(np.searchsorted(total, rng.random() * total[-1]))
    y, x = divmod(min(index, weight.size - 1), width)
    return (
        int(np.clip(y - side // 2, 0, height - side)),
        int(np.clip(x - side // 2, 0, width - side)),
    )
