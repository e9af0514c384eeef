"""Crops of rendered scenes to train an extrapolation network with, cached on disk."""

from __future__ import annotations

import hashlib
import json
import math
import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from exwarp_cli.domain.frame import Float32, Window
from exwarp_cli.domain.network_api import HISTORY_FRAMES
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import InputError
from exwarp_cli.io.dataset import RenderedScene, SceneManifest
from exwarp_cli.io.files import make_folder, output_error
from exwarp_cli.research.training.augmentation import Look, Variant, draw_look
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.research.training.training_settings import ExtrapolatorSettings
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis import extrapolation
from exwarp_cli.synthesis.interval import Interval

# Of what is cached; crops of another version are made again.
VERSION = 12

# Crops of each frame.
CROPS = 4

# How often slots 1 to 3 are chosen: no path of decisions extrapolates to the first.
SLOTS = (0.2, 0.4, 0.4)

# How often the settings are chosen: with key G-buffers alone, holes are harder.
SETTINGS = {"key": 0.75, "slot": 0.25}

# Share of crops whose middle lies in a hole, if the frame has any: few pixels of a slow shot do,
# but its holes count as much as those of a fast one.
IN_HOLES = 0.5

# How much more likely pixels of the frame's mean motion are to be the middle of the other crops
# than still ones.
MOTION_WEIGHT = 1.0

# Likelihood of a frame with fewer than three key frames behind it, against another one.
SHORT_HISTORY = 0.25

# Share of frames of which only a part is used, and the least size of its sides as a share of
# the frame's. What lies beyond the edge of the frame is the hardest to predict, and a render shows
# it at its own edges only.
PARTIAL = 0.5
SMALLEST = 0.5

# Linear values are clipped there: half floats end at 65504.
MOST_LINEAR = 6e4

# Steps of a scene that as many frames are drawn from as the settings say.
SHORT = 16

# How often roughness and metallic are left out together, normals, and depth.
NO_MATERIAL = 0.3
NO_NORMAL = 0.1
NO_DEPTH = 0.05

# Stops by which exposure is varied, up and down.
EXPOSURE = 1.0

# How far patches are drawn beyond a crop's edge before they are moved inside, as a share of their
# size: else the frame's own edge, where much is hidden, is hardly ever at that of a patch.
OVERHANG = 0.5


@dataclass(frozen=True)
class FrameChoice:
    """One frame to take crops of: slot 1 to 3 of key interval k, in the setting "key" or "slot"."""

    variant: Variant
    k: int
    slot: int
    setting: str
    look: Look


