"""Batches of cached crops, in an order and with changes that only the seed and the step decide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from exwarp_cli.synthesis.extrapolation import UNKNOWN_DEPTH, UNKNOWN_METALLIC, UNKNOWN_ROUGHNESS

STORED = ("colour", "mask", "features", "modulation", "target", "time")
"""Names of what is kept of crops, one ``.npy`` each."""

DROPPED = 0.3
"""How often roughness and metallic are left out together, beside frames without any surface."""

NO_NORMAL = 0.1
NO_DEPTH = 0.05
EXPOSURE = 1.0
"""Stops by which exposure is varied, up and down."""


OVERHANG = 0.5
"""How far patches are drawn beyond a crop's edge before they are moved inside, as a share of
their size: else the frame's own edge, where much is hidden, is hardly ever at that of a patch."""

Patch = tuple[slice, slice]
"""Rows and columns of a crop."""


@dataclass(frozen=True)
class Batch:
    """Crops as the network and the loss take them; float32 [N, channels, S, S].

    Attributes
    ----------
    warped, mask, features, history, time
        The network's inputs.
    modulation
        What its answer, decoded, is multiplied with.
    target
        The rendered frame, scene-linear.
    """

    warped: Tensor
    mask: Tensor
    features: Tensor
    history: Tensor
    time: Tensor
    modulation: Tensor
    target: Tensor

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


class Stored:
    """What some folders keep of scenes, one ``.npy`` a name, read as it is needed.

    Parameters
    ----------
    folders
        As `samples.write_arrays` wrote them.
    names
        Of the arrays; "time" has one number for each of what is kept.
    """

    def __init__(self, folders: Sequence[Path], names: Sequence[str]) -> None:
        self._files = [
            {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in names}
            for folder in folders
        ]
        counts = [len(files["time"]) for files in self._files]
        self._places = [(f, i) for f, count in enumerate(counts) for i in range(count)]

    def __len__(self) -> int:
        return len(self._places)

    def _nth(self, n: int, seed: int) -> int:
        """Return the index of the n-th that is drawn: a new permutation once all were."""
        epoch, offset = divmod(n, len(self))
        return int(_order(len(self), seed, epoch)[offset])


class Crops(Stored):
    """All crops of some folders."""

    def __init__(self, folders: Sequence[Path]) -> None:
        super().__init__(folders, STORED)

    @property
    def side(self) -> int:
        """Height and width of the crops, pixels."""
        return int(self._files[0]["mask"].shape[-1])

    def batch(
        self, indices: Sequence[int], device: str = "cpu", patches: Sequence[Patch] | None = None
    ) -> Batch:
        """Return crops as they are kept, or a patch of each."""
        cuts = patches or [(slice(None), slice(None))] * len(indices)
        places = [self._places[index] for index in indices]
        parts = {}
        for name in STORED:
            cut = [
                self._files[f][name][(i, slice(None), *where) if name != "time" else i]
                for (f, i), where in zip(places, cuts, strict=True)
            ]
            parts[name] = np.stack(cut)
        tensors = {name: torch.from_numpy(array).to(device) for name, array in parts.items()}
        colour, mask = tensors["colour"].float(), tensors["mask"].float()
        seen = mask[:, :1]
        history = torch.cat(
            [
                torch.cat([colour[:, 3 * j + 3 : 3 * j + 6], mask[:, j : j + 1]], 1)
                for j in range(mask.shape[1])
            ],
            1,
        )
        return Batch(
            warped=torch.cat([history[:, :3] * seen, colour[:, :3]], 1),
            mask=seen,
            features=tensors["features"].float(),
            history=history,
            time=tensors["time"].float(),
            modulation=tensors["modulation"].float(),
            target=tensors["target"].float(),
        )

    def drawn(self, step: int, size: int, side: int, seed: int, device: str = "cpu") -> Batch:
        """Return the batch of a step of training: patches of crops, varied.

        The order is a new permutation each time that all crops were seen.
        """
        rng = np.random.default_rng((seed, step))
        indices = [self._nth(step * size + i, seed) for i in range(size)]
        room, over = self.side - side, int(OVERHANG * side)
        corners = rng.integers(-over, room + over + 1, (size, 2)).clip(0, room).tolist()
        patches = [(slice(y, y + side), slice(x, x + side)) for y, x in corners]
        return varied(self.batch(indices, device, patches), rng)


@lru_cache(maxsize=2)  # a batch may reach into the next epoch
def _order(count: int, seed: int, epoch: int) -> npt.NDArray[np.int64]:
    return np.random.default_rng((seed, epoch, 1)).permutation(count)


def encode(linear: Tensor) -> Tensor:
    """Return sign(x) log(1 + |x|), as `synthesis.modulation` does."""
    return torch.sign(linear) * torch.log1p(linear.abs())


def decode(coded: Tensor) -> Tensor:
    """Return the linear values that were encoded."""
    return torch.sign(coded) * torch.expm1(coded.abs().clamp_max(11.0))


def varied(batch: Batch, rng: np.random.Generator) -> Batch:
    """Turn, flip, re-expose and recolour a batch, and leave out what users may not have.

    The world is turned too: its axes, which normals are given in, are exchanged and reflected.
    """
    flips = [axis for axis in (2, 3) if rng.random() < 0.5]
    turned = rng.random() < 0.5

    def placed(x: Tensor) -> Tensor:
        x = x.flip(flips) if flips else x
        return x.transpose(2, 3) if turned else x

    gain = float(2 ** rng.uniform(-EXPOSURE, EXPOSURE))
    order = rng.permutation(3).tolist()

    def coded(x: Tensor) -> Tensor:
        return encode(decode(placed(x)) * gain)[:, order]

    frames = [
        torch.cat([coded(frame[:, :3]), placed(frame[:, 3:])], 1)
        for frame in torch.split(batch.history, 4, 1)
    ]
    return Batch(
        warped=torch.cat([coded(batch.warped[:, :3]), coded(batch.warped[:, 3:])], 1),
        mask=placed(batch.mask),
        features=_features(placed(batch.features), rng),
        history=torch.cat(frames, 1),
        time=batch.time,
        modulation=placed(batch.modulation)[:, order],
        target=placed(batch.target)[:, order] * gain,
    )


def _features(features: Tensor, rng: np.random.Generator) -> Tensor:
    axes, signs = rng.permutation(3).tolist(), rng.choice([-1.0, 1.0], 3)
    normal = features[:, axes] * features.new_tensor(signs).reshape(1, 3, 1, 1)
    rest = features[:, 3:].clone()
    if rng.random() < NO_NORMAL:
        normal = torch.zeros_like(normal)
    if rng.random() < NO_DEPTH:
        rest[:, 0] = UNKNOWN_DEPTH
    if rng.random() < DROPPED:
        rest[:, 1], rest[:, 2] = UNKNOWN_ROUGHNESS, UNKNOWN_METALLIC
    return torch.cat([normal, rest], 1)
