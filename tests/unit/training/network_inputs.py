"""Inputs of extrapolation networks as tensors."""

from __future__ import annotations

import torch

from exwarp_cli.domain.network_api import EXTRAPOLATOR_INTERFACE, TIME_INPUT


def example(height: int, width: int, seed: int = 0) -> dict[str, torch.Tensor]:
    rng = torch.Generator().manual_seed(seed)
    pictures = {
        name: torch.rand(1, channels, height, width, generator=rng)
        for name, channels in EXTRAPOLATOR_INTERFACE.inputs.items()
    }
    pictures["mask"] = (pictures["mask"] > 0.2).float()
    return pictures | {TIME_INPUT: torch.tensor([0.5])}
