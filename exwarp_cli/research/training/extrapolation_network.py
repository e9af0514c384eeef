"""Extrapolation networks: a gated U-Net at half resolution, and what is made of its answer.

ExtraNet (Guo et al., SIGGRAPH Asia 2021) predicts a residual on the warp with gated convolutions
at full resolution. Here pixels are first folded two by two into channels, so that the same work
costs a quarter, and the answer may be weights for candidate colours instead of colour: they come
from rendered frames, which keeps them right on scenes never seen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from exwarp_cli.domain.network_api import EXTRAPOLATOR_INTERFACE

# Height and width have to be multiples of it.
STRIDE = 16

# Channels that the network sees at each pixel: all picture inputs, and the time.
INPUT_PLANES = sum(EXTRAPOLATOR_INTERFACE.inputs.values()) + 1

# Slope of the activation below zero.
LEAK = 0.1

# Directions in which holes search, as columns and rows that what is visible there is moved by.
SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))

# Visible share of a window that is divided by at the least; one pixel in a large one is more.
LEAST_VISIBLE = 1e-4

# How far the filled warp's weight lies above the others', as a logit, before any training.
CERTAIN = 3.0


@dataclass(frozen=True)
class Architecture:
    """What a network is made of."""

    width: int = 32  # Channels at half resolution
    # How many times as many there are after each of the next three halvings.
    growth: tuple[float, float, float] = (1.5, 2, 2)
    # Radius of the kernels over F_k, F_k-1, F_k-2: 0 for the pixel alone, 1 for 3x3.
    taps: tuple[int, int, int] = (0, 0, 0)
    # Sizes of the box blurs of the filled warp that are candidates too.
    blurs: tuple[int, ...] = (3, 5, 9)
    candidates: bool = True  # Whether candidates are weighed at all
    flow: int = 0  # Number of candidates that are the filled warp, sampled where the network says.
    residual: bool = False  # Whether the network adds colour of its own.
    patched: bool = False  # Whether it does so in holes, beside weighing candidates.
    # How far, in pixels, a hole looks left, right, up and down for what is visible: these four
    # colours and their distances are inputs too, and the colours candidates. 0 for not at all.
    reach: int = 0
    # Channels of a last layer at full resolution that sees the inputs again; 0 for none.
    detail: int = 0
    # Size of a window in pixels, odd. What is visible differs from the filled warp by the mean
    # difference over the window, so that the detail is the warp's. 0 for any difference.
    light: int = 0


ARCHITECTURES: Mapping[str, Architecture] = {
    "residual": Architecture(candidates=False, residual=True),
    "blend": Architecture(),
    "kernels": Architecture(taps=(1, 1, 0)),
    "kernels-residual": Architecture(taps=(1, 1, 0), residual=True),
    "kernels-flow": Architecture(taps=(1, 1, 0), flow=2),
    "kernels-detail": Architecture(taps=(1, 1, 0), detail=16),
    "blend-detail": Architecture(detail=16),
    "blend-patched": Architecture(detail=16, patched=True),
    "kernels-patched": Architecture(taps=(1, 1, 0), detail=16, patched=True),
    "kernels-sided": Architecture(taps=(1, 1, 0), detail=16, patched=True, reach=63),
    "kernels-deep": Architecture(taps=(1, 1, 0), detail=16, patched=True, growth=(2, 3, 4)),
    "kernels-light": Architecture(
        taps=(1, 1, 0), detail=16, patched=True, growth=(2, 3, 4), light=31
    ),
}


class GatedConvolution(nn.Module):
    """A convolution and a single-channel gate on it, as in ExtraNet, in one convolution."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.both = nn.Conv2d(inputs, outputs + 1, 3, stride, padding=1, bias=False)
        # Without it single batches with bright pixels shut gates for good. Exported models have it
        # folded into the convolution.
        self.norm = nn.BatchNorm2d(outputs + 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return float [N, outputs, H / stride, W / stride]."""
        both = self.norm(self.both(x))
        # Split, not sliced: the gradient of a slice is a whole tensor of zeros.
        features, gate = torch.split(both, [both.shape[1] - 1, 1], 1)
        return functional.leaky_relu(features, LEAK) * torch.sigmoid(gate)


class UNet(nn.Module):
    """Half resolution down to a sixteenth and back; [N, inputs, H, W] to [N, outputs, H, W].

    There are `width` channels at half resolution, and `growth` times as many after each of the next
    three halvings. `layer` makes a convolution of channels in and out, and a stride.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        width: int,
        growth: tuple[float, float, float],
        layer: Callable[..., nn.Module] = GatedConvolution,
    ) -> None:
        super().__init__()
        sizes = [width, *(int(width * times) for times in growth)]
        self.fold = nn.PixelUnshuffle(2)
        self.stem = layer(4 * inputs, width)
        self.first = layer(width, width)
        self.down = nn.ModuleList(
            nn.Sequential(layer(a, b, 2), layer(b, b)) for a, b in pairwise(sizes)
        )
        self.up = nn.ModuleList(
            layer(a + b, b) for a, b in zip(sizes[:0:-1], sizes[-2::-1], strict=True)
        )
        self.last = nn.Conv2d(width, 4 * outputs, 3, padding=1)
        self.unfold = nn.PixelShuffle(2)

    def forward(self, x: Tensor) -> Tensor:
        """Return the answer for every pixel; height and width are multiples of STRIDE."""
        x = self.first(self.stem(self.fold(x)))
        skipped = []
        for down in self.down:
            skipped.append(x)
            x = down(x)
        for up in self.up:
            x = functional.interpolate(x, scale_factor=2.0, mode="nearest")
            x = up(torch.cat([x, skipped.pop()], 1))
        answer: Tensor = self.unfold(self.last(x))
        return answer


