"""Files of tensors as PyTorch writes them."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path

import torch

from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.model_files import read_whole


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
    try:
        data = read_whole(path)
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror or error}; check the path and its rights"
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # old checkpoints warn of torch's own past
            content: object = torch.load(BytesIO(data), map_location=device, weights_only=True)
    except Exception as error:  # damaged pickles and archives end in exceptions of every kind
        raise damaged from error
    return content
