"""What decides the outcome of a training."""

from __future__ import annotations

from dataclasses import dataclass, field

from exwarp_cli.errors import UsageError


@dataclass(frozen=True)
class TrainingSettings:
    """What decides the outcome of a training.

    Attributes
    ----------
    architecture
        Name in `networks.ARCHITECTURES`.
    width
        Channels at half resolution; None for the architecture's own.
    steps
        Batches to train on.
    batch, patch
        Crops in a batch, and how large a part of each is learnt from: height and width in pixels,
        a multiple of `networks.STRIDE`. Many small ones vary more than a few whole ones.
    rate
        Highest learning rate.
    frames
        Frames of each scene that crops are taken of.
    side
        Of a crop, pixels; a multiple of `networks.STRIDE`, and `patch` at least.
    seed
        Of weights, crops and their order.
    start
        SHA-256 of the checkpoint whose weights it begins with; None for random ones.
    scenes
        Names of the scenes that are trained on, and of those that are validated on.
    """

    architecture: str = "kernels-deep"
    width: int | None = None
    steps: int = 20000
    batch: int = 24
    patch: int = 64
    rate: float = 3e-3
    frames: int = 40
    side: int = 128
    seed: int = 0
    start: str | None = None
    scenes: dict[str, list[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class PolicySettings:
    """How a policy is trained.

    Attributes
    ----------
    steps
        Of the optimiser.
    batch
        States a step.
    rate
        Of learning, falling to 0 along a cosine.
    decay
        Of the weights.
    jitter
        Standard deviation of the noise that is added to the scaled features: what is learned of
        four scenes must not hang on their very numbers.
    lag
        Steps after which the target network is copied.
    discount
        Gamma.
    seed
        Of the weights and of the samples.
    """

    steps: int = 3000
    batch: int = 256
    rate: float = 1e-3
    decay: float = 1e-4
    jitter: float = 0.2
    lag: int = 200
    discount: float = 0.95
    seed: int = 0


def require_sane_policy(settings: PolicySettings) -> None:
    """Refuse settings that no training of a policy can begin with; raises UsageError."""
    if not 0 < settings.rate < 1:
        raise UsageError(f"--rate {settings.rate:g} is not between 0 and 1; try 0.001")


def require_sane(settings: TrainingSettings) -> None:
    """Refuse settings that no training can begin with.

    Raises
    ------
    UsageError
        For an unknown architecture, and patches that do not fit the network or the crops.
    """
    # Here, for it takes PyTorch, and `--help` shows the defaults above without it.
    from exwarp_cli.training.networks import ARCHITECTURES, STRIDE

    if settings.architecture not in ARCHITECTURES:
        raise UsageError(
            f"--architecture {settings.architecture} is not one of {', '.join(ARCHITECTURES)}"
        )
    for option, size in (("--patch", settings.patch), ("--side", settings.side)):
        if size % STRIDE:
            raise UsageError(
                f"{option} {size} is no multiple of {STRIDE}, which the network halves down to"
            )
    if settings.patch > settings.side:
        raise UsageError(
            f"--patch {settings.patch} is larger than --side {settings.side}; enlarge the latter"
        )
    if settings.batch < 2:
        raise UsageError(f"--batch {settings.batch} is too small to normalise over; give 2 or more")
    if not 0 < settings.rate < 1:
        raise UsageError(f"--rate {settings.rate:g} is not between 0 and 1; try 0.002")
