"""Checkpoints with the names and shapes of ExtraNet's public one, and values of our own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

NAMES = Path(__file__).parents[2] / "data" / "extranet-state-dict.txt"
"""A line for each tensor: its name, then its shape."""


def shapes() -> dict[str, tuple[int, ...]]:
    lines = [line.split() for line in NAMES.read_text().splitlines()]
    return {name: tuple(map(int, sizes)) for name, *sizes in lines}


def state(seed: int = 1) -> dict[str, torch.Tensor]:
    """Seeded values that keep a signal's size through the layers."""
    rng = np.random.default_rng(seed)
    return {name: torch.from_numpy(_values(rng, name, shape)) for name, shape in shapes().items()}


def save(path: Path, content: object) -> Path:
    torch.save(content, path)
    return path


def checkpoint(path: Path, tensors: dict[str, torch.Tensor] | None = None) -> Path:
    """Write a checkpoint as training writes them."""
    optimizer = {"state": {0: {"step": 1}}, "param_groups": [{"lr": 1e-4, "params": [0]}]}
    content = {"epoch": 3, "state_dict": tensors or state(), "optimizer": optimizer}
    return save(path, content)


def _values(rng: np.random.Generator, name: str, shape: tuple[int, ...]) -> np.ndarray:
    if name.endswith("num_batches_tracked"):
        return np.array(5)
    if name.endswith("running_var"):
        return rng.uniform(0.5, 2, shape).astype(np.float32)
    if len(shape) == 4:
        fan = shape[1] * shape[2] * shape[3]
        return (rng.standard_normal(shape) * np.sqrt(2 / fan)).astype(np.float32)
    if name.endswith("weight"):
        return rng.uniform(0.5, 1.5, shape).astype(np.float32)
    return (0.1 * rng.standard_normal(shape)).astype(np.float32)
