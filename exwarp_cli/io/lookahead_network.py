"""The network that mixes the key frames around a slot, in an ONNX file."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from exwarp_cli.domain import cores
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import LOOKAHEAD, LOOKAHEAD_INTERFACE, LazyInputs, Tile
from exwarp_cli.errors import InputError
from exwarp_cli.io.models import PictureNetwork, read_model

SHIPPED = "lookahead.onnx"
"""Name of the network that comes with ExWarp."""

ROUNDING = 1e-3
"""By which the sum of weights may miss 1, and a weight 0."""


def load_lookahead(path: Path | None, threads: int | None, device: str) -> OnnxLookAhead:
    """Load a network and try it once.

    Parameters
    ----------
    path
        ONNX file; None for the network that comes with ExWarp.
    threads
        At most; None for as many as the command has cores.
    device
        "cpu" or "cuda".

    Raises
    ------
    InputError
        When there is no such file, it is damaged, or it does not have the inputs and the output of
        `exwarp_cli.domain.network_api`.
    MissingExtraError
        When the device is "cuda" and onnxruntime cannot use it.
    """
    path, data = read_model(path, SHIPPED, "--interpolator")
    network = OnnxLookAhead(path, data, threads or cores.count(), device)
    network.judge()
    return network


class OnnxLookAhead(PictureNetwork):
    """A look-ahead network that is ready to run; parameters as for `OnnxNetwork`."""

    name = LOOKAHEAD
    """As tables show it."""

    card_checksum: str | None = None
    """It has no card."""

    def __init__(self, path: Path, data: bytes, threads: int, device: str) -> None:
        super().__init__(path, data, threads, device, LOOKAHEAD_INTERFACE)

    def reaches(self, time: float | Fraction) -> bool:
        """Return True: it makes a frame at any time."""
        return True

    def weigh(self, inputs: LazyInputs) -> Iterator[tuple[Tile, Float32]]:
        """Yield the weights of each tile of a slot: float32 [CANDIDATES, h, w]."""
        return self.answers(inputs)

    def _require_values(self, out: Float32, pixels: str) -> None:
        least, sums = out.min(), out.sum(axis=1)
        if not (least >= -ROUNDING and np.abs(sums - 1).max() <= ROUNDING):
            raise InputError(
                f"{self.path} gives weights for {pixels} that are NaN, negative or do not add up "
                "to 1; use another model"
            )
