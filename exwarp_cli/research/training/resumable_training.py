"""Training of a network that continues where it was stopped: checkpoints, curve, main loop."""

from __future__ import annotations

import csv
import json
import math
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import asdict, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from exwarp_cli.domain.network_api import NetworkInterface
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, UsageError
from exwarp_cli.io.dataset import RenderedScene, split_scenes
from exwarp_cli.io.files import atomic_path, atomic_write_text, make_folder
from exwarp_cli.io.key_file import file_digest
from exwarp_cli.models.model_file import read_file_bytes
from exwarp_cli.pipeline.scheduling import prefetch, use_threads
from exwarp_cli.research.training.crop_cache import CachedArrays, to_device, write_arrays
from exwarp_cli.research.training.extrapolation_network import STRIDE
from exwarp_cli.research.training.onnx_export import export_network
from exwarp_cli.research.training.training_settings import ExtrapolatorSettings, LookAheadSettings
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.stop import check_stop

CHECKPOINT = "checkpoint.pt"
SETTINGS = "settings.json"
CURVE = "curve.csv"

# Steps until the learning rate is reached.
WARM_UP = 200

# The network that is kept is a running average of the weights; this share of it stays at a step.
AVERAGED = 0.998

# Processes that draw batches for a GPU, at most. One core takes 80 ms to draw 48 patches, which an
# H100 learns in 33 ms beside two other trainings.
LOADERS = 12

DAMAGED = (
    "{} is damaged, or no checkpoint of this version; choose another folder, or remove this one to "
    "start again"
)

# The parts of a training whose state a checkpoint keeps.
STATEFUL = ("network", "average", "optimiser")

Say = Callable[[str], None]
Settings = ExtrapolatorSettings | LookAheadSettings


