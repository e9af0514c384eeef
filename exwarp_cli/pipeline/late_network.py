"""The network that comes with ExWarp, opened for the first frame that is extrapolated."""

from __future__ import annotations

import hashlib
from functools import cached_property
from typing import TYPE_CHECKING

from exwarp_cli.domain import cores
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.io.models import SHIPPED, OnnxExtrapolator, read_model, runtime_version

if TYPE_CHECKING:
    from exwarp_cli.domain.extrapolator import Inputs
    from exwarp_cli.domain.frame import Float32


class LateNetwork:
    """An extrapolation network that a policy may never ask for.

    Opening and trying it takes 0.1 s. Its checksum, which is verified at once, says that it can be
    run, wherever onnxruntime can be loaded; of other networks only a trial tells.

    Parameters
    ----------
    threads
        At most; None for as many as the command has cores.

    Attributes
    ----------
    path, device
        As of `OnnxExtrapolator`.

    Raises
    ------
    InputError
        When its file is missing or damaged.
    MissingExtraError
        When onnxruntime cannot be loaded.
    """

    def __init__(self, threads: int | None) -> None:
        self.path, self._data = read_model(None, SHIPPED, "--extrapolator")
        self.device, self._threads = UpsampleSettings.device, threads
        runtime_version()

    @cached_property
    def checksum(self) -> str:
        """SHA-256 of the model's file, in hexadecimal digits."""
        return hashlib.sha256(self._data).hexdigest()

    def __call__(self, inputs: Inputs) -> Float32:
        """Return the slot's colour, float32 [3, H, W], encoded as the inputs are; any H and W."""
        return self._opened(inputs)

    @cached_property
    def _opened(self) -> OnnxExtrapolator:
        threads = self._threads or cores.count()
        return OnnxExtrapolator(self.path, self._data, threads, self.device)
