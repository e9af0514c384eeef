"""Larger networks that begin as what a smaller one has learnt (Net2Net, Chen et al. 2016)."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from exwarp_cli.training.networks import Gated


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
