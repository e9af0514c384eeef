"""The look-ahead network, the samples of rendered scenes that it learns from, and its training.

A U-Net weighs what both key frames show of each pixel of a slot. After Briedis and others,
"Kernel-Based Frame Interpolation for Spatio-Temporally Adaptive Rendering", SIGGRAPH 2023, with
kernels of one pixel: weights, softmax over candidates, are made once for all layers.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import (
    CANDIDATES,
    LOOKAHEAD_INTERFACE,
    SIDES,
    KeptPart,
    LazyInputs,
)
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.dataset import RenderedScene
from exwarp_cli.research.training.augmentation import PLAIN, Look, Variant, draw_look
from exwarp_cli.research.training.crop_cache import CachedArrays, to_device
from exwarp_cli.research.training.extrapolation_network import LEAK, STRIDE, UNet
from exwarp_cli.research.training.resumable_training import ResumableTraining
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.research.training.training_settings import LookAheadSettings
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.warp import linear_to_srgb

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

# Of what is cached; samples of another version are made again.
VERSION = 2

# Channels in the order in which a slot has them that is played backwards.
SWAPPED = {
    "colour": (0, 1, 2, 6, 7, 8, 3, 4, 5, 12, 13, 14, 9, 10, 11),
    "masks": (1, 0, 3, 2, 5, 4),
    "depth": (1, 0),
}

# Pixels by which patches are drawn beyond the frame's edge before they are moved inside.
OVERHANG = 12

# Share of patches that are the worst of `TRIED` for softmax splatting.
HARDER = 0.6
TRIED = 4

# How often depth is left out, and the octaves by which it is shifted.
NO_DEPTH = 0.12
DEPTH_SHIFT = 3.0

# Logarithm of what colour is multiplied by.
BRIGHTNESS = (-0.6, 0.3)


class _Recorder:
    """Stands in for a network: keeps its inputs, and answers with what `softsplat` makes."""

    checksum = ""
    pictures: dict[str, np.ndarray]

    def weigh(self, inputs: LazyInputs) -> Iterator[tuple[KeptPart, Float32]]:
        height, width = inputs.shape
        rows, columns = slice(0, height), slice(0, width)
        part = inputs.part(rows, columns)
        self.pictures = {name: p.astype(np.float16) for name, p in part.pictures.items()}
        weights = np.zeros((CANDIDATES, height, width), np.float32)
        weights[0] = 1
        yield (rows, columns), weights


def variants_of(name: str, seed: int) -> list[tuple[Variant, Look]]:
    """Return how a scene is played and delivered; looks are drawn by its name and a seed."""
    rng = np.random.default_rng((seed, zlib.crc32(name.encode())))
    plain = [Variant(phase) for phase in range(FACTOR)]
    fast = [Variant(phase, speed=2) for phase in (1, 4)]
    looks = [(Variant(phase), draw_look(rng, can_halve=False)) for phase in (0, 2)]
    return [*((variant, PLAIN) for variant in (*plain, *fast)), *looks]


class SampleBatch(NamedTuple):
    """A batch as the network takes it, then the truth; float32 [N, channels, S, S]."""

    colour: Tensor
    masks: Tensor
    depth: Tensor
    agreement: Tensor
    time: Tensor  # float32 [N]
    truth: Tensor  # As displayed


class Samples(CachedArrays):
    """The slots of some folders, of which patches are read as they are needed."""

    prefix = "lookahead-"
    names = SampleBatch._fields

    @staticmethod
    def token(settings: LookAheadSettings) -> dict[str, object]:
        """Return the version and the setting that decide what is cached."""
        return {"version": VERSION, "seed": settings.seed}

    @staticmethod
    def prepare(scene: RenderedScene, settings: LookAheadSettings) -> dict[str, np.ndarray]:
        """Make the samples of a scene: what a network is given at the slots of all variants.

        The inputs and ``truth`` [N, 3, H, W], as displayed, float16; ``time`` [N] float32.
        """
        clip, samples = SceneClip(scene), []
        for variant, look in variants_of(scene.name, settings.seed):
            clip = clip.seen_as(variant, look)
            for k in clip.intervals:
                interval = clip.interval(k, "key")
                assert interval.following is not None
                frames = interval.key.image.pixels, interval.following.image.pixels
                for slot in range(1, FACTOR):
                    recorder = _Recorder()
                    seen = replace(interval, interpolator=recorder)
                    seen.look_ahead(slot, weighs=True).make(*frames)
                    truth = np.ascontiguousarray(clip.truth(k, slot).pixels[..., :3], np.float32)
                    shown = linear_to_srgb(truth).transpose(2, 0, 1)
                    recorder.pictures["truth"] = shown.astype(np.float16)
                    recorder.pictures["time"] = np.array(interval.time(slot), np.float32)
                    samples.append(recorder.pictures)
                    check_stop()
        return {name: np.stack([sample[name] for sample in samples]) for name in samples[0]}

    def batch(
        self, indices: Sequence[int], side: int = 0, rng: np.random.Generator | None = None
    ) -> SampleBatch:
        """Return slots as they are cached, or a patch of `side` pixels of each, varied by `rng`."""
        patches: list[dict[str, np.ndarray]] = []
        for index in indices:
            f, i = self._places[index]
            if rng is None:
                patches.append({name: array[i] for name, array in self._files[f].items()})
            else:
                patches.append(self._draw_patch(index, side, rng))
        stacks = (np.stack([patch[name] for patch in patches]) for name in self.names)
        return SampleBatch(*(torch.from_numpy(np.ascontiguousarray(s, np.float32)) for s in stacks))

    def _draw_patch(self, index: int, side: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Cut a patch; turn, flip, play it backwards, re-expose and recolour it, or hide depth."""
        f, i = self._places[index]
        files = self._files[f]
        height, width = files["truth"].shape[-2:]
        count = TRIED if rng.random() < HARDER else 1
        corners = [
            tuple(
                int(rng.integers(-OVERHANG, room - side + OVERHANG + 1).clip(0, room - side))
                for room in (height, width)
            )
            for _ in range(count)
        ]
        errors = []
        for corner in corners:
            rows, columns = (slice(first, first + side, 4) for first in corner)
            softsplat = files["colour"][i, :3, rows, columns].astype(np.float32)
            errors.append(float(np.abs(softsplat - files["truth"][i, :, rows, columns]).mean()))
        y, x = corners[int(np.argmax(errors))]
        pictures = {
            name: files[name][i, :, y : y + side, x : x + side].astype(np.float32)
            for name in files
            if name != "time"
        }
        order, gain = rng.permutation(3), np.float32(np.exp(rng.uniform(*BRIGHTNESS)))
        for name in ("colour", "truth"):
            layers = pictures[name].reshape(-1, 3, side, side)
            pictures[name] = layers[:, order].reshape(-1, side, side) * gain
        pictures["depth"] = pictures["depth"] + np.float32(rng.uniform(-DEPTH_SHIFT, DEPTH_SHIFT))
        if rng.random() < NO_DEPTH:
            pictures["depth"] = np.full_like(pictures["depth"], pictures["depth"].max())
        for axis in (-1, -2):
            if rng.random() < 0.5:
                pictures = {n: np.flip(p, axis) for n, p in pictures.items()}
        if rng.random() < 0.5:
            pictures = {n: p.swapaxes(-1, -2) for n, p in pictures.items()}
        time = np.float32(files["time"][i])
        if rng.random() < 0.5:
            for name, channels in SWAPPED.items():
                pictures[name] = pictures[name][list(channels)]
            time = np.float32(1) - time
        return pictures | {"time": np.array(time)}


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
    """Maps the inputs of `LOOKAHEAD_INTERFACE` to weights; `width` at half resolution."""

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
        mixed, sides = colour[:, :3], colour[:, 3:]
        apart = CONTRAST * (sides - mixed.repeat(1, SIDES, 1, 1))
        before, after, lit_before, lit_after = (sides[:, i : i + 3] for i in range(0, 12, 3))
        between = [
            CONTRAST * (a - b).abs().mean(1, keepdim=True)
            for a, b in ((before, after), (lit_before, lit_after))
        ]
        padded = functional.pad(depth, (1, 1, 1, 1), mode="replicate")
        furthest = functional.max_pool2d(padded, 3, 1)
        nearest = -functional.max_pool2d(-padded, 3, 1)
        relative = (depth[:, :1] - depth[:, 1:]).clamp(-MOST_DEPTH, MOST_DEPTH)
        jump = (furthest - nearest).clamp(max=MOST_DEPTH).amax(1, keepdim=True)
        above = (depth - nearest).clamp(max=MOST_DEPTH).amax(1, keepdim=True)
        when = torch.zeros_like(relative) + time.reshape(-1, 1, 1, 1)
        seen = [mixed, apart, *between, masks, relative, jump, above, agreement, when]
        planes = torch.cat(seen, 1)
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
    samples = Samples
    weight_decay = 1e-5
    largest_gradient = 0.5
    high = 0.3
    least_rate = 0.005
    network_class, network_options = WeighingNetwork, ("width",)
    shipped = ShippedNetwork
    model, interface = MODEL, LOOKAHEAD_INTERFACE
    about = "look-ahead network, {0.width} channels"
    startable = "one of {0.width} channels; give its --width"
    # The scores of held-out slots: dB over `softsplat`, and how far the mean gradient is from the
    # truth's.
    columns = ("step", "seconds", "loss", "rate", "gain_db", "sharpness_percent")
    scores_text = "{:+.2f} dB over softsplat, gradients {:+.1f} % of the truth's"

    def _loss(self, batch: SampleBatch) -> Tensor:
        colour = mix(self.network(*batch[:-1]), batch.colour)
        return loss_of(colour, batch.truth)

    @torch.no_grad()
    def _validate(self, samples: Samples) -> tuple[float, ...]:
        """Return the gain over `softsplat` in dB, and per cent of sharpness, of held-out slots."""
        self.average.eval()
        scores = []
        for index in samples.spread(VALIDATED):
            sample = to_device(samples.batch([index]), self.device)
            height, width = sample.truth.shape[-2:]
            padding = (0, -width % STRIDE, 0, -height % STRIDE)
            *pictures, time = sample[:-1]
            pictures = [functional.pad(picture, padding, mode="replicate") for picture in pictures]
            colour = mix(self.average(*pictures, time), pictures[0])
            colour = colour[..., :height, :width].clamp(0, 1)
            truth, plain = sample.truth.clamp(0, 1), sample.colour[:, :3].clamp(0, 1)
            gain = 10 / math.log(10) * (_log_error(plain, truth) - _log_error(colour, truth))
            own, true = (
                sum(g.abs().mean() for g in _gradients(p.mean(1))) for p in (colour, truth)
            )
            scores.append((float(gain), 100 * (float(own) / max(float(true), 1e-6) - 1)))
        return tuple(np.mean(scores, axis=0).tolist())
