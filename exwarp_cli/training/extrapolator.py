"""Training an extrapolation network: resumable, seeded, with its validation curve in a file.

Losses are those of ExtraNet, section 4.4. A larger network may begin as what a smaller one has
learnt (Net2Net, Chen et al. 2016).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from exwarp_cli.errors import LayoutError
from exwarp_cli.io.dataset import RenderedScene
from exwarp_cli.io.threads import use_threads
from exwarp_cli.pipeline.scheduling import prefetch
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.training.crops import Batch, Crops
from exwarp_cli.training.export import export_extrapolator
from exwarp_cli.training.exported import load_exported, normalise_by
from exwarp_cli.training.networks import STRIDE, ExtrapolationNetwork, Gated, build
from exwarp_cli.training.resumable import (
    WARM_UP,
    ResumableTraining,
    Say,
    begun,
    parts_of,
    prepared,
    read_checkpoint,
)
from exwarp_cli.training.samples import CropSettings, crops_folder, write_crops
from exwarp_cli.training.settings import CURVE, TrainingSettings, add_row, require_sane

MODEL = "extrapolator.onnx"

LEAST_RATE = 0.02
"""What the learning rate ends at, as a share of its highest."""

VALIDATED = 192
"""Crops, at most, that validation looks at, and how many at a time."""
TOGETHER = 16

SETTLED = 16
"""Batches by whose statistics the layers of an exported network normalise."""

CLIPPED = 0.3
"""Largest norm of a gradient."""

DECAY = 0.01
"""Of the weights, by the optimiser."""


class Training(ResumableTraining):
    """One training of an extrapolation network."""

    network: ExtrapolationNetwork
    average: ExtrapolationNetwork
    settings: TrainingSettings

    def __init__(self, folder: Path, settings: TrainingSettings, say: Say) -> None:
        device = "cuda" if torch.cuda.is_available() else "cpu"
        torch.manual_seed(settings.seed)
        network = build(settings.architecture, settings.width).to(device)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._exported = False
        self._halved = _fast_halves(device)
        super().__init__(folder, settings, say, network, DECAY, CLIPPED, device)

    def begin_with(self, path: Path) -> None:
        """Take the weights of another training, unless this one is under way.

        Parameters
        ----------
        path
            Its checkpoint, whose network may have fewer channels, see `grown`; or the model that
            it wrote.

        Raises
        ------
        InputError
            When there is no such file, or its network is of another architecture.
        """
        if self.step:
            return
        try:
            if path.suffix == ".onnx":
                load_exported(path, self.network)
                self._exported = True
            else:
                kept = read_checkpoint(path, self.device)
                self.network.load_state_dict(grown(kept["average"], self.network))
        except (KeyError, ValueError) as error:
            raise LayoutError(
                f"{path} holds another network than {self.settings.architecture} or a smaller one; "
                "give its --architecture and --width, or another --start"
            ) from error
        self.average.load_state_dict(self.network.state_dict())

    def run(self, crops: Crops, held: Crops, every: int) -> None:
        """Train to the end; a checkpoint and a line of the curve every so many steps."""
        if self._exported:
            batches = (_drawn(crops, step, self.settings, self.device) for step in range(SETTLED))
            normalise_by(self.network, batches)
            self.average.load_state_dict(self.network.state_dict())
        ahead = _ahead(crops, self.step, self.settings, self.device)
        self._run(ahead, partial(self._validate, held), every)

    def export(self) -> Path:
        """Write the network as an ONNX model; return its path."""
        target = self.folder / MODEL
        about = (
            f"ExWarp extrapolation network, {self.settings.architecture}, {self.step} steps on "
            f"{len(self.settings.scenes['training'])} scenes, seed {self.settings.seed}"
        )
        export_extrapolator(self.average, target, stride=STRIDE, about=about)
        return target

    def _loss(self, batch: Batch) -> Tensor:
        with torch.autocast(self.device, torch.bfloat16, enabled=self._halved):
            answer = self.network(*batch.inputs)
        made = batch.finish(answer.float())
        return loss_of(made, batch.target, batch.plain, batch.mask)

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

    def _record(self, loss: float, *scores: float) -> None:
        gain, in_holes = scores
        values = (round(self.seconds), loss, self._rate(), gain, in_holes)
        add_row(self.folder / CURVE, self.step, values)
        self.say(
            f"step {self.step} of {self.settings.steps}: loss {loss:.4f}, held-out scenes "
            f"{gain:+.2f} dB over the filled warp, {in_holes:+.2f} dB in holes, "
            f"{self._minutes_left:.0f} min left"
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
        Receives what happens, in lines.
    start
        Another training's checkpoint or model, to begin with its weights; None for random ones.
    """
    require_sane(settings)
    use_threads(threads)
    torch.set_num_threads(cores.count())
    parts = parts_of(scenes)
    settings = begun(settings, parts, start)
    training = Training(folder, settings, say)
    if start is not None:
        training.begin_with(start)
    wanted = CropSettings(settings.frames, settings.side, settings.seed)

    def folder_of(scene: RenderedScene) -> Path:
        return crops_folder(scene, wanted, cache)

    def write(scene: RenderedScene, crops: Path) -> None:
        write_crops(scene, wanted, crops)

    crops = {
        part: Crops(list(prepared(chosen, folder_of, write, say))) for part, chosen in parts.items()
    }
    say(
        f"{settings.architecture} on {training.device}: {len(crops['training'])} crops of "
        f"{len(parts['training'])} scenes, {len(crops['validation'])} of "
        f"{len(parts['validation'])} held out"
    )
    training.run(crops["training"], crops["validation"], every)
    return training.export()


