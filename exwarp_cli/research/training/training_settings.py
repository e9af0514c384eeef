"""Settings that decide the outcome of a training, and what trainings need installed.

Importable without PyTorch, as ``exwarp train --help`` shows the defaults.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.util import find_spec

from exwarp_cli.errors import MissingExtraError, UsageError

# What the extra `train` adds.
PACKAGES = ("torch", "onnx", "onnxscript")


def require_train() -> None:
    """Raise MissingExtraError where the extra `train` is not installed; imports nothing."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise MissingExtraError(
            f"this needs {', '.join(missing)}, which the extra 'train' brings; "
            'pip install "exwarp[train]"'
        )


@dataclass(frozen=True)
class ExtrapolatorSettings:
    """Settings of the training of an extrapolator."""

    architecture: str = "kernels-light"  # Name in `extrapolation_network.ARCHITECTURES`.
    width: int | None = None  # Channels at half resolution; None for the architecture's own.
    steps: int = 20000  # Batches to train on
    # Crops in a batch, and height and width in pixels of the part of each that is learned, a
    # multiple of the network's stride.
    batch: int = 24  # many small patches vary more than a few whole crops
    patch: int = 64
    rate: float = 3e-3  # Highest learning rate
    frames: int = 40  # Frames of each scene that crops are taken of.
    # Height and width of a crop, pixels; a multiple of the stride, and `patch` at least.
    side: int = 128
    seed: int = 0  # Of weights, crops and their order
    # SHA-256 of the checkpoint whose weights it begins with; None for random ones.
    start: str | None = None
    # Names of the scenes by part: "training" and "validation".
    scenes: dict[str, list[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class LookAheadSettings:
    """Settings of the training of a look-ahead network; attributes as of `ExtrapolatorSettings`."""

    width: int = 32
    steps: int = 20000
    batch: int = 8
    patch: int = 64
    rate: float = 2e-3
    seed: int = 0
    start: str | None = None
    scenes: dict[str, list[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class PolicySettings:
    """Settings of the training of a policy."""

    steps: int = 3000  # Of the optimiser
    batch: int = 256  # States a step
    rate: float = 1e-3  # Learning rate; falls to 0 along a cosine.
    decay: float = 1e-4  # Weight decay
    # Standard deviation of the noise that is added to the scaled features.
    jitter: float = 0.2  # what is learned of four scenes must not depend on exact numbers
    lag: int = 200  # Steps after which the target network is copied.
    discount: float = 0.95  # Gamma
    seed: int = 0  # Of the weights and of the samples


@dataclass(frozen=True)
class TilePolicySettings:
    """Settings of the training of the policy of tiles; attributes as of `PolicySettings`."""

    steps: int = 3000
    batch: int = 128
    rate: float = 1e-3
    decay: float = 1e-3
    jitter: float = 0.03
    lag: int = 200
    seed: int = 0


def require_sane_policy(settings: PolicySettings | TilePolicySettings) -> None:
    """Raise UsageError for settings that no training of a policy can begin with."""
    if not 0 < settings.rate < 1:
        raise UsageError(f"--rate {settings.rate:g} is not between 0 and 1; try 0.001")
