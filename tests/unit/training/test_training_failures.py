"""Trainings that go wrong, and data that they must not learn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from exwarp_cli.errors import DamagedFileError, InputError, UsageError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.dataset import RenderedScene, open_scene
from exwarp_cli.io.shot import Shot
from exwarp_cli.research.training import extrapolator_training
from exwarp_cli.research.training.crop_cache import Crops, write_arrays
from exwarp_cli.research.training.extrapolator_training import (
    MODEL,
    ExtrapolatorTraining,
)
from exwarp_cli.research.training.resumable_training import CHECKPOINT, SETTINGS
from exwarp_cli.research.training.training_settings import ExtrapolatorSettings
from tests.unit.analytic_scene import write_scene
from tests.unit.reading import changed_planes

TINY = ExtrapolatorSettings(
    architecture="blend", width=4, steps=3, batch=2, patch=32, frames=2, side=64, seed=1
)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory) -> list[RenderedScene]:
    root = tmp_path_factory.mktemp("data")
    return [
        open_scene(write_scene(root / name, instants=9, scene=name, role="training"))
        for name in ("one", "two")
    ]


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("crops")


@pytest.fixture
def train(scenes, cache, tmp_path, monkeypatch):
    """Train into one folder, without exporting at the end."""

    def unexported(self: ExtrapolatorTraining) -> Path:
        (self.folder / MODEL).touch()
        return self.folder / MODEL

    monkeypatch.setattr(ExtrapolatorTraining, "export", unexported)

    def run(settings: ExtrapolatorSettings = TINY) -> Path:
        folder = tmp_path / "run"
        ExtrapolatorTraining.train(scenes, folder, cache, settings, 1, 1, lambda line: None)
        return folder

    return run


def test_a_failed_start_does_not_block_its_folder(train, tmp_path):
    with pytest.raises(InputError, match="smaller than crops of 96"):
        train(replace(TINY, side=96))
    assert not (tmp_path / "run" / CHECKPOINT).exists()
    folder = train()
    assert '"side": 64' in (folder / SETTINGS).read_text()
    assert (folder / MODEL).exists()


@pytest.mark.parametrize("what", ["empty", "text", "cut", "of another network", "of something"])
def test_a_damaged_checkpoint_is_said(train, what):
    path = train() / CHECKPOINT
    whole = path.read_bytes()
    if what == "of another network":
        kept = torch.load(path, weights_only=True)
        torch.save(kept | {"network": {}}, path)
    elif what == "of something":
        torch.save([1, 2, 3], path)
    else:
        path.write_bytes(
            {"empty": b"", "text": b"text" * 99, "cut": whole[: len(whole) // 2]}[what]
        )
    with pytest.raises(DamagedFileError, match=r"checkpoint\.pt is damaged.*; choose another"):
        train()
    path.write_bytes(whole)
    train()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_loss_that_is_no_number_ends_it(train, monkeypatch, tmp_path, value):
    true, count = extrapolator_training.loss_of, []

    def breaks(*args: torch.Tensor) -> torch.Tensor:
        count.append(1)
        return true(*args) * (value if len(count) == 3 else 1)

    monkeypatch.setattr(extrapolator_training, "loss_of", breaks)
    with pytest.raises(UsageError, match="the loss was no number at step 2; lower --rate"):
        train()
    assert not (tmp_path / "run" / MODEL).exists()
    kept = torch.load(tmp_path / "run" / CHECKPOINT, weights_only=True)
    assert kept["step"] == 2
    assert all(torch.isfinite(t).all() for t in kept["average"].values())


@pytest.fixture(scope="module")
def arrays(scenes) -> dict[str, np.ndarray]:
    return Crops.prepare(scenes[0], TINY)


def files(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {p.name: (p.stat().st_mtime_ns, p.read_bytes()) for p in folder.iterdir()}


def test_the_second_writer_leaves_the_first_one_s_crops(arrays, tmp_path):
    folder = tmp_path / "cache" / "crops"
    write_arrays(arrays, folder)
    first = files(folder)
    write_arrays({name: array + 1 for name, array in arrays.items()}, folder)
    assert files(folder) == first
    assert list(folder.parent.iterdir()) == [folder], "nothing is left beside it"


def test_what_was_not_rendered_rightly_is_no_target(scenes, arrays, monkeypatch):
    parts = {
        np.nan: np.s_[20:40, 30:60],
        np.inf: np.s_[20:40, 60:100],
        -np.inf: np.s_[40:60, 30:100],
    }

    def spoiled(_shot: Shot, _number: int, role: Role, planes: np.ndarray) -> np.ndarray:
        if role is Role.COLOUR:
            planes = planes.copy()
            for value, part in parts.items():
                planes[part] = value
        return planes

    changed_planes(monkeypatch, spoiled)
    found = Crops.prepare(scenes[0], TINY)
    for name, planes in found.items():
        assert np.isfinite(planes).all(), name
    assert np.abs(found["target"]).max() < 2 * np.abs(arrays["target"]).max()