def _fast_halves(device: str) -> bool:
    """Whether 16-bit floats are faster: with AVX-512 BF16 a step takes two thirds of the time."""
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    # torch.cpu.get_capabilities tells it too, but is younger than the oldest torch that is allowed.
    processors = Path("/proc/cpuinfo")
    return processors.is_file() and "avx512_bf16" in processors.read_text(encoding="utf-8")


def _ahead(crops: Crops, first: int, settings: TrainingSettings, device: str) -> Iterator[Batch]:
    """Return the batches of the steps that are left; the next one is read while one is learnt."""
    steps = range(first, settings.steps)
    return prefetch((partial(_drawn, crops, step, settings, device) for step in steps), 1)


def _drawn(crops: Crops, step: int, settings: TrainingSettings, device: str) -> Batch:
    return crops.drawn(step, settings.batch, settings.patch, settings.seed, device)


HARDEST = 0.1
"""Share of the pixels that count once more."""

FEW = 0.005
"""Share of holes below which they count for less: a few pixels tell little."""

HOLES = 2.0
"""Weight of the error in holes."""

SQUARED = 0.15
SQUARED_HOLES = 0.6
"""Weights of the squared error: as a share overall, as the share's logarithm in holes."""

DOUBT = 0.01
"""What is added to a picture's error before it is divided by: about the renders' own noise."""

KNEE = 1.0
SLOPE = 0.45
"""Above 1 brightness counts by its logarithm, with the slope that the sRGB curve ends on."""


def shown(linear: Tensor) -> Tensor:
    """Return linear colour as the eye sees it: the sRGB curve, going on above white."""
    low = linear.clamp(0, KNEE)
    power = 1.055 * low.clamp_min(1e-6) ** (1 / 2.4) - 0.055
    curve = torch.where(low <= 0.0031308, 12.92 * low, power)
    return curve + SLOPE * torch.log(linear.clamp_min(KNEE)) + linear.clamp_max(0)


