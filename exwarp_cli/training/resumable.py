"""A training that goes on where it was stopped: what the trainings of all networks share."""

from __future__ import annotations

import json
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from exwarp_cli.errors import DamagedFileError, UsageError
from exwarp_cli.io.dataset import RenderedScene, split
from exwarp_cli.io.files import atomic_path, atomic_write_text, make_folder
from exwarp_cli.io.generated_frames import file_digest
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.training.checkpoint import read_tensors
from exwarp_cli.training.samples import is_whole
from exwarp_cli.training.settings import LookAheadSettings, TrainingSettings

CHECKPOINT = "checkpoint.pt"
SETTINGS = "settings.json"

WARM_UP = 200
"""Steps until the learning rate is reached."""

AVERAGED = 0.998
"""The network that is kept is a running average of the weights; it forgets that much a step."""

Say = Callable[[str], None]

Kind = TypeVar("Kind", TrainingSettings, LookAheadSettings)


class ResumableTraining(ABC):
    """One training under way, in a folder of its own.

    Parameters
    ----------
    folder
        For checkpoint, curve, settings and model; an earlier run there is gone on with.
    settings
        What decides the outcome.
    say
        Receives what happens, in lines.
    network
        With its first weights, on the device that it is trained on.
    weight_decay
        Of the optimiser.
    clipped
        Largest norm of a gradient.
    device
        "cpu" or "cuda".

    Raises
    ------
    UsageError
        When the folder holds a training with other settings.
    DamagedFileError
        When its checkpoint cannot be used.
    """

    def __init__(
        self,
        folder: Path,
        settings: TrainingSettings | LookAheadSettings,
        say: Say,
        network: nn.Module,
        weight_decay: float,
        clipped: float,
        device: str = "cpu",
    ) -> None:
        self.folder, self.settings, self.say, self.device = folder, settings, say, device
        self.network, self.average = network, deepcopy(network)
        self.optimiser = torch.optim.AdamW(
            network.parameters(), settings.rate, weight_decay=weight_decay
        )
        self.step, self.seconds = 0, 0.0
        self._clipped = clipped
        self._open()

    @abstractmethod
    def _rate(self) -> float:
        """Learning rate of this step."""

    @abstractmethod
    def _loss(self, batch: Any) -> Tensor:
        """Return the loss of a batch."""

    @abstractmethod
    def _record(self, loss: float, *scores: float) -> None:
        """Add a row to the curve, and tell of it."""

    def _run(
        self, batches: Iterable[Any], validate: Callable[[], tuple[float, ...]], every: int
    ) -> None:
        """Train on batches; a checkpoint and a line of the curve every so many steps."""
        begin = time.monotonic() - self.seconds
        losses: list[float] = []
        for batch in batches:
            losses.append(self._learn(batch))
            self.step += 1
            self.seconds = time.monotonic() - begin
            if self.step % every == 0 or self.step == self.settings.steps:
                self._record(float(np.mean(losses)), *validate())
                self._save()
                losses = []
            check_stop()

    def _learn(self, batch: Any) -> float:
        """Take a step of the optimiser; return the loss."""
        for group in self.optimiser.param_groups:
            group["lr"] = self._rate()
        self.network.train()
        loss = self._loss(batch)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        found = float(loss.detach())
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), self._clipped)
        if not (math.isfinite(found) and math.isfinite(float(norm))):
            raise UsageError(
                f"the loss was no number at step {self.step}; lower --rate, and train in another "
                "folder"
            )
        self.optimiser.step()
        self._average()
        return found

    @torch.no_grad()
    def _average(self) -> None:
        """Let the network that is kept follow the one that is trained, statistics included."""
        forget = 1 - min(AVERAGED, (1 + self.step) / (10 + self.step))
        newest = self.network.state_dict()
        for name, kept in self.average.state_dict().items():
            if kept.is_floating_point():
                kept.lerp_(newest[name], forget)

    @property
    def _minutes_left(self) -> float:
        return self.seconds / self.step * (self.settings.steps - self.step) / 60

    def _open(self) -> None:
        """Begin in an empty folder, or go on where an earlier run with these settings stopped."""
        make_folder(self.folder)
        path, checkpoint = self.folder / SETTINGS, self.folder / CHECKPOINT
        wanted = json.dumps(asdict(self.settings), indent=2, sort_keys=True)
        if checkpoint.exists():
            if not path.exists() or path.read_bytes() != wanted.encode():
                raise UsageError(
                    f"{self.folder} holds a training with other settings, see {SETTINGS} there; "
                    "repeat those to go on with it, or choose another folder"
                )
            self._restore(checkpoint)
            self.say(f"going on at step {self.step} of {self.settings.steps}")
        atomic_write_text(path, wanted)

    def _restore(self, path: Path) -> None:
        kept = read_checkpoint(path, self.device)
        try:
            self.network.load_state_dict(kept["network"])
            self.average.load_state_dict(kept["average"])
            self.optimiser.load_state_dict(kept["optimiser"])
            self.step, self.seconds = kept["step"], kept["seconds"]
        except (KeyError, RuntimeError, ValueError) as error:
            raise _damaged(path) from error

    def _save(self) -> None:
        content = {
            "network": self.network.state_dict(), "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(), "step": self.step, "seconds": self.seconds,
        }  # fmt: skip
        with atomic_path(self.folder / CHECKPOINT) as temporary:
            torch.save(content, temporary)


def parts_of(scenes: Sequence[RenderedScene]) -> dict[str, list[RenderedScene]]:
    """Return the scenes to learn from ("training"), and those held out ("validation")."""
    return dict(zip(("training", "validation"), split(scenes), strict=True))


def begun(settings: Kind, parts: Mapping[str, list[RenderedScene]], start: Path | None) -> Kind:
    """Return the settings with the scenes' names, and the digest of the file to start with."""
    names = {part: [scene.name for scene in chosen] for part, chosen in parts.items()}
    return replace(settings, scenes=names, start=None if start is None else file_digest(start))


def prepared(
    scenes: Sequence[RenderedScene],
    folder_of: Callable[[RenderedScene], Path],
    write: Callable[[RenderedScene, Path], None],
    say: Say,
) -> Iterator[Path]:
    """Yield the folder of what is learnt from each scene; written where it is not there."""
    for count, scene in enumerate(scenes, start=1):
        folder = folder_of(scene)
        if not is_whole(folder):
            say(f"preparing {scene.name}, {count} of {len(scenes)}")
            write(scene, folder)
        yield folder


def read_checkpoint(path: Path, device: str) -> dict[str, Any]:
    """Read a checkpoint of a training.

    Raises
    ------
    InputError
        When there is no such file, or it cannot be opened.
    DamagedFileError
        When it is no checkpoint, or damaged.
    """
    kept = read_tensors(path, device, _damaged(path))
    if not isinstance(kept, dict):
        raise _damaged(path)
    return kept


def _damaged(path: Path) -> DamagedFileError:
    return DamagedFileError(
        f"{path} is damaged, or no checkpoint of this version; choose another folder, or remove "
        "this one to start again"
    )