class ExtrapolationNetwork(nn.Module):
    """The network as it is exported: the inputs of `domain.network_api`, colour out."""

    def __init__(self, name: str, width: int | None = None) -> None:
        """Build the network of an architecture, with another width if given."""
        super().__init__()
        a = ARCHITECTURES[name]
        if width is not None:
            a = replace(a, width=width)
        self.architecture = a
        taps = sum((2 * radius + 1) ** 2 for radius in a.taps)
        sides = len(SIDES) if a.reach else 0
        self.candidate_count = 0
        if a.candidates:
            self.candidate_count = 1 + taps + len(a.blurs) + a.flow + 1 + sides
        inputs = INPUT_PLANES + 4 * sides
        outputs = self.candidate_count + 2 * a.flow + 3 * (a.residual or a.patched)
        self.net = UNet(inputs, a.detail or outputs, a.width, a.growth)
        self.detail: nn.Sequential | None = None
        if a.detail:
            self.detail = nn.Sequential(
                GatedConvolution(a.detail + INPUT_PLANES, a.detail),
                nn.Conv2d(a.detail, outputs, 3, padding=1),
            )
        last = self.net.last if self.detail is None else self.detail[1]
        # Let the last layer answer with hardly more than the filled warp before any training.
        assert isinstance(last, nn.Conv2d) and last.bias is not None
        with torch.no_grad():
            last.weight.mul_(0.03)
            last.bias.zero_()
            if self.candidate_count > 0:
                last.bias.view(outputs, -1)[0] = CERTAIN

    def forward(
        self, warped: Tensor, mask: Tensor, features: Tensor, history: Tensor, time: Tensor
    ) -> Tensor:
        """Return colour [N, 3, H, W], encoded as the inputs are."""
        a, filled = self.architecture, warped[:, 3:]
        when = time.reshape(-1, 1, 1, 1)
        plane = torch.zeros_like(mask) + when
        inputs = torch.cat([warped, mask, features, history, plane], 1)
        sides = []
        if a.reach:
            sides = [_first_visible(filled, mask, side, a.reach) for side in SIDES]
        answer = self.net(torch.cat([inputs, *sides], 1))
        if self.detail is not None:
            answer = self.detail(torch.cat([answer, inputs], 1))
        if not a.candidates:
            return torch.add(filled, answer)
        parts = [self.candidate_count, 2 * a.flow]
        logits, flow, colour = torch.split(answer, [*parts, answer.shape[1] - sum(parts)], 1)
        # The softmax over channels; onnxruntime's own transposes every plane for it.
        logits = logits.float()
        powers = torch.exp(logits - logits.amax(1, keepdim=True))
        weights = torch.split(powers / powers.sum(1, keepdim=True), 1, 1)
        out = torch.zeros_like(filled)
        candidates = self._candidates(filled, history, when, flow.float(), sides)
        for weight, candidate in zip(weights, candidates, strict=True):
            out = out + weight * candidate
        if a.patched:
            out = out + (1 - mask) * colour
        elif a.residual:
            out = out + colour
        if not a.light:
            return out
        # Outside of holes the filled warp gets the light of the answer. Renders that networks learn
        # from have noise, and a mean of candidates is the best guess of what has noise: without
        # this, clean frames came out 14 % softer than the truth.
        change = torch.cat([mask * (out - filled), mask], 1)
        # The mean over a window: along rows, then columns, as windows are large.
        change = functional.pad(change, (a.light // 2,) * 4, mode="replicate")
        change = functional.avg_pool2d(
            functional.avg_pool2d(change, (1, a.light), 1), (a.light, 1), 1
        )
        change, visible = torch.split(change, [3, 1], 1)
        lit = filled + change / visible.clamp_min(LEAST_VISIBLE)
        return torch.where(mask > 0, lit, out)

    def _candidates(
        self, filled: Tensor, history: Tensor, when: Tensor, flow: Tensor, sides: list[Tensor]
    ) -> list[Tensor]:
        a = self.architecture
        out = [filled]
        for index, radius in enumerate(a.taps):
            frame = history[:, 4 * index : 4 * index + 3]
            visible = history[:, 4 * index + 3 :][:, :1]
            # What a frame does not show would be black: the filled warp replaces it.
            is_shown = (visible > 0) | (frame != 0).any(1, keepdim=True)
            frame = torch.where(is_shown, frame, filled)
            if radius == 0:
                out.append(frame)
                continue
            # The frame shifted to every place of the window.
            height, width = frame.shape[2:]
            padded = functional.pad(frame, (radius,) * 4, mode="replicate")
            side = range(2 * radius + 1)
            out += [padded[:, :, y : y + height, x : x + width] for y in side for x in side]
        for size in a.blurs:
            padded = functional.pad(filled, (size // 2,) * 4, mode="replicate")
            out.append(functional.avg_pool2d(padded, size, 1))
        # The change in shading since F_k-1, continued.
        both = history[:, 3:4] * history[:, 7:8]
        out.append(filled + when * both * (filled - history[:, 4:7]))
        out += [_sample(filled, flow[:, 2 * i : 2 * i + 2]) for i in range(a.flow)]
        return out + [side[:, :3] for side in sides]


def _first_visible(frame: Tensor, mask: Tensor, side: tuple[int, int], reach: int) -> Tensor:
    """Return each pixel's nearest visible colour on a side, and the distance as a share of `reach`.

    `frame` is [N, 3, H, W], and `mask` [N, 1, H, W], 0 where nothing is visible. Returns
    [N, 4, H, W]: where nothing is visible within `reach` pixels, the frame's own colour and 1.
    """
    nearest = torch.cat([frame, torch.zeros_like(mask)], 1)
    visible, step = mask, 1
    while step <= reach:  # each time as far again
        x, y = side[0] * step, side[1] * step
        shifted = _shift(nearest, x, y)
        shifted = shifted + shifted.new_tensor([0, 0, 0, step / reach]).reshape(1, 4, 1, 1)
        shifted_visible = _shift(visible, x, y)
        nearest = torch.where((visible == 0) & (shifted_visible > 0), shifted, nearest)
        visible, step = torch.maximum(visible, shifted_visible), 2 * step
    colour = torch.where(visible > 0, nearest[:, :3], frame)
    distance = torch.where(visible > 0, nearest[:, 3:], torch.ones_like(visible))
    return torch.cat([colour, distance], 1)


def _shift(x: Tensor, right: int, down: int) -> Tensor:
    """Return [N, C, H, W] moved by whole pixels, with zeros where nothing comes from."""
    height, width = x.shape[2:]
    x = functional.pad(x, (max(right, 0), max(-right, 0), max(down, 0), max(-down, 0)))
    top, left = max(-down, 0), max(-right, 0)
    return x[:, :, top : top + height, left : left + width]


def _sample(frame: Tensor, flow: Tensor) -> Tensor:
    """Sample a frame at each pixel plus a flow of pixels [N, 2, H, W], x and y."""
    height, width = frame.shape[2:]
    rows = torch.arange(height, dtype=flow.dtype, device=flow.device)
    columns = torch.arange(width, dtype=flow.dtype, device=flow.device)
    x = (columns + flow[:, 0]) * (2 / (width - 1)) - 1
    y = (rows[:, None] + flow[:, 1]) * (2 / (height - 1)) - 1
    return functional.grid_sample(
        frame, torch.stack([x, y], -1), mode="bilinear", padding_mode="border", align_corners=True
    )