class ResumableTraining(ABC):
    """One training under way in a folder, which gets checkpoint, curve, settings and model.

    Continues an earlier run in the folder. Raises UsageError when it has other settings, and
    DamagedFileError when its checkpoint cannot be used. `say` receives what happens, in lines.
    """

    samples: type[CachedArrays]  # what it learns from
    # The network, the settings that it is made of, and what is put around it in the model.
    network_class: type[nn.Module]
    network_options: tuple[str, ...]
    shipped: type[nn.Module] | None = None
    weight_decay: float
    largest_gradient: float  # a longer one is scaled to this norm
    # The learning rate: the share of the steps for which it stays at its highest, and what it ends
    # at, as a share of that.
    high: float
    least_rate: float
    model: str  # name of the file that is exported
    interface: NetworkInterface
    about: str  # what the model is; a format of the settings
    # Which network it may begin with, and the option that decides it; a format of the settings.
    startable: str
    columns: tuple[str, ...]  # of the curve: step, seconds, loss, rate, scores of `_validate`
    scores_text: str  # how these scores are said; a format

    def __init__(self, folder: Path, settings: Settings, say: Say) -> None:
        self.folder, self.settings, self.say = folder, settings, say
        self.device = "cuda" if torch.cuda.is_available() else "cpu"
        torch.manual_seed(settings.seed)
        options = (getattr(settings, name) for name in self.network_options)
        network = self.network_class(*options).to(self.device)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.network, self.average = network, deepcopy(network)
        self.optimiser = torch.optim.AdamW(
            network.parameters(), settings.rate, weight_decay=self.weight_decay
        )
        self.step, self.seconds = 0, 0.0
        make_folder(folder)
        path, checkpoint = folder / SETTINGS, folder / CHECKPOINT
        text = json.dumps(asdict(settings), indent=2, sort_keys=True)
        if checkpoint.exists():
            if not path.exists() or path.read_bytes() != text.encode():
                raise UsageError(
                    f"{folder} holds a training with other settings, see {SETTINGS} there; "
                    "repeat those to go on with it, or choose another folder"
                )
            content = read_checkpoint(checkpoint, self.device)
            try:
                for part in STATEFUL:
                    getattr(self, part).load_state_dict(content[part])
                self.step, self.seconds = content["step"], content["seconds"]
            except (KeyError, RuntimeError, ValueError) as error:
                raise DamagedFileError(DAMAGED.format(checkpoint)) from error
            self.say(f"going on at step {self.step} of {settings.steps}")
        atomic_write_text(path, text)

    @abstractmethod
    def _loss(self, batch: Any) -> Tensor: ...

    @abstractmethod
    def _validate(self, samples: Any) -> tuple[float, ...]:
        """Return scores of the averaged network on scenes that are held out."""

    def begin_with(self, path: Path) -> None:
        """Take the weights of another training's file, unless this one is under way.

        Raises InputError when there is no such file, or its network is another one.
        """
        if self.step:
            return
        try:
            self._load_start(path)
        except (KeyError, RuntimeError, ValueError) as error:
            raise LayoutError(
                f"{path} holds another network than {self.startable.format(self.settings)}, or "
                "another --start"
            ) from error
        self.average.load_state_dict(self.network.state_dict())

    def _load_start(self, path: Path) -> None:
        self.network.load_state_dict(read_checkpoint(path, self.device)["average"])

    def export(self) -> Path:
        """Write the network as an ONNX model; return its path."""
        path, settings = self.folder / self.model, self.settings
        about = (
            f"ExWarp {self.about.format(settings)}, {self.step} steps on "
            f"{len(settings.scenes['training'])} scenes, seed {settings.seed}"
        )
        network = self.average if self.shipped is None else self.shipped(self.average)
        export_network(network, path, self.interface, stride=STRIDE, about=about)
        return path

    @classmethod
    def train(
        cls,
        scenes: Sequence[RenderedScene],
        folder: Path,
        cache: Path,
        settings: Any,
        every: int,
        threads: int | None,
        say: Say,
        start: Path | None = None,
    ) -> Path:
        """Train a network and export it; return the model's path.

        Every twelfth scene is held out. `cache` is for prepared samples, which later trainings
        share. `every` is the number of steps between two checkpoints; `threads` None is for all
        cores. `scenes` and `start` in the settings are filled in here.
        """
        use_threads(threads)
        torch.set_num_threads(cores.count())
        parts = dict(zip(("training", "validation"), split_scenes(scenes), strict=True))
        names = {part: [scene.name for scene in chosen] for part, chosen in parts.items()}
        digest = None if start is None else file_digest(start)
        training = cls(folder, replace(settings, scenes=names, start=digest), say)
        if start is not None:
            training.begin_with(start)
        samples = {}
        for part, chosen in parts.items():
            folders = [cls.samples.folder_of(scene, settings, cache) for scene in chosen]
            for count, (scene, place) in enumerate(zip(chosen, folders, strict=True), start=1):
                if not place.exists():
                    say(f"preparing {scene.name}, {count} of {len(chosen)}")
                    write_arrays(cls.samples.prepare(scene, settings), place)
            samples[part] = cls.samples(folders)
        training.run(samples["training"], samples["validation"], every)
        return training.export()

    def run(self, samples: CachedArrays, held_out: CachedArrays, every: int) -> None:
        """Train to the end; a checkpoint and a row of the curve every so many steps."""
        begin = time.monotonic() - self.seconds
        losses: list[float] = []
        steps = range(self.step, self.settings.steps)
        loaders = min(LOADERS, cores.count()) if self.device == "cuda" else 0
        s = self.settings
        draw = partial(samples.draw, size=s.batch, side=s.patch, seed=s.seed)
        # A range is all that a loader needs of a data set: it has a length and items.
        loader = DataLoader(steps, batch_size=None, collate_fn=draw, num_workers=loaders)  # type: ignore[arg-type,var-annotated]
        batches = iter(loader)
        # The next batch is drawn while one is learned.
        for batch in prefetch((partial(next, batches) for _ in steps), 1):
            losses.append(self._learn(to_device(batch, self.device)))
            self.step += 1
            self.seconds = time.monotonic() - begin
            if self.step % every == 0 or self.step == self.settings.steps:
                self._record(float(np.mean(losses)), *self._validate(held_out))
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
        value = float(loss.detach())
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.largest_gradient)
        if not (math.isfinite(value) and math.isfinite(float(norm))):
            raise UsageError(
                f"the loss was no number at step {self.step}; lower --rate, and train in another "
                "folder"
            )
        self.optimiser.step()
        # A running average, of the statistics of the normalisation as well.
        newest_share = 1 - min(AVERAGED, (1 + self.step) / (10 + self.step))
        newest = self.network.state_dict()
        with torch.no_grad():
            for name, averaged in self.average.state_dict().items():
                if averaged.is_floating_point():
                    averaged.lerp_(newest[name], newest_share)
        return value

    def _rate(self) -> float:
        """Return the learning rate: a straight rise, a plain if there is one, half a cosine."""
        if self.step < WARM_UP:
            return self.settings.rate * (self.step + 1) / WARM_UP
        # From the end of the plain, or of the rise.
        begin = self.high * self.settings.steps or WARM_UP
        fallen = max(0.0, (self.step - begin) / max(1, self.settings.steps - begin))
        wave = 0.5 * (1 + math.cos(math.pi * fallen))
        return self.settings.rate * (self.least_rate + (1 - self.least_rate) * wave)

    def _record(self, loss: float, *scores: float) -> None:
        """Add a row to the curve; rows from this step on are of a broken run, and removed."""
        path = self.folder / CURVE
        rows = path.read_text(encoding="utf-8").splitlines()[1:] if path.exists() else []
        rows = [row for row in rows if row and int(row.split(",")[0]) < self.step]
        values = (self.step, round(self.seconds), loss, self._rate(), *scores)
        rows.append(",".join(str(v) if isinstance(v, int) else f"{v:.5g}" for v in values))
        atomic_write_text(path, "\n".join([",".join(self.columns), *rows, ""]))
        minutes_left = self.seconds / self.step * (self.settings.steps - self.step) / 60
        self.say(
            f"step {self.step} of {self.settings.steps}: loss {loss:.4f}, held-out scenes "
            f"{self.scores_text.format(*scores)}, {minutes_left:.0f} min left"
        )

    def _save(self) -> None:
        content = {part: getattr(self, part).state_dict() for part in STATEFUL}
        content |= {"step": self.step, "seconds": self.seconds}
        with atomic_path(self.folder / CHECKPOINT) as temporary:
            torch.save(content, temporary)


