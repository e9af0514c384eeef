"""Training the look-ahead network: resumable, seeded, with its validation curve in a file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from exwarp_cli.domain import cores
from exwarp_cli.domain.network_api import LOOKAHEAD_INTERFACE
from exwarp_cli.errors import LayoutError
from exwarp_cli.io.dataset import RenderedScene
from exwarp_cli.io.threads import use_threads
from exwarp_cli.pipeline.scheduling import prefetch
from exwarp_cli.training.export import export_network
from exwarp_cli.training.lookahead_samples import (
    Sample,
    Samples,
    samples_folder,
    write_samples,
)
from exwarp_cli.training.networks import STRIDE
from exwarp_cli.training.resumable import (
    WARM_UP,
    ResumableTraining,
    Say,
    begun,
    parts_of,
    prepared,
    read_checkpoint,
)
from exwarp_cli.training.settings import CURVE, LookAheadSettings, add_row
from exwarp_cli.training.weighing import HeldBack, WeighingNetwork, mix

MODEL = "lookahead.onnx"

COLUMNS = ("step", "seconds", "loss", "rate", "gain_db", "sharpness_percent")
"""Of the curve; the last two of held-out slots: dB over `softsplat`, and how far the mean gradient
is from the truth's."""

HIGH, LEAST_RATE = 0.3, 0.005
"""Share of the steps for which the rate stays, and what it ends at, as a share of its highest."""

CLIPPED = 0.5
"""Largest norm of a gradient."""

DECAY = 1e-5
"""Of the weights, by the optimiser."""

BRIGHTEST = 1.5
"""Values as shown above it count as it: far highlights are not seen."""

LEAST_ERROR = 2e-5
"""Added to squared errors before their logarithm: a patch 47 dB from the truth is good enough."""

GRADIENT, SHARPNESS = 0.25, 0.3
"""Weights of the error of gradients, and of that of their mean magnitude over blocks."""

BLOCK, LEAST_SLOPE = 8, 2e-3
"""Side of the blocks, pixels; and what is added to the truth's mean slope before it divides."""

VALIDATED = 60
"""Slots, at most, that validation looks at."""


def loss_of(made: Tensor, truth: Tensor) -> Tensor:
    """Return the loss of pictures as shown, [N, 3, S, S].

    The logarithm of the squared error, which is what PSNR judges; that of the gradients, which keep
    structure; and how far the mean magnitude of gradients is from the truth's, block by block: the
    mean of two sides that differ is softer than either.
    """
    made, truth = made.clamp(max=BRIGHTEST), truth.clamp(max=BRIGHTEST)
    loss = 0.5 * _log_error(made, truth).mean()
    pairs = list(zip(_gradients(made), _gradients(truth), strict=True))
    squared = torch.stack([(a - b).square().mean((1, 2, 3)) for a, b in pairs]).sum(0)
    loss = loss + GRADIENT * torch.log(squared + LEAST_ERROR).mean()
    for one, other in pairs:
        slopes = [functional.avg_pool2d(g.abs().mean(1, keepdim=True), BLOCK) for g in (one, other)]
        apart = (slopes[0] - slopes[1]).abs().mean((1, 2, 3))
        loss = loss + SHARPNESS * (apart / (slopes[1].mean((1, 2, 3)) + LEAST_SLOPE)).mean()
    return loss


def _log_error(made: Tensor, truth: Tensor) -> Tensor:
    return torch.log((made - truth).square().mean((1, 2, 3)) + LEAST_ERROR)


def _gradients(x: Tensor) -> tuple[Tensor, Tensor]:
    return x[..., 1:] - x[..., :-1], x[..., 1:, :] - x[..., :-1, :]


