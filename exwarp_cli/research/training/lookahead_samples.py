"""Inputs of a look-ahead network at slots of rendered scenes, with the truth; cached on disk."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import (
    CANDIDATES,
    LOOKAHEAD_INTERFACE,
    LazyInputs,
    Tile,
    TileSpan,
)
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.dataset import RenderedScene
from exwarp_cli.research.training.augmentation import PLAIN, Look, Variant, draw_look
from exwarp_cli.research.training.crop_cache import CachedArrays, digest_of, write_arrays
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.warp import linear_to_srgb

# Of what is cached; samples of another version are made again.
VERSION = 1

# Names of what is cached of slots, one ``.npy`` each.
PICTURES = tuple(LOOKAHEAD_INTERFACE.inputs)
SAMPLE_ARRAYS = (*PICTURES, "truth", "time")

# First key frames of the variants; the fast ones span two key intervals.
SLOW_PHASES, FAST_PHASES = (0, 1, 2, 3), (1, 4)

# Phases of the variants in a look that is drawn.
LOOK_PHASES = (0, 2)

# Channels in the order in which a slot has them that is played backwards.
SWAPPED = {
    "colour": (0, 1, 2, 6, 7, 8, 3, 4, 5, 12, 13, 14, 9, 10, 11),
    "masks": (1, 0, 3, 2, 5, 4),
    "depth": (1, 0),
}

# Pixels by which patches are drawn beyond the frame's edge before they are moved inside.
OVERHANG = 12

# Share of patches that are the worst of `TRIED` for softmax splatting.
HARDER = 0.6
TRIED = 4

# How often depth is left out, and the octaves by which it is shifted.
NO_DEPTH = 0.12
DEPTH_SHIFT = 3.0

# Logarithm of what colour is multiplied by.
BRIGHTNESS = (-0.6, 0.3)


class _Recorder:
    """Stands in for a network: keeps its inputs, and answers with what `softsplat` makes."""

    checksum = ""

    def __init__(self) -> None:
        self.pictures: dict[str, np.ndarray] = {}

    def weigh(self, inputs: LazyInputs) -> Iterator[tuple[Tile, Float32]]:
        height, width = inputs.shape
        part = inputs.part(slice(0, height), slice(0, width))
        self.pictures = {name: p.astype(np.float16) for name, p in part.pictures.items()}
        weights = np.zeros((CANDIDATES, height, width), np.float32)
        weights[0] = 1
        yield (TileSpan(0, height, 0, height), TileSpan(0, width, 0, width)), weights


def slot_samples(clip: SceneClip, setting: str = "key") -> Iterator[dict[str, np.ndarray]]:
    """Yield what a network is given at each slot between key frames, with the truth.

    By `SAMPLE_ARRAYS`: the inputs and ``truth`` [3, H, W], as displayed, float16; ``time`` float32.
    """
    for k in clip.intervals:
        interval = clip.interval(k, setting)
        for slot in range(1, FACTOR):
            yield _slot_sample(interval, slot, clip.truth(k, slot).pixels)
            check_stop()


def _slot_sample(interval: Interval, slot: int, truth: Float32) -> dict[str, np.ndarray]:
    recorder, following = _Recorder(), interval.following
    assert following is not None
    mixer = replace(interval, interpolator=recorder).look_ahead(slot, weighs=True)
    mixer.make(interval.key.image.pixels, following.image.pixels)
    displayed = linear_to_srgb(np.ascontiguousarray(truth[..., :3], np.float32))
    return recorder.pictures | {
        "truth": displayed.transpose(2, 0, 1).astype(np.float16),
        "time": np.array(interval.time(slot), np.float32),
    }


def variants_of(name: str, seed: int) -> list[tuple[Variant, Look]]:
    """Return how a scene is played and delivered; looks are drawn by its name and a seed."""
    rng = np.random.default_rng((seed, zlib.crc32(name.encode())))
    plain = [Variant(phase) for phase in SLOW_PHASES]
    fast = [Variant(phase, speed=2) for phase in FAST_PHASES]
    looks = [(Variant(phase), draw_look(rng, can_halve=False)) for phase in LOOK_PHASES]
    return [*((variant, PLAIN) for variant in (*plain, *fast)), *looks]


def samples_folder(scene: RenderedScene, seed: int, cache: Path) -> Path:
    """Return where in a cache a scene's samples lie."""
    token = {"version": VERSION, "seed": seed, "manifest": asdict(scene.manifest)}
    return cache / f"lookahead-{scene.name}-{digest_of(token)}"


