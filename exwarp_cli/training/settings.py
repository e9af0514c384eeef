"""What decides the outcome of a training, and its validation curve."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from exwarp_cli.errors import UsageError
from exwarp_cli.io.files import atomic_path


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

    architecture: str = "kernels-light"
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
class LookAheadSettings:
    """What decides the outcome of a training.

    Attributes
    ----------
    width
        Channels at half resolution.
    steps
        Batches to train on.
    batch, patch
        Patches in a batch, and their height and width in pixels, a multiple of 16.
    rate
        Highest learning rate.
    seed
        Of weights, looks, patches and their order.
    start
        SHA-256 of the checkpoint whose weights it begins with; None for random ones.
    scenes
        Names of the scenes that are trained on, and of those that are validated on.
    """

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


@dataclass(frozen=True)
class TilePolicySettings:
    """How the policy of tiles is trained; attributes as of `PolicySettings`."""

    steps: int = 3000
    batch: int = 128
    rate: float = 1e-3
    decay: float = 1e-3
    jitter: float = 0.03
    lag: int = 200
    seed: int = 0


def require_sane_policy(settings: PolicySettings | TilePolicySettings) -> None:
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


CURVE = "curve.csv"
COLUMNS = ("step", "seconds", "loss", "rate", "gain_db", "gain_holes_db")


def add_row(
    path: Path, step: int, values: Sequence[float], columns: Sequence[str] = COLUMNS
) -> None:
    """Add a row for a step; rows from that step on are of a broken run, and removed.

    Parameters
    ----------
    path
        Of the file; made where there is none.
    step
        First of the columns.
    values
        Of the others; integers as they are, else with five digits.
    columns
        Names of them all.
    """
    rows = [row for row in _rows(path) if int(row["step"]) < step]
    formatted = (str(v) if isinstance(v, int) else f"{v:.5g}" for v in (step, *values))
    rows.append(dict(zip(columns, formatted, strict=True)))
    with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def last_row(path: Path) -> dict[str, float]:
    """Return the numbers of the last row by their columns; `step` and `seconds` are whole."""
    row = _rows(path)[-1]
    return {name: _number(value) for name, value in row.items()}


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _number(text: str) -> float:
    return int(text) if text.isdigit() else float(text)
