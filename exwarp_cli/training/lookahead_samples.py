"""What a look-ahead network is given at slots of rendered scenes, with the truth; kept on disk."""

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
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.warp import as_shown
from exwarp_cli.training.crops import Stored
from exwarp_cli.training.footage import Footage
from exwarp_cli.training.looks import PLAIN, Look, draw_look
from exwarp_cli.training.samples import digest_of, write_arrays
from exwarp_cli.training.variant import Variant

VERSION = 1
"""Of what is kept; samples of another version are made again."""

PICTURES = tuple(LOOKAHEAD_INTERFACE.inputs)
STORED = (*PICTURES, "truth", "time")
"""Names of what is kept of slots, one ``.npy`` each."""

SLOW_PHASES, FAST_PHASES = (0, 1, 2, 3), (1, 4)
"""First key frames of the variants; the fast ones span two key intervals."""

LOOKED_AT = (0, 2)
"""Phases of the variants in a look that is drawn."""

SWAPPED = {
    "colour": (0, 1, 2, 6, 7, 8, 3, 4, 5, 12, 13, 14, 9, 10, 11),
    "masks": (1, 0, 3, 2, 5, 4),
    "depth": (1, 0),
}
"""Channels in the order in which a slot has them that is played backwards."""

OVERHANG = 12
"""Pixels by which patches are drawn beyond the frame's edge before they are moved inside."""

HARDER = 0.6
"""Share of patches that are the worst of `TRIED` for softmax splatting."""

TRIED = 4

NO_DEPTH = 0.12
"""How often depth is left out, and the octaves by which it is shifted."""

SHIFTED = 3.0

BRIGHTNESS = (-0.6, 0.3)
"""Logarithm of what colour is multiplied by."""


class _Catcher:
    """Stands in for a network: keeps what it is given, and takes what `softsplat` makes."""

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


def slots_of(footage: Footage, setting: str = "key") -> Iterator[dict[str, np.ndarray]]:
    """Yield what a network is given at each slot between key frames, with the truth.

    Yields
    ------
    dict
        By `STORED`: the inputs and ``truth`` [3, H, W], as shown, float16; ``time`` float32.
    """
    for k in footage.intervals:
        interval = footage.interval(k, setting)
        for slot in range(1, FACTOR):
            yield _slot(interval, slot, footage.truth(k, slot).pixels)
            check_stop()


def _slot(interval: Interval, slot: int, truth: Float32) -> dict[str, np.ndarray]:
    catcher, following = _Catcher(), interval.following
    assert following is not None
    mixer = replace(interval, interpolator=catcher).look_ahead(slot, weighs=True)
    mixer.make(interval.key.image.pixels, following.image.pixels)
    shown = as_shown(np.ascontiguousarray(truth[..., :3], np.float32))
    return catcher.pictures | {
        "truth": shown.transpose(2, 0, 1).astype(np.float16),
        "time": np.array(interval.time(slot), np.float32),
    }


def variants_of(name: str, seed: int) -> list[tuple[Variant, Look]]:
    """Return how a scene is played and delivered; looks are drawn by its name and a seed."""
    rng = np.random.default_rng((seed, zlib.crc32(name.encode())))
    plain = [Variant(phase) for phase in SLOW_PHASES]
    fast = [Variant(phase, speed=2) for phase in FAST_PHASES]
    looks = [(Variant(phase), draw_look(rng, can_halve=False)) for phase in LOOKED_AT]
    return [*((variant, PLAIN) for variant in (*plain, *fast)), *looks]


def samples_folder(scene: RenderedScene, seed: int, cache: Path) -> Path:
    """Return where in a cache a scene's samples lie."""
    token = {"version": VERSION, "seed": seed, "manifest": asdict(scene.manifest)}
    return cache / f"lookahead-{scene.name}-{digest_of(token)}"


def write_samples(scene: RenderedScene, seed: int, folder: Path) -> None:
    """Make the samples of a scene, and write them by the names of `STORED`; see `write_arrays`."""
    footage, found = Footage(scene), []
    for variant, look in variants_of(scene.name, seed):
        footage = footage.seen_as(variant, look)
        found += list(slots_of(footage))
    write_arrays({name: np.stack([slot[name] for slot in found]) for name in STORED}, folder)


@dataclass(frozen=True)
class Sample:
    """A batch as the network takes it, and the truth.

    Attributes
    ----------
    inputs
        By name, float32 [N, channels, S, S].
    time
        float32 [N].
    truth
        float32 [N, 3, S, S], as shown.
    """

    inputs: Mapping[str, Tensor]
    time: Tensor
    truth: Tensor


class Samples(Stored):
    """The slots of some folders, of which patches are read as they are needed."""

    def __init__(self, folders: Sequence[Path]) -> None:
        super().__init__(folders, STORED)

    def whole(self, index: int) -> Sample:
        """Return a slot as it is."""
        f, i = self._places[index]
        return _batch([{name: np.asarray(self._files[f][name][i]) for name in STORED}])

    def drawn(self, step: int, size: int, side: int, seed: int) -> Sample:
        """Return the batch of a step of training: patches of slots, varied."""
        rng = np.random.default_rng((seed, step))
        indices = [self._nth(step * size + n, seed) for n in range(size)]
        return _batch([_varied(self._patch(index, side, rng), rng) for index in indices])

    def _patch(self, index: int, side: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
        f, i = self._places[index]
        files = self._files[f]
        height, width = files["truth"].shape[-2:]
        count = TRIED if rng.random() < HARDER else 1
        corners = [_corner(height, width, side, rng) for _ in range(count)]

        def error(corner: tuple[int, int]) -> float:
            rows, columns = (slice(at, at + side, 4) for at in corner)
            made = files["colour"][i, :3, rows, columns].astype(np.float32)
            return float(np.abs(made - files["truth"][i, :, rows, columns]).mean())

        y, x = corners[0] if count == 1 else max(corners, key=error)
        found = {n: files[n][i, :, y : y + side, x : x + side] for n in (*PICTURES, "truth")}
        return found | {"time": files["time"][i]}


def _corner(height: int, width: int, side: int, rng: np.random.Generator) -> tuple[int, int]:
    y, x = (
        int(rng.integers(-OVERHANG, room - side + OVERHANG + 1).clip(0, room - side))
        for room in (height, width)
    )
    return y, x


def _varied(patch: Mapping[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Turn, flip, play backwards, re-expose and recolour a patch, or leave out its depth."""
    pictures = {n: np.asarray(patch[n], np.float32) for n in (*PICTURES, "truth")}
    order, gain = rng.permutation(3), np.float32(np.exp(rng.uniform(*BRIGHTNESS)))
    for name in ("colour", "truth"):
        shape = pictures[name].shape
        pictures[name] = pictures[name].reshape(-1, 3, *shape[1:])[:, order].reshape(shape) * gain
    pictures["depth"] = pictures["depth"] + np.float32(rng.uniform(-SHIFTED, SHIFTED))
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


def _batch(parts: Sequence[Mapping[str, np.ndarray]]) -> Sample:
    def joined(name: str) -> Tensor:
        stacked = np.stack([part[name] for part in parts]).astype(np.float32)
        return torch.from_numpy(np.ascontiguousarray(stacked))

    return Sample({name: joined(name) for name in PICTURES}, joined("time"), joined("truth"))