def loss_of(made: Tensor, truth: Tensor, plain: Tensor, mask: Tensor) -> Tensor:
    """Return L1 + L1 over holes + L1 over the hardest tenth, all of colour as it is shown.

    To ExtraNet's three terms comes the squared error as a share of the filled warp's: that is what
    PSNR counts. In holes, where much is possible, it is the share's logarithm, which is the gain in
    decibels; L1 alone wants the median there, whose squared error is larger than the mean's.

    Parameters
    ----------
    made, truth
        Linear [N, 3, H, W].
    plain
        The filled warp, linear [N, 3, H, W]. Each picture weighs by the inverse of its error: a
        decibel is worth the same on a picture that is nearly right as on one that is not.
    mask
        [N, 1, H, W], 0 in holes.
    """
    wanted = shown(truth)
    error = (shown(made) - wanted).abs().mean(1).flatten(1)
    hole = 1 - mask.flatten(1)
    in_holes = (error * hole).sum(1) / (hole.sum(1) + FEW * hole.shape[1])
    hardest = error.topk(int(HARDEST * error.shape[1]), dim=1).values.mean(1)
    worth = 1 / ((shown(plain) - wanted).abs().mean((1, 2, 3)) + DOUBT)
    total = (error.mean(1) + HOLES * in_holes + hardest) * worth
    squares = [(shown(x) - wanted).square().mean(1).flatten(1) for x in (made, plain)]
    shares = squares[0].mean(1) / (squares[1].mean(1) + DOUBT**2)
    few = FEW * hole.shape[1] * DOUBT
    found, before = ((square * hole).sum(1) + few for square in squares)
    gained = SQUARED * shares + SQUARED_HOLES * torch.log(found / before)
    return total.sum() / worth.sum() + gained.mean()


def decibels(made: Tensor, truth: Tensor, where: Tensor | None = None) -> Tensor:
    """Return PSNR in sRGB of each picture [N]; over `where` [N, 1, H, W] only, NaN if empty."""
    squared = (shown(made.clamp(0, 1)) - shown(truth.clamp(0, 1))).square().mean(1, keepdim=True)
    if where is None:
        where = torch.ones_like(squared)
    total = (squared * where).sum((1, 2, 3)) / where.sum((1, 2, 3))
    return -10 * torch.log10(total.clamp_min(1e-10))


def grown(kept: Mapping[str, Tensor], network: nn.Module) -> dict[str, Tensor]:
    """Return weights with which a network answers as the one whose weights were kept does.

    Channels that it has in addition begin at random, and nothing of what was kept listens to them.

    Parameters
    ----------
    kept
        Weights of a network of the same layers, each of as many channels or fewer.
    network
        Whose weights are to be replaced; it is left as it is.

    Raises
    ------
    KeyError
        When the layers are others.
    ValueError
        When a layer that was kept has more channels, or answers with others.
    """
    made = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    if made.keys() != kept.keys():
        raise KeyError(f"layers {sorted(made.keys() ^ kept.keys())} are in one network only")
    gated = {name for name, module in network.named_modules() if isinstance(module, Gated)}
    for name, new in made.items():
        old = kept[name].to(new.device)
        if old.shape == new.shape:
            new.copy_(old)
        else:
            _put(old, new, gated=name.rsplit(".", 2)[0] in gated, name=name)
    return made


def _put(old: Tensor, new: Tensor, gated: bool, name: str) -> None:
    """Put a layer's weights into those of a wider one."""
    if old.ndim != new.ndim or any(a > b for a, b in zip(old.shape, new.shape, strict=True)):
        raise ValueError(f"{name} is {tuple(old.shape)}, which {tuple(new.shape)} cannot hold")
    if old.shape[0] != new.shape[0] and not gated:
        raise ValueError(f"{name} answers with {old.shape[0]} channels, not {new.shape[0]}")
    outs = torch.arange(old.shape[0])
    if gated:
        outs[-1] = new.shape[0] - 1  # the gate
    if old.ndim == 1:
        new[outs] = old
        return
    ins = torch.arange(old.shape[1])
    if ".up." in name:
        # What comes from below, then what was kept on the way down: as much as is answered.
        skipped = old.shape[0] - 1
        ins[-skipped:] += (new.shape[1] - (new.shape[0] - 1)) - (old.shape[1] - skipped)
    new[outs] = 0
    new[outs[:, None], ins[None]] = old
