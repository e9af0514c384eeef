"""The checkpoint of ExtraNet's release."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path

import torch
from torch import Tensor

from exwarp_cli.errors import (
    DamagedFileError,
    InputError,
    LayoutError,
    OutputExistsError,
    UsageError,
)
from exwarp_cli.io.files import make_folder
from exwarp_cli.io.model_files import read_whole
from exwarp_cli.training.export import export_extrapolator
from exwarp_cli.training.extranet import STRIDE, ExtraNet, ExtraNetAdapter

WRAPPED = "module."
"""Before every name where the network was trained on several devices."""


def import_extranet(checkpoint: Path, model: Path, *, overwrite: bool) -> None:
    """Turn a checkpoint into a model for ``exwarp upsample --extrapolator``.

    Parameters
    ----------
    checkpoint
        Of the release, see :func:`read_extranet`.
    model
        The ONNX file to write; its folder is made where there is none.
    overwrite
        Whether it may exist.

    Raises
    ------
    InputError
        When the checkpoint cannot be used.
    OutputExistsError, OutputError
        When the model is there, or cannot be written.
    """
    if model.exists():
        if not overwrite:
            raise OutputExistsError(f"{model} exists; choose another name, or add --overwrite")
        if checkpoint.exists() and model.samefile(checkpoint):
            raise UsageError(f"{model} is the checkpoint itself; choose another name for the model")
    network = read_extranet(checkpoint)
    make_folder(model.parent)
    about = f"ExtraNet (Guo et al. 2021), imported from {checkpoint.name}"
    export_extrapolator(ExtraNetAdapter(network), model, stride=STRIDE, about=about)


def read_extranet(path: Path) -> ExtraNet:
    """Read a network from a checkpoint: a dict with ``state_dict``, or that alone.

    Only tensors are read, nothing that could run code.

    Raises
    ------
    InputError
        When there is no such file, or it cannot be opened.
    DamagedFileError
        When it is no checkpoint, or damaged.
    LayoutError
        When its tensors are not those of ExtraNet.
    """
    damaged = DamagedFileError(
        f"{path} is damaged, is no PyTorch checkpoint, or holds more than tensors, which is "
        "not read because it could run code; give the file of ExtraNet's release"
    )
    network = ExtraNet()
    tensors = _tensors(path, read_tensors(path, "cpu", damaged))
    _check(path, tensors, network.state_dict())
    network.load_state_dict(tensors)
    return network.eval()


def _tensors(path: Path, content: object) -> dict[str, Tensor]:
    """Return the state dict by plain names."""
    state = content.get("state_dict", content) if isinstance(content, dict) else None
    if not isinstance(state, dict):
        raise LayoutError(f"{path} holds no state dict; give the file of ExtraNet's release")
    return {
        str(name).removeprefix(WRAPPED): tensor
        for name, tensor in state.items()
        if isinstance(tensor, Tensor)
    }


def _check(path: Path, given: dict[str, Tensor], wanted: dict[str, Tensor]) -> None:
    """Refuse what does not fit, naming the first tensor and how many more there are."""
    shared = [name for name in wanted if name in given]
    faults = (
        ("lacks", [name for name in wanted if name not in given]),
        ("has a tensor that ExtraNet has not:", [name for name in given if name not in wanted]),
        ("has another shape of", [n for n in shared if given[n].shape != wanted[n].shape]),
        ("has values that are not finite in", [n for n in shared if not _is_finite(given[n])]),
    )
    for what, names in faults:
        if names:
            more = f" and {len(names) - 1} more" if names[1:] else ""
            raise LayoutError(
                f"{path} {what} {names[0]}{more}; give the file of ExtraNet's release"
            )


def _is_finite(tensor: Tensor) -> bool:
    return bool(torch.isfinite(tensor).all())


def read_file(path: Path) -> bytes:
    """Read a file on a disk; raises InputError where that fails."""
    try:
        return read_whole(path)
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror or error}; check the path and its rights"
        ) from error


def read_tensors(path: Path, device: str, damaged: DamagedFileError) -> object:
    """Read what a file holds: only tensors and plain values, nothing that could run code.

    Parameters
    ----------
    path
        As torch.save wrote it.
    device
        Where the tensors go.
    damaged
        What is raised for a file that holds anything else, or nothing that can be read.

    Raises
    ------
    InputError
        When there is no such file, or it cannot be opened.
    DamagedFileError
        As given.
    """
    data = read_file(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # old checkpoints warn of torch's own past
            content: object = torch.load(BytesIO(data), map_location=device, weights_only=True)
    except Exception as error:  # damaged pickles and archives end in exceptions of every kind
        raise damaged from error
    return content
