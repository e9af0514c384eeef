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

from exwarp_cli.domain.network_api import EXTRAPOLATOR_INPUTS

STRIDE = 16
"""Height and width have to be multiples of it."""

GIVEN = sum(EXTRAPOLATOR_INPUTS.values()) + 1
"""Channels that the network sees at each pixel: all picture inputs, and the time."""

LEAK = 0.1
"""Slope of the activation below zero."""

SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))
"""Ways that holes look, as columns and rows that what is visible there is moved by."""

LEAST_SEEN = 1e-4
"""Visible share of a window that is divided by at the least; one pixel in a large one is more."""

CERTAIN = 3.0
"""How far the filled warp's weight lies above the others', as a logit, before any training."""


@dataclass(frozen=True)
class Architecture:
    """What a network is made of.

    Attributes
    ----------
    width
        Channels at half resolution.
    growth
        How many times as many there are after each of the next three halvings.
    taps
        Radius of the kernels over F_k, F_k-1, F_k-2: 0 for the pixel alone, 1 for 3x3.
    blurs
        Sizes of the box blurs of the filled warp that are candidates too.
    candidates
        Whether candidates are weighed at all.
    continued
        Whether the change in shading since F_k-1, continued, is a candidate.
    flow
        Number of candidates that are the filled warp, sampled where the network says.
    residual
        Whether the network adds colour of its own.
    patched
        Whether it does so in holes, beside weighing candidates.
    reach
        How far, in pixels, a hole looks left, right, up and down for what is visible: these four
        colours and their distances are inputs too, and the colours candidates. 0 for not at all.
    detail
        Channels of a last layer at full resolution that sees the inputs again; 0 for none.
    light
        Size of a window in pixels, odd. What is visible differs from the filled warp by the mean
        difference over the window, so that the detail is the warp's. 0 for any difference.
    """

    width: int = 32
    growth: tuple[float, float, float] = (1.5, 2, 2)
    taps: tuple[int, int, int] = (0, 0, 0)
    blurs: tuple[int, ...] = (3, 5, 9)
    candidates: bool = True
    continued: bool = True
    flow: int = 0
    residual: bool = False
    patched: bool = False
    reach: int = 0
    detail: int = 0
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


