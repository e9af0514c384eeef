"""What extrapolation networks are trained to make small (ExtraNet, section 4.4)."""

from __future__ import annotations

import torch
from torch import Tensor

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
