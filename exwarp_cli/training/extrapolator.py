"""Training an extrapolation network: resumable, seeded, with its validation curve in a file."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from exwarp_cli.domain import cores
from exwarp_cli.errors import DamagedFileError, LayoutError, UsageError
from exwarp_cli.io.atomic import atomic_path, atomic_write_text, make_folder
from exwarp_cli.io.dataset import RenderedScene
from exwarp_cli.io.output import file_digest
from exwarp_cli.io.threads import use_threads
from exwarp_cli.pipeline.scheduling import prefetch
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.training.crops import Batch, Crops
from exwarp_cli.training.curve import CURVE, add_row
from exwarp_cli.training.export import export_extrapolator
from exwarp_cli.training.growth import grown
from exwarp_cli.training.losses import decibels, loss_of
from exwarp_cli.training.networks import STRIDE, ExtrapolationNetwork, build
from exwarp_cli.training.samples import CropSettings, crops_folder, is_whole, write_crops
from exwarp_cli.training.selection import split
from exwarp_cli.training.settings import TrainingSettings, require_sane
from exwarp_cli.training.tensors import read_tensors

CHECKPOINT = "checkpoint.pt"
SETTINGS = "settings.json"
MODEL = "extrapolator.onnx"

WARM_UP = 200
"""Steps until the learning rate is reached."""

LEAST_RATE = 0.02
"""What the learning rate ends at, as a share of its highest."""

AVERAGED = 0.998
"""The network that is kept is a running average of the weights; it forgets that much a step."""

VALIDATED = 192
"""Crops, at most, that validation looks at, and how many at a time."""
TOGETHER = 16

CLIPPED = 0.3
"""Largest norm of a gradient."""

Say = Callable[[str], None]


class Training:
    """One training under way, in a folder of its own."""

    def __init__(self, folder: Path, settings: TrainingSettings, say: Say) -> None:
        self.folder, self.settings, self.say = folder, settings, say
        self.device = "cuda" if torch.cuda.is_available() else "cpu"
        torch.manual_seed(settings.seed)
        self.network, self.average = (self._build() for _ in range(2))
        self.average.load_state_dict(self.network.state_dict())
        self.optimiser = torch.optim.AdamW(self.network.parameters(), settings.rate)
        self.step, self.seconds = 0, 0.0
        self._halved = _fast_halves(self.device)
        self._open()

    def begin_with(self, path: Path) -> None:
        """Take the weights of another training's checkpoint, unless this one is under way.

        Its network may have fewer channels; see :mod:`growth`.

        Raises
        ------
        InputError
            When there is no such checkpoint, or its network is of another architecture.
        """
        if self.step:
            return
        kept = _read_checkpoint(path, self.device)
        try:
            self.network.load_state_dict(grown(kept["average"], self.network))
        except (KeyError, ValueError) as error:
            raise LayoutError(
                f"{path} holds another network than {self.settings.architecture} or a smaller one; "
                "give its --architecture and --width, or another --start"
            ) from error
        self.average.load_state_dict(self.network.state_dict())

    def run(self, crops: Crops, held: Crops, every: int) -> None:
        """Train to the end; a checkpoint and a line of the curve every so many steps."""
        begin = time.monotonic() - self.seconds
        losses: list[float] = []
        for batch in _ahead(crops, self.step, self.settings, self.device):
            losses.append(self._learn(batch))
            self.step += 1
            self.seconds = time.monotonic() - begin
            if self.step % every == 0 or self.step == self.settings.steps:
                self._record(float(np.mean(losses)), *self._validate(held))
                self._save()
                losses = []
            check_stop()

    def export(self) -> Path:
        """Write the network as an ONNX model; return its path."""
        target = self.folder / MODEL
        about = (
            f"ExWarp extrapolation network, {self.settings.architecture}, {self.step} steps on "
            f"{len(self.settings.scenes['training'])} scenes, seed {self.settings.seed}"
        )
        export_extrapolator(self.average, target, stride=STRIDE, about=about)
        return target

    def _build(self) -> ExtrapolationNetwork:
        network = build(self.settings.architecture, self.settings.width).to(self.device)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return network

    def _learn(self, batch: Batch) -> float:
        for group in self.optimiser.param_groups:
            group["lr"] = self._rate()
        self.network.train()
        with torch.autocast(self.device, torch.bfloat16, enabled=self._halved):
            answer = self.network(*batch.inputs)
        made = batch.finish(answer.float())
        loss = loss_of(made, batch.target, batch.plain, batch.mask)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        found = float(loss.detach())
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), CLIPPED)
        if not (math.isfinite(found) and math.isfinite(float(norm))):
            raise UsageError(
                f"the loss was no number at step {self.step}; lower --rate, and train in another "
                "folder"
            )
        self.optimiser.step()
        forget = 1 - min(AVERAGED, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            pairs = zip(self.average.parameters(), self.network.parameters(), strict=True)
            for kept, new in pairs:
                kept.lerp_(new, forget)
            buffers = zip(self.average.buffers(), self.network.buffers(), strict=True)
            for statistic, newest in buffers:
                if statistic.is_floating_point():
                    statistic.lerp_(newest, forget)
        return found

    def _rate(self) -> float:
        """Learning rate of this step: a straight rise, then half a cosine."""
        if self.step < WARM_UP:
            return self.settings.rate * (self.step + 1) / WARM_UP
        done = (self.step - WARM_UP) / max(1, self.settings.steps - WARM_UP)
        wave = 0.5 * (1 + math.cos(math.pi * done))
        return self.settings.rate * (LEAST_RATE + (1 - LEAST_RATE) * wave)

    def _validate(self, held: Crops) -> tuple[float, float]:
        """Return how many dB the network is above the filled warp: overall, and in holes."""
        self.average.eval()
        chosen = np.unique(np.linspace(0, len(held) - 1, min(VALIDATED, len(held))).astype(int))
        gains: list[float] = []
        in_holes: list[float] = []
        with torch.no_grad():
            for first in range(0, len(chosen), TOGETHER):
                check_stop()
                batch = held.batch(chosen[first : first + TOGETHER].tolist(), self.device)
                made = batch.finish(self.average(*batch.inputs))
                plain = batch.plain
                for where, found in ((None, gains), (1 - batch.mask, in_holes)):
                    gain = decibels(made, batch.target, where)
                    found += (gain - decibels(plain, batch.target, where)).tolist()
        return float(np.nanmean(gains)), float(np.nanmean(in_holes))

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
        kept = _read_checkpoint(path, self.device)
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

    def _record(self, loss: float, gain: float, in_holes: float) -> None:
        """Add a row to the curve, and tell of it."""
        values = (round(self.seconds), loss, self._rate(), gain, in_holes)
        add_row(self.folder / CURVE, self.step, values)
        left = self.seconds / self.step * (self.settings.steps - self.step) / 60
        self.say(
            f"step {self.step} of {self.settings.steps}: loss {loss:.4f}, held-out scenes "
            f"{gain:+.2f} dB over the filled warp, {in_holes:+.2f} dB in holes, {left:.0f} min left"
        )


def train_extrapolator(
    scenes: Sequence[RenderedScene],
    folder: Path,
    cache: Path,
    settings: TrainingSettings,
    every: int,
    threads: int | None,
    say: Say,
    start: Path | None = None,
) -> Path:
    """Train a network and export it; return the model's path.

    Parameters
    ----------
    scenes
        To learn from; every twelfth is held out.
    folder
        For checkpoint, curve, settings and model; an earlier run there is gone on with.
    cache
        For prepared crops, which later trainings share.
    settings
        Of the training; `scenes` in it is filled in here. See :func:`require_sane`.
    every
        Steps between two checkpoints.
    threads
        For torch and what prepares crops; None for all cores.
    say
        Told what happens, in lines.
    start
        Another training's checkpoint, to begin with its weights; None for random ones.
    """
    require_sane(settings)
    use_threads(threads)
    torch.set_num_threads(cores.count())
    parts = dict(zip(("training", "validation"), split(scenes), strict=True))
    names = {part: [s.name for s in chosen] for part, chosen in parts.items()}
    digest = None if start is None else file_digest(start)
    settings = TrainingSettings(**(asdict(settings) | {"scenes": names, "start": digest}))
    training = Training(folder, settings, say)
    if start is not None:
        training.begin_with(start)
    crops = {
        part: Crops(list(_prepare(chosen, settings, cache, say))) for part, chosen in parts.items()
    }
    say(
        f"{settings.architecture} on {training.device}: {len(crops['training'])} crops of "
        f"{len(names['training'])} scenes, {len(crops['validation'])} of "
        f"{len(names['validation'])} held out"
    )
    training.run(crops["training"], crops["validation"], every)
    return training.export()


def _read_checkpoint(path: Path, device: str) -> dict[str, Any]:
    kept = read_tensors(path, device, _damaged(path))
    if not isinstance(kept, dict):
        raise _damaged(path)
    return kept


def _damaged(path: Path) -> DamagedFileError:
    return DamagedFileError(
        f"{path} is damaged, or no checkpoint of this version; choose another folder, or remove "
        "this one to begin anew"
    )


def _fast_halves(device: str) -> bool:
    """Whether 16-bit floats are faster: with AVX-512 BF16 a step takes two thirds of the time."""
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    # torch.cpu.get_capabilities tells it too, but is younger than the oldest torch that is allowed.
    processors = Path("/proc/cpuinfo")
    return processors.is_file() and "avx512_bf16" in processors.read_text(encoding="utf-8")


def _prepare(
    scenes: Sequence[RenderedScene], settings: TrainingSettings, cache: Path, say: Say
) -> Iterator[Path]:
    wanted = CropSettings(settings.frames, settings.side, settings.seed)
    for count, scene in enumerate(scenes, start=1):
        folder = crops_folder(scene, wanted, cache)
        if not is_whole(folder):
            say(f"preparing {scene.name}, {count} of {len(scenes)}")
            write_crops(scene, wanted, folder)
        yield folder


def _ahead(crops: Crops, first: int, settings: TrainingSettings, device: str) -> Iterator[Batch]:
    """Return the batches of the steps that are left; the next one is read while one is learnt."""

    def draw(step: int) -> Batch:
        return crops.drawn(step, settings.batch, settings.patch, settings.seed, device)

    return prefetch((partial(draw, step) for step in range(first, settings.steps)), 1)