def write_samples(scene: RenderedScene, seed: int, folder: Path) -> None:
    """Make the samples of a scene, and write them by `SAMPLE_ARRAYS`; see `write_arrays`."""
    clip, samples = SceneClip(scene), []
    for variant, look in variants_of(scene.name, seed):
        clip = clip.seen_as(variant, look)
        samples += list(slot_samples(clip))
    stacks = {name: np.stack([sample[name] for sample in samples]) for name in SAMPLE_ARRAYS}
    write_arrays(stacks, folder)


@dataclass(frozen=True)
class SampleBatch:
    """A batch as the network takes it, and the truth."""

    inputs: Mapping[str, Tensor]  # By name, float32 [N, channels, S, S]
    time: Tensor  # float32 [N]
    truth: Tensor  # float32 [N, 3, S, S], as displayed

    def to(self, device: str) -> SampleBatch:
        """Return the batch on a device."""
        inputs = {name: picture.to(device) for name, picture in self.inputs.items()}
        return SampleBatch(inputs, self.time.to(device), self.truth.to(device))


class Samples(CachedArrays):
    """The slots of some folders, of which patches are read as they are needed."""

    def __init__(self, folders: Sequence[Path]) -> None:
        super().__init__(folders, SAMPLE_ARRAYS)

    def whole(self, index: int) -> SampleBatch:
        """Return a slot as it is, as a batch of one."""
        f, i = self._places[index]
        return _stack([{name: np.asarray(self._files[f][name][i]) for name in SAMPLE_ARRAYS}])

    def draw(self, step: int, size: int, side: int, seed: int) -> SampleBatch:
        """Return the batch of a step of training: patches of slots, varied."""
        rng = np.random.default_rng((seed, step))
        indices = [self.draw_index(step * size + n, seed) for n in range(size)]
        return _stack([_vary_patch(self._draw_patch(index, side, rng), rng) for index in indices])

    def _draw_patch(self, index: int, side: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
        f, i = self._places[index]
        files = self._files[f]
        height, width = files["truth"].shape[-2:]
        count = TRIED if rng.random() < HARDER else 1
        corners = [
            tuple(
                int(rng.integers(-OVERHANG, room - side + OVERHANG + 1).clip(0, room - side))
                for room in (height, width)
            )
            for _ in range(count)
        ]

        def error(corner: tuple[int, ...]) -> float:
            rows, columns = (slice(first, first + side, 4) for first in corner)
            softsplat = files["colour"][i, :3, rows, columns].astype(np.float32)
            return float(np.abs(softsplat - files["truth"][i, :, rows, columns]).mean())

        y, x = corners[0] if count == 1 else max(corners, key=error)
        patch = {n: files[n][i, :, y : y + side, x : x + side] for n in (*PICTURES, "truth")}
        return patch | {"time": files["time"][i]}


def _vary_patch(patch: Mapping[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Turn, flip, play backwards, re-expose and recolour a patch, or leave out its depth."""
    pictures = {n: np.asarray(patch[n], np.float32) for n in (*PICTURES, "truth")}
    order, gain = rng.permutation(3), np.float32(np.exp(rng.uniform(*BRIGHTNESS)))
    for name in ("colour", "truth"):
        shape = pictures[name].shape
        pictures[name] = pictures[name].reshape(-1, 3, *shape[1:])[:, order].reshape(shape) * gain
    pictures["depth"] = pictures["depth"] + np.float32(rng.uniform(-DEPTH_SHIFT, DEPTH_SHIFT))
    if rng.random() < NO_DEPTH:
        pictures["depth"] = np.full_like(pictures["depth"], pictures["depth"].max())
    for axis in (-1, -2):
        if rng.random() < 0.5:
            pictures = {n: np.flip(p, axis) for n, p in pictures.items()}
    if rng.random() < 0.5:
        pictures = {n: p.swapaxes(-1, -2) for n, p in pictures.items()}
    time = np.float32(patch["time"])
    if rng.random() < 0.5:
        for name, channels in SWAPPED.items():
            pictures[name] = pictures[name][list(channels)]
        time = np.float32(1) - time
    return pictures | {"time": np.array(time)}


def _stack(patches: Sequence[Mapping[str, np.ndarray]]) -> SampleBatch:
    def stack(name: str) -> Tensor:
        planes = np.stack([patch[name] for patch in patches]).astype(np.float32)
        return torch.from_numpy(np.ascontiguousarray(planes))

    return SampleBatch({name: stack(name) for name in PICTURES}, stack("time"), stack("truth"))
