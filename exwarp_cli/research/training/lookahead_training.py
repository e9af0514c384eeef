"""The look-ahead network and its training.

A U-Net weighs what both key frames show of each pixel of a slot. After Briedis and others,
"Kernel-Based Frame Interpolation for Spatio-Temporally Adaptive Rendering", SIGGRAPH 2023, with
kernels of one pixel: weights, softmax over candidates, are made once for all layers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from exwarp_cli.domain.network_api import CANDIDATES, LOOKAHEAD_INTERFACE, SIDES
from exwarp_cli.errors import LayoutError
from exwarp_cli.io.dataset import RenderedScene
from exwarp_cli.research.training.extrapolation_network import LEAK, STRIDE, UNet
from exwarp_cli.research.training.lookahead_samples import (
    SampleBatch,
    Samples,
    samples_folder,
    write_samples,
)
from exwarp_cli.research.training.onnx_export import export_network
from exwarp_cli.research.training.resumable_training import (
    WARM_UP,
    ResumableTraining,
    read_checkpoint,
)
from exwarp_cli.research.training.training_settings import LookAheadSettings

MODEL = "lookahead.onnx"

# Channels of the last layer at full resolution.
DETAIL = 16

# How many times as many channels there are after each halving.
GROWTH = (1.5, 2, 3)

# Channels that are made of the inputs for each pixel.
INPUT_PLANES = 28

# What differences of colour are multiplied by: most are small.
CONTRAST = 4.0

# Differences of depth, octaves, beyond which all are alike.
MOST_DEPTH = 4.0

# Logit of what `softsplat` makes above those of the sides, before any training.
CERTAIN = 2.0

# Share of the network's answer in the shipped model. The whole of it gained 0.02 dB less on six
# scenes in the mean, and lost 0.07 on one: it is surer than it should be on unknown scenes.
SHARE = 0.6

# Share of the steps for which the rate stays, and what it ends at, as a share of its highest.
HIGH, LEAST_RATE = 0.3, 0.005

# Values as displayed above it count as it: far highlights are not visible.
BRIGHTEST = 1.5

# Added to squared errors before their logarithm: a patch 47 dB from the truth is good enough.
LEAST_ERROR = 2e-5

# Weights of the error of gradients, and of that of their mean magnitude over blocks.
GRADIENT, SHARPNESS = 0.25, 0.3

# Side of the blocks, pixels; and what is added to the truth's mean slope before it divides.
BLOCK, LEAST_SLOPE = 8, 2e-3

# Slots, at most, that validation looks at.
VALIDATED = 60


class NormalisedConvolution(nn.Module):
    """A convolution over 3x3 pixels, normalised over the batch; `stride` 2 halves the size."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        # Without it the softmax soon settles on its first candidate for good.
        self.norm = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Return [N, outputs, H, W]."""
        return functional.leaky_relu(self.norm(self.conv(x)), LEAK)


class WeighingNetwork(UNet):
    """Maps the inputs of `domain.lookahead.LOOKS_AHEAD` to weights; `width` at half resolution."""

    def __init__(self, width: int) -> None:
        super().__init__(INPUT_PLANES, DETAIL, width, GROWTH, NormalisedConvolution)
        self.detail = NormalisedConvolution(DETAIL + INPUT_PLANES, DETAIL)
        self.head = nn.Conv2d(DETAIL, CANDIDATES, 3, padding=1)
        logits = torch.zeros(CANDIDATES)
        logits[0] = CERTAIN
        with torch.no_grad():
            self.head.weight.mul_(0.1)
            self.head.bias.copy_(logits)  # type: ignore[union-attr]

    def forward(  # type: ignore[override]
        self, colour: Tensor, masks: Tensor, depth: Tensor, agreement: Tensor, time: Tensor
    ) -> Tensor:
        """Return the weights, float32 [N, CANDIDATES, H, W]."""
        planes = _input_planes(colour, masks, depth, agreement, time)
        x = self.head(self.detail(torch.cat([super().forward(planes), planes], 1)))
        return torch.softmax(x.float(), 1)


class ShippedNetwork(nn.Module):
    """The network as it is shipped: `softsplat` keeps a share of the weight."""

    kept: Tensor

    def __init__(self, network: WeighingNetwork) -> None:
        super().__init__()
        self.network = network
        kept = torch.zeros(1, CANDIDATES, 1, 1)
        kept[:, 0] = 1 - SHARE
        self.register_buffer("kept", kept)

    def forward(
        self, colour: Tensor, masks: Tensor, depth: Tensor, agreement: Tensor, time: Tensor
    ) -> Tensor:
        """Return the weights, float32 [N, CANDIDATES, H, W]."""
        weights: Tensor = self.network(colour, masks, depth, agreement, time)
        return SHARE * weights + self.kept


def _input_planes(
    colour: Tensor, masks: Tensor, depth: Tensor, agreement: Tensor, time: Tensor
) -> Tensor:
    """Return what the network sees of each pixel, [N, INPUT_PLANES, H, W]."""
    mixed, sides = colour[:, :3], colour[:, 3:]
    apart = CONTRAST * (sides - mixed.repeat(1, SIDES, 1, 1))
    before, after, lit_before, lit_after = (sides[:, i : i + 3] for i in range(0, 12, 3))
    between = [
        CONTRAST * (a - b).abs().mean(1, keepdim=True)
        for a, b in ((before, after), (lit_before, lit_after))
    ]
    padded = functional.pad(depth, (1, 1, 1, 1), mode="replicate")
    furthest, nearest = functional.max_pool2d(padded, 3, 1), -functional.max_pool2d(-padded, 3, 1)
    relative = (depth[:, :1] - depth[:, 1:]).clamp(-MOST_DEPTH, MOST_DEPTH)
    jump = (furthest - nearest).clamp(max=MOST_DEPTH).amax(1, keepdim=True)
    above = (depth - nearest).clamp(max=MOST_DEPTH).amax(1, keepdim=True)
    when = torch.zeros_like(relative) + time.reshape(-1, 1, 1, 1)
    return torch.cat([mixed, apart, *between, masks, relative, jump, above, agreement, when], 1)


def mix(weights: Tensor, colour: Tensor) -> Tensor:
    """Return the weighted mean of the candidates of each pixel, [N, 3, H, W].

    Weights are [N, CANDIDATES, H, W]; `colour` [N, 3 (1 + SIDES), H, W] is the input of that name.
    """
    candidates = colour.reshape(colour.shape[0], CANDIDATES, 3, *colour.shape[2:])
    return (weights[:, :, None] * candidates).sum(1)


def loss_of(colour: Tensor, truth: Tensor) -> Tensor:
    """Return the loss of pictures as displayed, [N, 3, S, S].

    The sum of the logarithm of the squared error, which is what PSNR judges, of that of the
    gradients, which keep structure, and of how far the mean magnitude of gradients is from the
    truth's, block by block.
    """
    colour, truth = colour.clamp(max=BRIGHTEST), truth.clamp(max=BRIGHTEST)
    loss = 0.5 * _log_error(colour, truth).mean()
    pairs = list(zip(_gradients(colour), _gradients(truth), strict=True))
    squared = torch.stack([(a - b).square().mean((1, 2, 3)) for a, b in pairs]).sum(0)
    loss = loss + GRADIENT * torch.log(squared + LEAST_ERROR).mean()
    # The mean of two sides that differ is softer than either.
    for pair in pairs:
        slopes = [functional.avg_pool2d(g.abs().mean(1, keepdim=True), BLOCK) for g in pair]
        apart = (slopes[0] - slopes[1]).abs().mean((1, 2, 3))
        loss = loss + SHARPNESS * (apart / (slopes[1].mean((1, 2, 3)) + LEAST_SLOPE)).mean()
    return loss


def _log_error(colour: Tensor, truth: Tensor) -> Tensor:
    return torch.log((colour - truth).square().mean((1, 2, 3)) + LEAST_ERROR)


def _gradients(x: Tensor) -> tuple[Tensor, Tensor]:
    return x[..., 1:] - x[..., :-1], x[..., 1:, :] - x[..., :-1, :]


class LookAheadTraining(ResumableTraining):
    """One training of a look-ahead network."""

    network: WeighingNetwork
    average: WeighingNetwork
    settings: LookAheadSettings
    weight_decay = 1e-5
    largest_gradient = 0.5
    # The scores of held-out slots: dB over `softsplat`, and how far the mean gradient is from the
    # truth's.
    columns = ("step", "seconds", "loss", "rate", "gain_db", "sharpness_percent")

    def _make_network(self) -> WeighingNetwork:
        return WeighingNetwork(self.settings.width)

    def _load_start(self, path: Path) -> None:
        content = read_checkpoint(path, self.device)
        try:
            self.network.load_state_dict(content["average"])
        except (KeyError, RuntimeError) as error:
            raise LayoutError(
                f"{path} holds another network than one of {self.settings.width} channels; give "
                "its --width, or another --start"
            ) from error

    def _sample_folder(self, scene: RenderedScene, cache: Path) -> Path:
        return samples_folder(scene, self.settings.seed, cache)

    def _write_samples(self, scene: RenderedScene, folder: Path) -> None:
        write_samples(scene, self.settings.seed, folder)

    def _open_samples(self, folders: Sequence[Path]) -> Samples:
        return Samples(folders)

    def export(self) -> Path:
        """Write the network as an ONNX model; return its path."""
        path, settings = self.folder / MODEL, self.settings
        about = (
            f"ExWarp look-ahead network, {settings.width} channels, {self.step} steps on "
            f"{len(settings.scenes['training'])} scenes, seed {settings.seed}"
        )
        shipped = ShippedNetwork(self.average)
        export_network(shipped, path, LOOKAHEAD_INTERFACE, stride=STRIDE, about=about)
        return path

    def _loss(self, batch: SampleBatch) -> Tensor:
        colour = mix(self.network(**batch.inputs, time=batch.time), batch.inputs["colour"])
        return loss_of(colour, batch.truth)

    def _rate(self) -> float:
        # A straight rise, a plain, half a cosine.
        settings = self.settings
        if self.step < WARM_UP:
            return settings.rate * (self.step + 1) / WARM_UP
        done = max(0.0, (self.step / settings.steps - HIGH) / (1 - HIGH))
        wave = 0.5 * (1 + math.cos(math.pi * done))
        return settings.rate * (LEAST_RATE + (1 - LEAST_RATE) * wave)

    @torch.no_grad()
    def _validate(self, samples: Samples) -> tuple[float, float]:
        """Return the gain over `softsplat` in dB, and per cent of sharpness, of held-out slots."""
        self.average.eval()
        count = min(VALIDATED, len(samples))
        indices = np.unique(np.linspace(0, len(samples) - 1, count).astype(int))
        scores = [self._score(samples.whole(int(index)).to(self.device)) for index in indices]
        gain, sharpness = np.mean(scores, axis=0)
        return float(gain), float(sharpness)

    def _score(self, sample: SampleBatch) -> tuple[float, float]:
        height, width = sample.truth.shape[-2:]
        padding = (0, -width % STRIDE, 0, -height % STRIDE)
        inputs = {
            name: functional.pad(picture, padding, mode="replicate")
            for name, picture in sample.inputs.items()
        }
        colour = mix(self.average(**inputs, time=sample.time), inputs["colour"])
        colour = colour[..., :height, :width].clamp(0, 1)
        truth, plain = sample.truth.clamp(0, 1), sample.inputs["colour"][:, :3].clamp(0, 1)
        gain = 10 / math.log(10) * (_log_error(plain, truth) - _log_error(colour, truth))
        slopes = [sum(g.abs().mean() for g in _gradients(p.mean(1))) for p in (colour, truth)]
        return float(gain), 100 * (float(slopes[0]) / max(float(slopes[1]), 1e-6) - 1)

    def _scores_text(self, *scores: float) -> str:
        gain, sharpness = scores
        return f"{gain:+.2f} dB over softsplat, gradients {sharpness:+.1f} % of the truth's"