def read_checkpoint(path: Path, device: str) -> dict[str, Any]:
    """Read a checkpoint of a training; raises InputError or DamagedFileError."""
    damaged = DamagedFileError(DAMAGED.format(path))
    content = read_tensors(path, device, damaged)
    if not isinstance(content, dict):
        raise damaged
    return content


def read_file(path: Path) -> bytes:
    """Read a file on a disk; raises InputError where that fails."""
    try:
        return read_file_bytes(path)
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror or error}; check the path and its rights"
        ) from error


def read_tensors(path: Path, device: str, damaged: DamagedFileError) -> object:
    """Read what torch.save wrote: only tensors and plain values, nothing that could run code.

    Raises InputError where the file cannot be opened, and `damaged` for any other content.
    """
    data = read_file(path)
    try:
        with warnings.catch_warnings(action="ignore"):  # old checkpoints warn of torch's own past
            return torch.load(BytesIO(data), map_location=device, weights_only=True)
    except Exception as error:  # damaged pickles and archives end in exceptions of every kind
        raise damaged from error


def last_row(path: Path) -> dict[str, float]:
    """Return the numbers of a curve's last row by their columns; `step` and `seconds` are int."""
    *_, row = csv.DictReader(path.read_text(encoding="utf-8").splitlines())
    return {name: int(text) if text.isdigit() else float(text) for name, text in row.items()}