class Gated(nn.Module):
    """A convolution and a single-channel gate on it, as in ExtraNet, in one convolution.

    Both are normalised over the batch, as ExtraNet's are: without it single batches with bright
    pixels shut gates for good. Exported models have it folded into the convolution.
    """

    def __init__(self, given: int, made: int, stride: int = 1) -> None:
        super().__init__()
        self.both = nn.Conv2d(given, made + 1, 3, stride, padding=1, bias=False)
        self.norm = nn.BatchNorm2d(made + 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return float [N, made, H / stride, W / stride]."""
        both = self.norm(self.both(x))
        # Split, not sliced: the gradient of a slice is a whole tensor of zeros.
        made, gate = torch.split(both, [both.shape[1] - 1, 1], 1)
        return functional.leaky_relu(made, LEAK) * torch.sigmoid(gate)


class UNet(nn.Module):
    """Half resolution down to a sixteenth and back; [N, given, H, W] to [N, made, H, W].

    Parameters
    ----------
    given, made, width
        Channels that come in, that go out, and at half resolution.
    growth
        How many times as many there are after each of the next three halvings.
    layer
        Makes a convolution from its channels in and out, and its stride if that is not 1.
    """

    def __init__(
        self,
        given: int,
        made: int,
        width: int,
        growth: tuple[float, float, float],
        layer: Callable[..., nn.Module] = Gated,
    ) -> None:
        super().__init__()
        sizes = [width, *(int(width * times) for times in growth)]
        self.fold = nn.PixelUnshuffle(2)
        self.stem = layer(4 * given, width)
        self.first = layer(width, width)
        self.down = nn.ModuleList(
            nn.Sequential(layer(a, b, 2), layer(b, b)) for a, b in pairwise(sizes)
        )
        self.up = nn.ModuleList(
            layer(a + b, b) for a, b in zip(sizes[:0:-1], sizes[-2::-1], strict=True)
        )
        self.last = nn.Conv2d(width, 4 * made, 3, padding=1)
        self.unfold = nn.PixelShuffle(2)

    def forward(self, x: Tensor) -> Tensor:
        """Return the answer for every pixel; height and width are multiples of STRIDE."""
        x = self.first(self.stem(self.fold(x)))
        kept = []
        for down in self.down:
            kept.append(x)
            x = down(x)
        for up in self.up:
            x = functional.interpolate(x, scale_factor=2.0, mode="nearest")
            x = up(torch.cat([x, kept.pop()], 1))
        answer: Tensor = self.unfold(self.last(x))
        return answer


class ExtrapolationNetwork(nn.Module):
    """The network as it is exported: the inputs of `domain.extrapolator`, colour out."""

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = architecture
        count = self._count()
        given = GIVEN + (4 * len(SIDES) if architecture.reach else 0)
        made = count + 2 * architecture.flow
        made += 3 * (architecture.residual or architecture.patched)
        self.net = UNet(given, architecture.detail or made, architecture.width, architecture.growth)
        self.detail: nn.Sequential | None = None
        if architecture.detail:
            size = architecture.detail
            self.detail = nn.Sequential(
                Gated(size + GIVEN, size), nn.Conv2d(size, made, 3, padding=1)
            )
        last = self.net.last if self.detail is None else self.detail[1]
        # Let the last layer answer with hardly more than the filled warp before any training.
        assert isinstance(last, nn.Conv2d) and last.bias is not None
        with torch.no_grad():
            last.weight.mul_(0.03)
            last.bias.zero_()
            if count > 0:
                last.bias.view(made, -1)[0] = CERTAIN

    def forward(
        self, warped: Tensor, mask: Tensor, features: Tensor, history: Tensor, time: Tensor
    ) -> Tensor:
        """Return colour [N, 3, H, W], encoded as the inputs are."""
        filled = warped[:, 3:]
        when = time.reshape(-1, 1, 1, 1)
        plane = torch.zeros_like(mask) + when
        given = torch.cat([warped, mask, features, history, plane], 1)
        sides = self._sides(filled, mask)
        answer = self.net(torch.cat([given, *sides], 1))
        if self.detail is not None:
            answer = self.detail(torch.cat([answer, given], 1))
        if not self.architecture.candidates:
            return torch.add(filled, answer)
        own = answer.shape[1] - self._count() - 2 * self.architecture.flow
        logits, flow, colour = torch.split(
            answer, [self._count(), 2 * self.architecture.flow, own], 1
        )
        weights = torch.split(torch.softmax(logits.float(), 1), 1, 1)
        out = torch.zeros_like(filled)
        candidates = self._candidates(filled, history, when, flow.float(), sides)
        for weight, candidate in zip(weights, candidates, strict=True):
            out = out + weight * candidate
        if self.architecture.patched:
            out = out + (1 - mask) * colour
        elif self.architecture.residual:
            out = out + colour
        return self._detailed(filled, mask, out) if self.architecture.light else out

    def _detailed(self, filled: Tensor, mask: Tensor, answer: Tensor) -> Tensor:
        """Return the answer in holes; elsewhere the filled warp with the light of the answer.

        Renders that networks learn from have noise, and a mean of candidates is the best guess of
        what has noise: without this, clean frames came out 14 % softer than the truth.
        """
        change = torch.cat([mask * (answer - filled), mask], 1)
        change, seen = torch.split(_mean_around(change, self.architecture.light), [3, 1], 1)
        lit = filled + change / seen.clamp_min(LEAST_SEEN)
        return torch.where(mask > 0, lit, answer)

    def _count(self) -> int:
        """Return how many candidates are weighed."""
        a = self.architecture
        if not a.candidates:
            return 0
        taps = sum((2 * r + 1) ** 2 for r in a.taps)
        return 1 + taps + len(a.blurs) + a.continued + a.flow + (len(SIDES) if a.reach else 0)

    def _sides(self, filled: Tensor, mask: Tensor) -> list[Tensor]:
        reach = self.architecture.reach
        return [_first_seen(filled, mask, side, reach) for side in SIDES] if reach else []

    def _candidates(
        self, filled: Tensor, history: Tensor, when: Tensor, flow: Tensor, sides: list[Tensor]
    ) -> list[Tensor]:
        a = self.architecture
        out = [filled]
        for index, radius in enumerate(a.taps):
            frame, seen = history[:, 4 * index : 4 * index + 3], history[:, 4 * index + 3 :][:, :1]
            # What a frame does not show would be black: the filled warp stands in.
            there = (seen > 0) | (frame != 0).any(1, keepdim=True)
            frame = torch.where(there, frame, filled)
            out += _neighbours(frame, radius)
        out += [_box(filled, size) for size in a.blurs]
        if a.continued:
            both = history[:, 3:4] * history[:, 7:8]
            out.append(filled + when * both * (filled - history[:, 4:7]))
        for index in range(a.flow):
            out.append(_moved(filled, flow[:, 2 * index : 2 * index + 2]))
        return out + [side[:, :3] for side in sides]


def _neighbours(frame: Tensor, radius: int) -> list[Tensor]:
    """Return the frame shifted to every place of a (2 radius + 1) squared window."""
    if radius == 0:
        return [frame]
    height, width = frame.shape[2:]
    padded = functional.pad(frame, (radius,) * 4, mode="replicate")
    side = range(2 * radius + 1)
    return [padded[:, :, y : y + height, x : x + width] for y in side for x in side]


def _first_seen(frame: Tensor, mask: Tensor, side: tuple[int, int], reach: int) -> Tensor:
    """Return each pixel's nearest visible colour on a side, and how far that is.

    Parameters
    ----------
    frame, mask
        [N, 3, H, W] and [N, 1, H, W]; 0 in the mask is not visible.
    side
        One of SIDES.
    reach
        Where nothing is visible so far, pixels, it is the frame's own colour at the distance 1.

    Returns
    -------
    Tensor
        [N, 4, H, W]: colour, and the distance as a share of the reach.
    """
    found = torch.cat([frame, torch.zeros_like(mask)], 1)
    seen, step = mask, 1
    while step <= reach:  # each time as far again
        x, y = side[0] * step, side[1] * step
        beside = _shifted(found, x, y)
        beside = beside + beside.new_tensor([0, 0, 0, step / reach]).reshape(1, 4, 1, 1)
        beside_seen = _shifted(seen, x, y)
        found = torch.where((seen == 0) & (beside_seen > 0), beside, found)
        seen, step = torch.maximum(seen, beside_seen), 2 * step
    colour = torch.where(seen > 0, found[:, :3], frame)
    return torch.cat([colour, torch.where(seen > 0, found[:, 3:], torch.ones_like(seen))], 1)


def _shifted(x: Tensor, right: int, down: int) -> Tensor:
    """Return [N, C, H, W] moved by whole pixels, with zeros where nothing comes from."""
    height, width = x.shape[2:]
    x = functional.pad(x, (max(right, 0), max(-right, 0), max(down, 0), max(-down, 0)))
    top, left = max(-down, 0), max(-right, 0)
    return x[:, :, top : top + height, left : left + width]


def _box(frame: Tensor, size: int) -> Tensor:
    padded = functional.pad(frame, (size // 2,) * 4, mode="replicate")
    return functional.avg_pool2d(padded, size, 1)


def _mean_around(planes: Tensor, size: int) -> Tensor:
    """Return the mean over a window, as `_box` does; along rows, then columns, for large ones."""
    padded = functional.pad(planes, (size // 2,) * 4, mode="replicate")
    return functional.avg_pool2d(functional.avg_pool2d(padded, (1, size), 1), (size, 1), 1)


def _moved(frame: Tensor, flow: Tensor) -> Tensor:
    """Sample a frame at each pixel plus a flow of pixels [N, 2, H, W], x and y."""
    height, width = frame.shape[2:]
    rows = torch.arange(height, dtype=flow.dtype, device=flow.device)
    columns = torch.arange(width, dtype=flow.dtype, device=flow.device)
    x = (columns + flow[:, 0]) * (2 / (width - 1)) - 1
    y = (rows[:, None] + flow[:, 1]) * (2 / (height - 1)) - 1
    grid = torch.stack([x, y], -1)
    return functional.grid_sample(
        frame, grid, mode="bilinear", padding_mode="border", align_corners=True
    )


def build(name: str, width: int | None = None) -> ExtrapolationNetwork:
    """Build a network by the name of its architecture, with another width if given."""
    architecture = ARCHITECTURES[name]
    if width is not None:
        architecture = replace(architecture, width=width)
    return ExtrapolationNetwork(architecture)