def choose_frames(manifest: SceneManifest, settings: ExtrapolatorSettings) -> list[FrameChoice]:
    """Choose frames of a scene, always the same ones for the same seed and name.

    Of a frame that is drawn twice other crops are taken. A frame of any look holds a crop.
    """
    # Numbers differ for every scene and every use: 0 for frames, 1 for crops.
    rng = np.random.default_rng((settings.seed, zlib.crc32(manifest.scene.encode()), 0))
    can_halve = min(manifest.width, manifest.height) >= 2 * settings.side
    # Of longer scenes more, by the square root of their length, as longer shots repeat themselves.
    frames = round(settings.frames * math.sqrt(max((manifest.instants.count - 1) / SHORT, 1)))
    variants = [Variant(p, backwards=b) for p in range(FACTOR) for b in (False, True)]
    places: dict[str, list[tuple[Variant, int]]] = {setting: [] for setting in SETTINGS}
    for variant in variants:
        instants = variant.order(manifest.instants.count)
        for k in range(len(instants) // FACTOR):
            places["slot"].append((variant, k))
            # With key G-buffers alone the motion to the next key frame has to be known too: without
            # it W is some decibels worse, as it is for users at the last key frame only.
            if FACTOR * (k + 1) < len(instants) or manifest.has_key(instants[FACTOR * k]):
                places["key"].append((variant, k))
    choices = []
    for _ in range(frames):
        setting = str(rng.choice(list(SETTINGS), p=list(SETTINGS.values())))
        setting = setting if places[setting] else "slot"
        likelihood = np.array(
            [1.0 if k >= HISTORY_FRAMES - 1 else SHORT_HISTORY for _, k in places[setting]]
        )
        likelihood /= likelihood.sum()
        variant, k = places[setting][int(rng.choice(len(likelihood), p=likelihood))]
        slot = 1 + int(rng.choice(len(SLOTS), p=SLOTS))
        choices.append(FrameChoice(variant, k, slot, setting, draw_look(rng, can_halve)))
    return sorted(choices, key=lambda c: (variants.index(c.variant), c.k, c.setting, c.slot))


def _draw_view(frame: Window, side: int, rng: np.random.Generator) -> Window:
    """Choose the part of a frame that is used: all of it, or a window that crops fit in."""
    if rng.random() >= PARTIAL:
        return frame
    width, height = (
        max(side, round(size * rng.uniform(SMALLEST, 1))) for size in (frame.width, frame.height)
    )
    x, y = rng.integers(frame.width - width + 1), rng.integers(frame.height - height + 1)
    return Window(frame.x + int(x), frame.y + int(y), width, height)


def _training_planes(prepared: extrapolation.Prepared, truth: Float32) -> dict[str, np.ndarray]:
    planes = prepared.inputs.part(slice(None), slice(None)).pictures
    history = planes["history"].reshape(HISTORY_FRAMES, 4, *planes["history"].shape[1:])
    colour = np.concatenate([planes["warped"][3:], *history[:, :3]])
    modulation = np.ones_like(truth) if prepared.modulation is None else prepared.modulation
    # What was not rendered rightly is nothing to learn from.
    truth = np.where(np.isfinite(truth), truth, prepared.finish(planes["warped"][3:])[..., :3])
    halves = {"colour": colour, "features": planes["features"]}
    for name, linear in (("modulation", modulation), ("target", truth)):
        halves[name] = np.clip(linear, -MOST_LINEAR, MOST_LINEAR).transpose(2, 0, 1)
    mask = history[:, 3].astype(np.uint8)
    return {"mask": mask} | {name: array.astype(np.float16) for name, array in halves.items()}


def _crop_weight(interval: Interval, slot: int) -> Float32:
    """Return how likely each pixel is to be the middle of a crop, float32 [H, W]."""
    back = interval.back(slot)
    motion = np.nan_to_num(np.hypot(back.field[..., 0], back.field[..., 1]))
    mean = max(float(motion.mean()), 0.25)
    weight = 1 + MOTION_WEIGHT * np.minimum(motion / mean, 4)
    weight /= weight.sum()
    if back.hole.any():
        weight += IN_HOLES / (1 - IN_HOLES) * back.hole / back.hole.sum()
    return np.asarray(weight, np.float32)


def write_arrays(arrays: Mapping[str, np.ndarray], folder: Path) -> None:
    """Write arrays, one ``.npy`` each; raises OutputError.

    The folder appears when it is complete, as trainings may share a cache.
    """
    make_folder(folder.parent)
    try:
        with TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as temporary:
            unfinished = Path(temporary) / "arrays"
            unfinished.mkdir()
            for name, array in arrays.items():
                np.save(unfinished / f"{name}.npy", array)
            unfinished.rename(folder)
    except OSError as error:
        if not folder.exists():  # else another training was faster
            raise output_error(folder, error) from error


class CachedArrays(ABC):
    """Arrays of several folders of `write_arrays`, read as they are needed.

    The array "time" has one number for each sample.
    """

    prefix = ""  # of the folders' names
    names: tuple[str, ...]  # of the arrays

    def __init__(self, folders: Sequence[Path]) -> None:
        self._files = [
            {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in self.names}
            for folder in folders
        ]
        counts = [len(files["time"]) for files in self._files]
        self._places = [(f, i) for f, count in enumerate(counts) for i in range(count)]

    def __len__(self) -> int:
        return len(self._places)

    @classmethod
    def folder_of(cls, scene: RenderedScene, settings: Any, cache: Path) -> Path:
        """Return where in a cache a scene's arrays lie; those of other settings lie beside them."""
        token = cls.token(settings) | {"manifest": asdict(scene.manifest)}
        text = json.dumps(token, sort_keys=True, default=str)
        return cache / f"{cls.prefix}{scene.name}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"

    @staticmethod
    @abstractmethod
    def token(settings: Any) -> dict[str, object]:
        """Return the versions and settings that decide what is cached."""

    @staticmethod
    @abstractmethod
    def prepare(scene: RenderedScene, settings: Any) -> dict[str, np.ndarray]:
        """Make a scene's arrays, of one row for each sample."""

    @abstractmethod
    def batch(
        self, indices: Sequence[int], side: int = 0, rng: np.random.Generator | None = None
    ) -> Any:
        """Return samples as they are cached, or a patch of `side` pixels of each, varied by `rng`.

        Samples as they are cached must have one size.
        """

    def draw(self, step: int, size: int, side: int, seed: int) -> Any:
        """Return the batch of a step of training: `size` patches of `side` pixels, varied.

        The seed and the step alone decide the order and the changes.
        """
        # Samples follow a permutation of all, then the next permutation.
        places = [divmod(n, len(self)) for n in range(step * size, (step + 1) * size)]
        orders = {
            epoch: np.random.default_rng((seed, epoch, 1)).permutation(len(self))
            for epoch in {epoch for epoch, _ in places}
        }
        indices = [int(orders[epoch][offset]) for epoch, offset in places]
        return self.batch(indices, side, np.random.default_rng((seed, step)))

    def spread(self, count: int) -> list[int]:
        """Return the indices of at most `count` samples, evenly apart."""
        places = np.linspace(0, len(self) - 1, min(count, len(self)))
        return [int(index) for index in np.unique(places.astype(int))]


class Batch(NamedTuple):
    """Crops as the network and the loss take them; float32 [N, channels, S, S]."""

    # The network's inputs
    warped: Tensor
    mask: Tensor
    features: Tensor
    history: Tensor
    time: Tensor
    modulation: Tensor  # What its answer, decoded, is multiplied with.
    target: Tensor  # The rendered frame, scene-linear

    @property
    def inputs(self) -> tuple[Tensor, ...]:
        """What the network is called with."""
        return self.warped, self.mask, self.features, self.history, self.time

    @property
    def plain(self) -> Tensor:
        """The filled warp, scene-linear: what the network has to be better than."""
        return self.finish(self.warped[:, 3:])

    def finish(self, answer: Tensor) -> Tensor:
        """Return the scene-linear colour that an answer means."""
        return decode(answer) * self.modulation


def to_device(batch: Any, device: str) -> Any:
    """Return a batch, a named tuple of tensors, on a device."""
    return type(batch)(*(part.to(device) for part in batch))


class Crops(CachedArrays):
    """All crops of some folders."""

    names = ("colour", "mask", "features", "modulation", "target", "time")

    @staticmethod
    def token(settings: ExtrapolatorSettings) -> dict[str, object]:
        """Return the versions and settings that decide what is cached."""
        decisive = {"frames": settings.frames, "side": settings.side, "seed": settings.seed}
        return {"version": VERSION, "crops": CROPS, "settings": decisive}

    @staticmethod
    def prepare(scene: RenderedScene, settings: ExtrapolatorSettings) -> dict[str, np.ndarray]:
        """Prepare frames of a scene as a user's run would, and cut crops out of them.

        Returns ``colour`` float16 [N, 12, S, S] (filled warp, then F_k, F_k-1, F_k-2 moved to the
        slot, as the network sees them), ``mask`` uint8 [N, 3, S, S] (of the last three),
        ``features`` float16 [N, 6, S, S], ``modulation`` and ``target`` float16 [N, 3, S, S]
        (linear), ``time`` float32 [N]. Raises InputError when the scene is smaller than a crop.
        """
        manifest, side = scene.manifest, settings.side
        if min(manifest.width, manifest.height) < side:
            raise InputError(
                f"{scene.folder} is {manifest.width}x{manifest.height}, smaller than crops of "
                f"{side} pixels; leave it out, or take smaller crops"
            )
        rng = np.random.default_rng((settings.seed, zlib.crc32(scene.name.encode()), 1))
        crops: dict[str, list[np.ndarray]] = {}
        clip = SceneClip(scene)
        for choice in choose_frames(manifest, settings):
            clip = clip.seen_as(choice.variant, choice.look)
            interval = clip.causal(choice.k, choice.setting)
            view = _draw_view(interval.key.image.data_window, side, rng)
            interval = interval.on(view)
            truth = clip.truth(choice.k, choice.slot).on(view).pixels[..., :3]
            planes = _training_planes(interval.prepared(choice.slot), truth)
            weight = _crop_weight(interval, choice.slot)
            total = np.cumsum(weight.ravel(), dtype=np.float64)
            for _ in range(CROPS):
                # A crop is drawn by the weight of its middle.
                index = int(np.searchsorted(total, rng.random() * total[-1]))
                middle = divmod(min(index, weight.size - 1), weight.shape[1])
                y, x = (
                    int(np.clip(place - side // 2, 0, size - side))
                    for place, size in zip(middle, weight.shape, strict=True)
                )
                for name, array in planes.items():
                    crops.setdefault(name, []).append(array[:, y : y + side, x : x + side].copy())
                crops.setdefault("time", []).append(np.array(choice.slot / FACTOR, np.float32))
            check_stop()
        return {name: np.stack(arrays) for name, arrays in crops.items()}

    def batch(
        self, indices: Sequence[int], side: int = 0, rng: np.random.Generator | None = None
    ) -> Batch:
        """Return crops as they are cached, or a patch of `side` pixels of each, varied by `rng`."""
        patches = [(slice(None), slice(None))] * len(indices)
        if rng is not None:
            room = int(self._files[0]["mask"].shape[-1]) - side
            over = int(OVERHANG * side)
            corners = rng.integers(-over, room + over + 1, (len(indices), 2)).clip(0, room)
            patches = [(slice(y, y + side), slice(x, x + side)) for y, x in corners.tolist()]
        places = [self._places[index] for index in indices]
        tensors: dict[str, Tensor] = {}
        for name in self.names:
            cuts = [
                self._files[f][name][i if name == "time" else (i, slice(None), *patch)]
                for (f, i), patch in zip(places, patches, strict=True)
            ]
            tensors[name] = torch.from_numpy(np.stack(cuts)).float()
        colour, mask = tensors.pop("colour"), tensors.pop("mask")
        visible = mask[:, :1]
        frames = zip(torch.split(colour[:, 3:], 3, 1), torch.split(mask, 1, 1), strict=True)
        history = torch.cat([part for frame in frames for part in frame], 1)
        batch = Batch(
            warped=torch.cat([history[:, :3] * visible, colour[:, :3]], 1),
            mask=visible,
            history=history,
            **tensors,
        )
        return batch if rng is None else vary(batch, rng)


def encode(linear: Tensor) -> Tensor:
    """Return sign(x) log(1 + |x|), as `synthesis.extrapolation` does."""
    return torch.sign(linear) * torch.log1p(linear.abs())


def decode(coded: Tensor) -> Tensor:
    """Return the linear values that were encoded."""
    return torch.sign(coded) * torch.expm1(coded.abs().clamp_max(11.0))


def vary(batch: Batch, rng: np.random.Generator) -> Batch:
    """Turn, flip, re-expose and recolour a batch, and leave out what users may not have.

    The world is turned too: its axes, which normals are given in, are exchanged and reflected.
    """
    flips = [axis for axis in (2, 3) if rng.random() < 0.5]
    is_transposed = rng.random() < 0.5

    def place(x: Tensor) -> Tensor:
        x = x.flip(flips) if flips else x
        return x.transpose(2, 3) if is_transposed else x

    gain = float(2 ** rng.uniform(-EXPOSURE, EXPOSURE))
    order = rng.permutation(3).tolist()

    def recolour(x: Tensor) -> Tensor:
        return encode(decode(place(x)) * gain)[:, order]

    frames = [
        torch.cat([recolour(frame[:, :3]), place(frame[:, 3:])], 1)
        for frame in torch.split(batch.history, 4, 1)
    ]
    features = place(batch.features)
    axes, signs = rng.permutation(3).tolist(), rng.choice([-1.0, 1.0], 3)
    normal = features[:, axes] * features.new_tensor(signs).reshape(1, 3, 1, 1)
    surface = features[:, 3:].clone()
    if rng.random() < NO_NORMAL:
        normal = torch.zeros_like(normal)
    if rng.random() < NO_DEPTH:
        surface[:, 0] = extrapolation.UNKNOWN_DEPTH
    if rng.random() < NO_MATERIAL:
        surface[:, 1] = extrapolation.UNKNOWN_ROUGHNESS
        surface[:, 2] = extrapolation.UNKNOWN_METALLIC
    return Batch(
        warped=torch.cat([recolour(batch.warped[:, :3]), recolour(batch.warped[:, 3:])], 1),
        mask=place(batch.mask),
        features=torch.cat([normal, surface], 1),
        history=torch.cat(frames, 1),
        time=batch.time,
        modulation=place(batch.modulation)[:, order],
        target=place(batch.target)[:, order] * gain,
    )
