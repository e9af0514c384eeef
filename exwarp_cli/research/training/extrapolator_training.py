"""Training of an extrapolation network, from random weights, a checkpoint or a model.

The losses are those of ExtraNet (Guo et al. 2021), section 4.4. A larger network may begin with
what a smaller one has learned (Net2Net, Chen et al. 2016).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from exwarp_cli.domain.network_api import EXTRAPOLATOR_INTERFACE
from exwarp_cli.errors import DamagedFileError, UsageError
from exwarp_cli.research.training.crop_cache import Batch, CachedArrays, Crops, to_device
from exwarp_cli.research.training.extrapolation_network import (
    ARCHITECTURES,
    STRIDE,
    ExtrapolationNetwork,
    GatedConvolution,
)
from exwarp_cli.research.training.resumable_training import (
    ResumableTraining,
    Say,
    read_checkpoint,
    read_file,
)
from exwarp_cli.research.training.training_settings import ExtrapolatorSettings
from exwarp_cli.runtime.stop import check_stop

MODEL = "extrapolator.onnx"

# Crops, at most, that validation looks at, and how many at a time.
VALIDATED = 192
VALIDATION_BATCH = 16

# Batches by whose statistics the layers of an exported network normalise.
STATISTICS_BATCHES = 16

# End of the name of the offset that a folded normalisation leaves in a model.
FOLDED = ".both.weight_bias"

# Share of the pixels that count once more.
HARDEST = 0.1

# Share of holes below which they count for less: a few pixels tell little.
FEW = 0.005

# Weight of the error in holes.
HOLES = 2.0

# Weights of the squared error: as a share overall, as the share's logarithm in holes.
SQUARED = 0.15
SQUARED_HOLES = 0.6

# Added to a picture's error before it divides: about the renders' own noise.
RENDER_NOISE = 0.01

# Above 1 brightness counts by its logarithm, with the slope that the sRGB curve ends on.
KNEE = 1.0
SLOPE = 0.45


class ExtrapolatorTraining(ResumableTraining):
    """One training of an extrapolation network.

    Raises UsageError for an unknown architecture, or sizes that fit neither network nor crops.
    """

    network: ExtrapolationNetwork
    average: ExtrapolationNetwork
    settings: ExtrapolatorSettings
    samples = Crops
    weight_decay = 0.01
    largest_gradient = 0.3
    high = 0.0
    least_rate = 0.02
    network_class, network_options = ExtrapolationNetwork, ("architecture", "width")
    model, interface = MODEL, EXTRAPOLATOR_INTERFACE
    about = "extrapolation network, {0.architecture}"
    startable = "{0.architecture} or a smaller one; give its --architecture and --width"
    columns = ("step", "seconds", "loss", "rate", "gain_db", "gain_holes_db")
    scores_text = "{:+.2f} dB over the filled warp, {:+.2f} dB in holes"

    def __init__(self, folder: Path, settings: ExtrapolatorSettings, say: Say) -> None:
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
                f"--patch {settings.patch} is larger than --side {settings.side}; "
                "enlarge the latter"
            )
        if settings.batch < 2:
            raise UsageError(
                f"--batch {settings.batch} is too small to normalise over; give 2 or more"
            )
        if not 0 < settings.rate < 1:
            raise UsageError(f"--rate {settings.rate:g} is not between 0 and 1; try 0.002")
        self._begins_with_model = False
        super().__init__(folder, settings, say)
        # With AVX-512 BF16 a step takes two thirds of the time. torch.cpu.get_capabilities tells of
        # it too, but is younger than the oldest torch that is allowed.
        processors = Path("/proc/cpuinfo")
        self._uses_bfloat16 = (
            torch.cuda.is_bf16_supported()
            if self.device == "cuda"
            else processors.is_file() and "avx512_bf16" in processors.read_text(encoding="utf-8")
        )

    def _load_start(self, path: Path) -> None:
        if path.suffix == ".onnx":
            load_exported(path, self.network)
            self._begins_with_model = True
        else:
            content = read_checkpoint(path, self.device)
            self.network.load_state_dict(grow_weights(content["average"], self.network))

    def run(self, samples: CachedArrays, held_out: CachedArrays, every: int) -> None:
        """Train to the end; a checkpoint and a row of the curve every so many steps."""
        scenes = self.settings.scenes
        self.say(
            f"{self.settings.architecture} on {self.device}: {len(samples)} crops of "
            f"{len(scenes['training'])} scenes, {len(held_out)} of "
            f"{len(scenes['validation'])} held out"
        )
        if self._begins_with_model:
            s = self.settings
            batches = (samples.draw(n, s.batch, s.patch, s.seed) for n in range(STATISTICS_BATCHES))
            set_statistics(self.network, (to_device(batch, self.device) for batch in batches))
            self.average.load_state_dict(self.network.state_dict())
        super().run(samples, held_out, every)

    def _loss(self, batch: Batch) -> Tensor:
        with torch.autocast(self.device, torch.bfloat16, enabled=self._uses_bfloat16):
            answer = self.network(*batch.inputs)
        colour = batch.finish(answer.float())
        return loss_of(colour, batch.target, batch.plain, batch.mask)

    @torch.no_grad()
    def _validate(self, samples: Crops) -> tuple[float, float]:
        """Return by how many dB the network is above the filled warp: overall, and in holes."""
        self.average.eval()
        indices = samples.spread(VALIDATED)
        gains: list[float] = []
        gains_in_holes: list[float] = []
        for first in range(0, len(indices), VALIDATION_BATCH):
            check_stop()
            batch = to_device(samples.batch(indices[first : first + VALIDATION_BATCH]), self.device)
            colour, plain = batch.finish(self.average(*batch.inputs)), batch.plain
            for where, rows in ((None, gains), (1 - batch.mask, gains_in_holes)):
                gain = psnr(colour, batch.target, where) - psnr(plain, batch.target, where)
                rows += gain.tolist()
        return float(np.nanmean(gains)), float(np.nanmean(gains_in_holes))


def to_display(linear: Tensor) -> Tensor:
    """Return linear colour as the eye sees it: the sRGB curve, continued above white."""
    low = linear.clamp(0, KNEE)
    power = 1.055 * low.clamp_min(1e-6) ** (1 / 2.4) - 0.055
    curve = torch.where(low <= 0.0031308, 12.92 * low, power)
    return curve + SLOPE * torch.log(linear.clamp_min(KNEE)) + linear.clamp_max(0)


def loss_of(colour: Tensor, truth: Tensor, plain: Tensor, mask: Tensor) -> Tensor:
    """Return L1 + L1 over holes + L1 over the hardest tenth, all of colour as displayed.

    To ExtraNet's three terms comes the squared error as a share of the filled warp's, which is what
    PSNR counts. `colour`, `truth` and the filled warp `plain` are linear [N, 3, H, W]; `mask` is
    [N, 1, H, W], 0 in holes.
    """
    wanted = to_display(truth)
    error = (to_display(colour) - wanted).abs().mean(1).flatten(1)
    hole = 1 - mask.flatten(1)
    in_holes = (error * hole).sum(1) / (hole.sum(1) + FEW * hole.shape[1])
    hardest = error.topk(int(HARDEST * error.shape[1]), dim=1).values.mean(1)
    # A decibel is worth the same on a picture that is nearly right as on one that is not.
    worth = 1 / ((to_display(plain) - wanted).abs().mean((1, 2, 3)) + RENDER_NOISE)
    total = (error.mean(1) + HOLES * in_holes + hardest) * worth
    squares = [(to_display(x) - wanted).square().mean(1).flatten(1) for x in (colour, plain)]
    shares = squares[0].mean(1) / (squares[1].mean(1) + RENDER_NOISE**2)
    # In holes it is the share's logarithm, the gain in decibels: L1 alone wants the median there,
    # where much is possible, and its squared error is larger than the mean's.
    few = FEW * hole.shape[1] * RENDER_NOISE
    after, before = ((square * hole).sum(1) + few for square in squares)
    squared = SQUARED * shares + SQUARED_HOLES * torch.log(after / before)
    return total.sum() / worth.sum() + squared.mean()


def psnr(colour: Tensor, truth: Tensor, where: Tensor | None = None) -> Tensor:
    """Return PSNR in sRGB of each picture [N], dB; over `where` [N, 1, H, W], NaN if empty."""
    displayed = [to_display(x.clamp(0, 1)) for x in (colour, truth)]
    squared = (displayed[0] - displayed[1]).square().mean(1, keepdim=True)
    if where is None:
        where = torch.ones_like(squared)
    total = (squared * where).sum((1, 2, 3)) / where.sum((1, 2, 3))
    return -10 * torch.log10(total.clamp_min(1e-10))


def load_exported(path: Path, network: ExtrapolationNetwork) -> None:
    """Take the weights of a model that `export_network` wrote.

    The network is of the same architecture and width; in evaluation it answers as the model does.
    Raises KeyError or RuntimeError when the model has other layers, and InputError when the file
    cannot be read, or is no model.
    """
    data = read_file(path)
    try:
        model = onnx.load_from_string(data)
    except Exception as error:  # what is no model ends in exceptions of every kind
        raise DamagedFileError(f"{path} is no ONNX model; choose another --start") from error
    constants = {
        tensor.name: torch.from_numpy(numpy_helper.to_array(tensor).copy())
        for tensor in model.graph.initializer
    }
    weights = network.state_dict()
    # Exported models have the normalisation of each layer folded into its convolution.
    for name, layer in network.named_modules():
        if isinstance(layer, GatedConvolution):
            offset = constants[f"{name}{FOLDED}"]
            ones, zeros = torch.ones_like(offset), torch.zeros_like(offset)
            weights |= {
                f"{name}.both.weight": constants[f"{name}.both.weight"],
                f"{name}.norm.weight": ones,
                f"{name}.norm.bias": offset,
                f"{name}.norm.running_mean": zeros,
                f"{name}.norm.running_var": ones - layer.norm.eps,
            }
        elif isinstance(layer, nn.Conv2d) and layer.bias is not None:
            weights |= {
                f"{name}.{part}": constants[f"{name}.{part}"] for part in ("weight", "bias")
            }
    network.load_state_dict(weights)


def set_statistics(network: ExtrapolationNetwork, batches: Iterable[Batch]) -> None:
    """Let a network of `load_exported` normalise by the statistics of batches, and answer the same.

    Scale and offset of each layer undo its normalisation. Without this the first step of training
    would be by another network: in training layers normalise by their batch.
    """
    norms = [layer for layer in network.modules() if isinstance(layer, nn.BatchNorm2d)]
    moments: dict[nn.Module, list[tuple[Tensor, Tensor]]] = {norm: [] for norm in norms}

    def measure(norm: nn.Module, inputs: tuple[Tensor, ...]) -> None:
        values = inputs[0].float()
        moments[norm].append((values.mean((0, 2, 3)), values.square().mean((0, 2, 3))))

    hooks = [norm.register_forward_pre_hook(measure) for norm in norms]
    network.eval()
    with torch.no_grad():
        for batch in batches:
            network(*batch.inputs)
        for norm in norms:
            means, squares = (
                torch.stack(part).mean(0) for part in zip(*moments[norm], strict=True)
            )
            variance = squares - means.square()
            assert norm.running_mean is not None and norm.running_var is not None
            norm.running_mean.copy_(means)
            norm.running_var.copy_(variance)
            norm.bias.add_(means)
            norm.weight.copy_((variance + norm.eps).sqrt())
    for hook in hooks:
        hook.remove()


def grow_weights(smaller: Mapping[str, Tensor], network: nn.Module) -> dict[str, Tensor]:
    """Return weights with which a network answers as a smaller one of the same layers does.

    Channels that it has in addition begin at random, and no channel of the smaller one reads them.
    Raises KeyError when the layers are others, and ValueError when one of `smaller` has more
    channels, or answers with others.
    """
    weights = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    if weights.keys() != smaller.keys():
        raise KeyError(f"layers {sorted(weights.keys() ^ smaller.keys())} are in one network only")
    gated = {
        name for name, module in network.named_modules() if isinstance(module, GatedConvolution)
    }
    for name, new in weights.items():
        old = smaller[name].to(new.device)
        if old.shape == new.shape:
            new.copy_(old)
            continue
        if old.ndim != new.ndim or any(a > b for a, b in zip(old.shape, new.shape, strict=True)):
            raise ValueError(f"{name} is {tuple(old.shape)}, which {tuple(new.shape)} cannot hold")
        is_gated = name.rsplit(".", 2)[0] in gated
        if old.shape[0] != new.shape[0] and not is_gated:
            raise ValueError(f"{name} answers with {old.shape[0]} channels, not {new.shape[0]}")
        outputs = torch.arange(old.shape[0])
        if is_gated:
            outputs[-1] = new.shape[0] - 1  # the gate
        if old.ndim == 1:
            new[outputs] = old
            continue
        inputs = torch.arange(old.shape[1])
        if ".up." in name:
            # What comes from below, then what was kept on the way down: as much as is answered.
            skipped = old.shape[0] - 1
            inputs[-skipped:] += (new.shape[1] - (new.shape[0] - 1)) - (old.shape[1] - skipped)
        new[outputs] = 0
        new[outputs[:, None], inputs[None]] = old
    return weights
