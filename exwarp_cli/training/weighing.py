"""The look-ahead network: a U-Net that weighs what both key frames show of each pixel of a slot.

After Briedis and others, "Kernel-Based Frame Interpolation for Spatio-Temporally Adaptive
Rendering", SIGGRAPH 2023, with kernels of one pixel: weights, softmax over candidates, are made
once for all layers.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from exwarp_cli.domain.network_api import CANDIDATES, SIDES
from exwarp_cli.training.networks import LEAK, UNet

DETAIL = 16
"""Channels of the last layer at full resolution."""

GROWTH = (1.5, 2, 3)
"""How many times as many channels there are after each halving."""

SEEN = 28
"""Channels that are made of the inputs for each pixel."""

CONTRAST = 4.0
"""What differences of colour are multiplied by: most are small."""

FURTHER = 4.0
"""Differences of depth, octaves, beyond which all are alike."""

CERTAIN = 2.0
"""Logit of what `softsplat` makes above those of the sides, before any training."""

SHARE = 0.6
"""Of the network's answer in the shipped model. The whole of it gained 0.02 dB less on six scenes
in the mean, and lost 0.07 on one: it is surer than it should be on other scenes than it learnt."""


class Conv(nn.Module):
    """A convolution over 3x3 pixels, normalised; `stride` 2 halves the size."""

    def __init__(self, given: int, made: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(given, made, 3, stride, 1, bias=False)
        # Without it the softmax soon settles on its first candidate for good.
        self.norm = nn.BatchNorm2d(made)

    def forward(self, x: Tensor) -> Tensor:
        """Return [N, made, H, W]."""
        return functional.leaky_relu(self.norm(self.conv(x)), LEAK)


class WeighingNetwork(UNet):
    """Takes the inputs of `domain.lookahead.LOOKS_AHEAD`, and returns the weights.

    Parameters
    ----------
    width
        Channels at half resolution.
    """

    def __init__(self, width: int) -> None:
        super().__init__(SEEN, DETAIL, width, GROWTH, Conv)
        self.detail = Conv(DETAIL + SEEN, DETAIL)
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
        seen = _seen(colour, masks, depth, agreement, time)
        x = self.head(self.detail(torch.cat([super().forward(seen), seen], 1)))
        return torch.softmax(x.float(), 1)


class HeldBack(nn.Module):
    """The network with a share of its weight left to what `softsplat` makes, as it is shipped."""

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


def _seen(colour: Tensor, masks: Tensor, depth: Tensor, agreement: Tensor, time: Tensor) -> Tensor:
    """Return what the network sees of each pixel, [N, SEEN, H, W]."""
    mixed, sides = colour[:, :3], colour[:, 3:]
    apart = CONTRAST * (sides - mixed.repeat(1, SIDES, 1, 1))
    before, after, lit_before, lit_after = (sides[:, i : i + 3] for i in range(0, 12, 3))
    between = [
        CONTRAST * (one - other).abs().mean(1, keepdim=True)
        for one, other in ((before, after), (lit_before, lit_after))
    ]
    framed = functional.pad(depth, (1, 1, 1, 1), mode="replicate")
    furthest, nearest = functional.max_pool2d(framed, 3, 1), -functional.max_pool2d(-framed, 3, 1)
    relative = (depth[:, :1] - depth[:, 1:]).clamp(-FURTHER, FURTHER)
    jump = (furthest - nearest).clamp(max=FURTHER).amax(1, keepdim=True)
    above = (depth - nearest).clamp(max=FURTHER).amax(1, keepdim=True)
    when = torch.zeros_like(relative) + time.reshape(-1, 1, 1, 1)
    return torch.cat([mixed, apart, *between, masks, relative, jump, above, agreement, when], 1)


def mix(weights: Tensor, colour: Tensor) -> Tensor:
    """Return the weighted mean of the candidates of each pixel, [N, 3, H, W].

    Parameters
    ----------
    weights
        [N, CANDIDATES, H, W].
    colour
        [N, 3 (1 + SIDES), H, W], the input of the same name.
    """
    candidates = colour.reshape(colour.shape[0], CANDIDATES, 3, *colour.shape[2:])
    return (weights[:, :, None] * candidates).sum(1)