class Training(ResumableTraining):
    """One training of a look-ahead network."""

    network: WeighingNetwork
    average: WeighingNetwork
    settings: LookAheadSettings

    def __init__(self, folder: Path, settings: LookAheadSettings, say: Say) -> None:
        torch.manual_seed(settings.seed)
        network = WeighingNetwork(settings.width)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        super().__init__(folder, settings, say, network, DECAY, CLIPPED)

    def begin_with(self, path: Path) -> None:
        """Take the weights of another training's checkpoint, unless this one is under way.

        Raises
        ------
        InputError
            When there is no such file, or its network has other layers.
        """
        if self.step:
            return
        kept = read_checkpoint(path, self.device)
        try:
            self.network.load_state_dict(kept["average"])
        except (KeyError, RuntimeError) as error:
            raise LayoutError(
                f"{path} holds another network than one of {self.settings.width} channels; give "
                "its --width, or another --start"
            ) from error
        self.average.load_state_dict(self.network.state_dict())

    def run(self, samples: Samples, held: Samples, every: int) -> None:
        """Train to the end; a checkpoint and a line of the curve every so many steps."""
        self._run(self._ahead(samples), partial(self._validate, held), every)

    def export(self) -> Path:
        """Write the network as an ONNX model; return its path."""
        target, settings = self.folder / MODEL, self.settings
        about = (
            f"ExWarp look-ahead network, {settings.width} channels, {self.step} steps on "
            f"{len(settings.scenes['training'])} scenes, seed {settings.seed}"
        )
        export_network(
            HeldBack(self.average), target, LOOKAHEAD_INTERFACE, stride=STRIDE, about=about
        )
        return target

    def _ahead(self, samples: Samples) -> Iterator[Sample]:
        """Return the batches of the steps that are left; the next is read while one is learnt."""
        s = self.settings
        draw = partial(samples.drawn, size=s.batch, side=s.patch, seed=s.seed)
        return prefetch((partial(draw, step) for step in range(self.step, s.steps)), 1)

    def _loss(self, sample: Sample) -> Tensor:
        made = mix(self.network(**sample.inputs, time=sample.time), sample.inputs["colour"])
        return loss_of(made, sample.truth)

    def _rate(self) -> float:
        """Learning rate of this step: a straight rise, a plain, half a cosine."""
        settings = self.settings
        if self.step < WARM_UP:
            return settings.rate * (self.step + 1) / WARM_UP
        done = max(0.0, (self.step / settings.steps - HIGH) / (1 - HIGH))
        wave = 0.5 * (1 + math.cos(math.pi * done))
        return settings.rate * (LEAST_RATE + (1 - LEAST_RATE) * wave)

    @torch.no_grad()
    def _validate(self, held: Samples) -> tuple[float, float]:
        """Return the gain over `softsplat` in dB, and per cent of sharpness, of held-out slots."""
        self.average.eval()
        chosen = np.unique(np.linspace(0, len(held) - 1, min(VALIDATED, len(held))).astype(int))
        found = [self._judge(held.whole(int(index))) for index in chosen]
        gain, sharpness = np.mean(found, axis=0)
        return float(gain), float(sharpness)

    def _judge(self, sample: Sample) -> tuple[float, float]:
        height, width = sample.truth.shape[-2:]
        around = (0, -width % STRIDE, 0, -height % STRIDE)
        inputs = {
            name: functional.pad(picture, around, mode="replicate")
            for name, picture in sample.inputs.items()
        }
        made = mix(self.average(**inputs, time=sample.time), inputs["colour"])
        made = made[..., :height, :width].clamp(0, 1)
        truth, plain = sample.truth.clamp(0, 1), sample.inputs["colour"][:, :3].clamp(0, 1)
        gain = 10 / math.log(10) * (_log_error(plain, truth) - _log_error(made, truth))
        slopes = [sum(g.abs().mean() for g in _gradients(p.mean(1))) for p in (made, truth)]
        return float(gain), 100 * (float(slopes[0]) / max(float(slopes[1]), 1e-6) - 1)

    def _record(self, loss: float, *scores: float) -> None:
        gain, sharpness = scores
        values = (round(self.seconds), loss, self._rate(), gain, sharpness)
        add_row(self.folder / CURVE, self.step, values, COLUMNS)
        self.say(
            f"step {self.step} of {self.settings.steps}: loss {loss:.4f}, held-out scenes "
            f"{gain:+.2f} dB over softsplat, gradients {sharpness:+.1f} % of the truth's, "
            f"{self._minutes_left:.0f} min left"
        )


def train_lookahead(
    scenes: Sequence[RenderedScene],
    folder: Path,
    cache: Path,
    settings: LookAheadSettings,
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
        For prepared samples, which later trainings share.
    settings
        Of the training; `scenes` and `start` in it are filled in here.
    every
        Steps between two checkpoints.
    threads
        For torch and what prepares samples; None for all cores.
    say
        Receives what happens, in lines.
    start
        Another training's checkpoint, to begin with its weights; None for random ones.
    """
    use_threads(threads)
    torch.set_num_threads(cores.count())
    parts = parts_of(scenes)
    settings = begun(settings, parts, start)
    training = Training(folder, settings, say)
    if start is not None:
        training.begin_with(start)

    def folder_of(scene: RenderedScene) -> Path:
        return samples_folder(scene, settings.seed, cache)

    def write(scene: RenderedScene, samples: Path) -> None:
        write_samples(scene, settings.seed, samples)

    samples = {
        part: Samples(list(prepared(chosen, folder_of, write, say)))
        for part, chosen in parts.items()
    }
    training.run(samples["training"], samples["validation"], every)
    return training.export()
