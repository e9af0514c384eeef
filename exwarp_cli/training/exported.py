"""Going on with a network that was exported, as the one that comes with ExWarp.

Exported models have the normalisation of each layer folded into its convolution. It is taken out
again: each layer then normalises by the statistics that some batches have there, and undoes that by
its own scale and offset, so that the network answers as before.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from exwarp_cli.errors import DamagedFileError
from exwarp_cli.training.checkpoint import read_file
from exwarp_cli.training.crops import Batch
from exwarp_cli.training.networks import ExtrapolationNetwork, Gated

FOLDED = ".both.weight_bias"
"""End of the name of the offset that a folded normalisation leaves."""


def load_exported(path: Path, network: ExtrapolationNetwork) -> None:
    """Take the weights of a model that `export_extrapolator` wrote.

    Parameters
    ----------
    path
        The ONNX file.
    network
        Of the same architecture and width; in evaluation it answers as the model does.

    Raises
    ------
    KeyError, ValueError
        When the model has other layers.
    InputError
        When the file cannot be read, or is no model.
    """
    data = read_file(path)
    try:
        model = onnx.load_from_string(data)
    except Exception as error:  # what is no model ends in exceptions of every kind
        raise DamagedFileError(f"{path} is no ONNX model; choose another --start") from error
    kept = {
        tensor.name: torch.from_numpy(numpy_helper.to_array(tensor).copy())
        for tensor in model.graph.initializer
    }
    wanted = network.state_dict()
    for name, layer in network.named_modules():
        if isinstance(layer, Gated):
            offset = kept[f"{name}{FOLDED}"]
            ones, zeros = torch.ones_like(offset), torch.zeros_like(offset)
            wanted |= {
                f"{name}.both.weight": kept[f"{name}.both.weight"],
                f"{name}.norm.weight": ones,
                f"{name}.norm.bias": offset,
                f"{name}.norm.running_mean": zeros,
                f"{name}.norm.running_var": ones - layer.norm.eps,
            }
        elif isinstance(layer, nn.Conv2d) and layer.bias is not None:
            wanted |= {f"{name}.{part}": kept[f"{name}.{part}"] for part in ("weight", "bias")}
    try:
        network.load_state_dict(wanted)
    except RuntimeError as error:
        raise ValueError(str(error)) from error


def normalise_by(network: ExtrapolationNetwork, batches: Iterable[Batch]) -> None:
    """Have a network of `load_exported` normalise by what some batches hold, and answer the same.

    Without this the first step of training would be by another network: in training layers
    normalise by their batch.
    """
    norms = [layer for layer in network.modules() if isinstance(layer, nn.BatchNorm2d)]
    found: dict[nn.BatchNorm2d, list[tuple[Tensor, Tensor]]] = {norm: [] for norm in norms}

    def note(norm: nn.Module, given: tuple[Tensor, ...]) -> None:
        assert isinstance(norm, nn.BatchNorm2d)
        values = given[0].float()
        found[norm].append((values.mean((0, 2, 3)), values.square().mean((0, 2, 3))))

    hooks = [norm.register_forward_pre_hook(note) for norm in norms]
    network.eval()
    with torch.no_grad():
        for batch in batches:
            network(*batch.inputs)
        for norm in norms:
            means, squares = (torch.stack(part).mean(0) for part in zip(*found[norm], strict=True))
            variance = squares - means.square()
            assert norm.running_mean is not None and norm.running_var is not None
            norm.running_mean.copy_(means)
            norm.running_var.copy_(variance)
            norm.bias.add_(means)
            norm.weight.copy_((variance + norm.eps).sqrt())
    for hook in hooks:
        hook.remove()
