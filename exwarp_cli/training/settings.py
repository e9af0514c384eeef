"""What decides the outcome of a training: settings, chosen scenes, and its validation curve."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

from exwarp_cli.errors import InputError, MissingFrameError, UsageError
from exwarp_cli.io.atomic import atomic_path
from exwarp_cli.io.dataset import TRAINING, RenderedScene, find_scenes


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


CURVE = "curve.csv"
COLUMNS = ("step", "seconds", "loss", "rate", "gain_db", "gain_holes_db")


def add_row(path: Path, step: int, values: Sequence[float]) -> None:
    """Add a row for a step; rows from that step on are of a broken run, and removed.

    Parameters
    ----------
    path
        Of the file; made where there is none.
    step
        First of `COLUMNS`.
    values
        Of the others; integers as they are, else with five digits.
    """
    rows = [row for row in _rows(path) if int(row["step"]) < step]
    formatted = (str(v) if isinstance(v, int) else f"{v:.5g}" for v in (step, *values))
    rows.append(dict(zip(COLUMNS, formatted, strict=True)))
    with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def last_row(path: Path) -> dict[str, float]:
    """Return the numbers of the last row by their columns; `step` and `seconds` are whole."""
    row = _rows(path)[-1]
    return {name: _number(row[name]) for name in COLUMNS}


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _number(text: str) -> float:
    return int(text) if text.isdigit() else float(text)


EVERY = 12
"""One scene in so many is left out of training, to validate on."""


def select(
    data: Path, wanted: Sequence[str], unwanted: Sequence[str], say: Callable[[str], None]
) -> list[RenderedScene]:
    """Return a folder's scenes by name.

    Parameters
    ----------
    data
        Folder of rendered scenes.
    wanted
        Glob patterns of names; empty for all whose role is training.
    unwanted
        Glob patterns of names to leave out.
    say
        Told of scenes that are left out because they are not rendered to the end.

    Raises
    ------
    InputError
        When none is left.
    """
    found = []
    for scene in find_scenes(data):
        name = scene.name
        asked = _matches(name, wanted) if wanted else scene.manifest.role == TRAINING
        if not asked or _matches(name, unwanted):
            continue
        try:
            scene.require_complete()
        except MissingFrameError:
            say(f"{name} is not rendered to the end and left out")
            continue
        found.append(scene)
    if not found:
        raise InputError(
            f"{data} has no scene to learn from; render some with examples/scenes/variety.py, or "
            "choose others with --scenes"
        )
    return found


def _matches(name: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def split(scenes: Sequence[RenderedScene]) -> tuple[list[RenderedScene], list[RenderedScene]]:
    """Return scenes to train on and to validate on: every twelfth by name, at least one."""
    ordered = sorted(scenes, key=lambda s: s.name)
    if len(ordered) < 2:
        raise InputError(
            f"there is {len(ordered)} scene to train on, and one more is needed to validate on; "
            "render more with examples/scenes/variety.py"
        )
    held = ordered[EVERY // 2 :: EVERY] or ordered[-1:]
    return [s for s in ordered if s not in held], held
