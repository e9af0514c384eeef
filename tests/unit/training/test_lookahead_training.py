"""Training of the look-ahead network on a tiny scene."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from exwarp_cli.domain.network_api import CANDIDATES, LOOKAHEAD_INTERFACE, NetworkPictures
from exwarp_cli.errors import LayoutError, UsageError
from exwarp_cli.io.dataset import RenderedScene, open_scene
from exwarp_cli.models.picture_network import load_lookahead
from exwarp_cli.research.training import lookahead_training
from exwarp_cli.research.training.crop_cache import to_device, write_arrays
from exwarp_cli.research.training.lookahead_training import (
    SHARE,
    LookAheadTraining,
    SampleBatch,
    Samples,
    WeighingNetwork,
    loss_of,
    mix,
    variants_of,
)
from exwarp_cli.research.training.resumable_training import CHECKPOINT, CURVE
from exwarp_cli.research.training.training_settings import LookAheadSettings
from tests.unit.analytic_scene import write_scene

TINY = LookAheadSettings(width=4, steps=4, batch=2, patch=32, seed=1)


@pytest.fixture(scope="module", autouse=True)
def few_variants() -> Iterator[None]:
    """Samples of one key interval a scene, as making all takes a minute."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            lookahead_training, "variants_of", lambda name, seed: variants_of(name, seed)[:1]
        )
        yield


@pytest.fixture(scope="module")
def scenes(tmp_path_factory) -> list[RenderedScene]:
    folder = tmp_path_factory.mktemp("data")
    for name in ("first", "second"):
        write_scene(folder / name, instants=5, scene=name, role="training")
    return [open_scene(folder / name) for name in ("first", "second")]


@pytest.fixture(scope="module")
def cache(few_variants, scenes, tmp_path_factory) -> Path:
    """Samples of both scenes, as a training makes them."""
    folder = tmp_path_factory.mktemp("cache")
    for scene in scenes:
        write_arrays(Samples.prepare(scene, TINY), Samples.folder_of(scene, TINY, folder))
    return folder


@pytest.fixture(scope="module")
def samples(scenes, cache) -> Samples:
    return Samples([Samples.folder_of(scenes[0], TINY, cache)])


def quiet(_line: str) -> None: ...


def train(scenes, folder: Path, cache: Path, settings: LookAheadSettings, **more) -> Path:
    return LookAheadTraining.train(scenes, folder, cache, settings, 2, 1, quiet, **more)


class TestSamples:
    def test_they_are_what_a_run_gives_its_network(self, samples):
        slot = samples.batch([0])._asdict()
        shapes = {name: slot[name].shape[1] for name in LOOKAHEAD_INTERFACE.inputs}
        assert shapes == dict(LOOKAHEAD_INTERFACE.inputs)
        assert slot["time"] == 0.25
        error = (slot["colour"][:, :3] - slot["truth"]).abs().mean()
        assert error < 0.05  # what softsplat makes comes first

    def test_of_a_scene_they_are_always_the_same(self, scenes, cache):
        again = Samples.prepare(scenes[0], TINY)
        assert set(again) == set(SampleBatch._fields)
        for name, array in again.items():
            once = np.load(Samples.folder_of(scenes[0], TINY, cache) / f"{name}.npy")
            np.testing.assert_array_equal(array, once)

    def test_looks_are_drawn_by_name_and_seed(self):
        assert variants_of("one", 0) == variants_of("one", 0)
        assert any(variants_of("one", seed) != variants_of("two", seed) for seed in range(3))

    def test_a_batch_is_drawn_by_its_step(self, samples):
        one, again, other = (samples.draw(step, 3, 32, 0) for step in (5, 5, 6))
        assert one.truth.shape == (3, 3, 32, 32)
        assert torch.equal(one.colour, again.colour)
        assert not torch.equal(one.colour, other.colour)
        assert ((one.time > 0) & (one.time < 1)).all()

    def test_processes_draw_the_same_batches_in_the_same_order(self, samples):
        draw = partial(samples.draw, size=TINY.batch, side=TINY.patch, seed=TINY.seed)
        loader = DataLoader(range(3, 8), batch_size=None, collate_fn=draw, num_workers=2)
        for step, batch in zip(range(3, 8), loader, strict=True):
            assert torch.equal(batch.truth, draw(step).truth)
            assert torch.equal(to_device(batch, "cpu").depth, draw(step).depth)


class TestLoss:
    @pytest.fixture
    def truth(self) -> torch.Tensor:
        return torch.rand(2, 3, 32, 32, generator=torch.Generator().manual_seed(0))

    def test_the_truth_is_best(self, truth):
        assert loss_of(truth, truth) < loss_of(truth + 0.01, truth) < loss_of(truth + 0.1, truth)

    def test_blur_costs_more_than_its_error(self, truth):
        """An even error of the same size leaves the gradients as they are."""
        blurred = torch.nn.functional.avg_pool2d(truth, 3, 1, 1, count_include_pad=False)
        shift = (blurred - truth).square().mean((1, 2, 3), keepdim=True).sqrt()
        assert loss_of(blurred, truth) > loss_of(truth + shift, truth)


class TestNetwork:
    def test_weights_add_up_and_begin_with_softsplat(self, samples):
        network = WeighingNetwork(8).eval()
        sample = samples.draw(0, 2, 32, 0)
        with torch.no_grad():
            weights = network(*sample[:-1])
        assert weights.shape == (2, CANDIDATES, 32, 32)
        torch.testing.assert_close(weights.sum(1), torch.ones(2, 32, 32))
        assert (weights.argmax(1) == 0).float().mean() > 0.9

    def test_mix(self, samples):
        sample = samples.draw(0, 2, 32, 0)
        weights = torch.zeros(2, CANDIDATES, 32, 32)
        weights[:, 0] = 1
        assert torch.equal(mix(weights, sample.colour), sample.colour[:, :3])
        weights = weights.roll(1, 1)
        assert torch.equal(mix(weights, sample.colour), sample.colour[:, 3:6])


class TestTraining:
    def test_stopped_and_gone_on_with_it_is_the_same(self, scenes, cache, tmp_path, monkeypatch):
        monkeypatch.setattr(LookAheadTraining, "export", lambda self: self.folder)
        train(scenes, tmp_path / "whole", cache, TINY)

        real, saved = LookAheadTraining._record, []

        def record(self, *values):
            saved.append(self.step)
            if self.step == TINY.steps and len(saved) == 2:
                raise KeyboardInterrupt
            real(self, *values)

        monkeypatch.setattr(LookAheadTraining, "_record", record)
        with pytest.raises(KeyboardInterrupt):
            train(scenes, tmp_path / "part", cache, TINY)
        train(scenes, tmp_path / "part", cache, TINY)
        curves = [
            list(csv.DictReader((tmp_path / name / CURVE).read_text().splitlines()))
            for name in ("whole", "part")
        ]
        assert list(curves[0][0]) == list(LookAheadTraining.columns)
        for curve in curves:
            for row in curve:
                del row["seconds"]
        assert curves[0] == curves[1]

    def test_other_settings_are_refused(self, scenes, cache, tmp_path, monkeypatch):
        monkeypatch.setattr(LookAheadTraining, "export", lambda self: self.folder)
        train(scenes, tmp_path / "run", cache, replace(TINY, steps=2))
        with pytest.raises(UsageError, match="holds a training with other settings"):
            train(scenes, tmp_path / "run", cache, TINY)

    def test_a_start_of_another_width_is_refused(self, scenes, cache, tmp_path, monkeypatch):
        monkeypatch.setattr(LookAheadTraining, "export", lambda self: self.folder)
        train(scenes, tmp_path / "narrow", cache, replace(TINY, steps=2))
        wider, start = replace(TINY, width=8), tmp_path / "narrow" / CHECKPOINT
        with pytest.raises(LayoutError, match="another network than one of 8 channels"):
            train(scenes, tmp_path / "wide", cache, wider, start=start)

    def test_the_model_answers_as_the_network_held_back(
        self, scenes, cache, samples, tmp_path, monkeypatch
    ):
        monkeypatch.setattr(lookahead_training, "GROWTH", (1,))  # what is exported takes long
        settings = replace(TINY, steps=2)
        model = train(scenes, tmp_path / "run", cache, settings)
        training = LookAheadTraining(tmp_path / "run", _settings_of(tmp_path / "run"), quiet)
        sample = samples.batch([0])
        height, width = (size // 16 * 16 for size in sample.truth.shape[-2:])
        pictures = sample._asdict()
        inputs = {n: pictures[n][..., :height, :width] for n in LOOKAHEAD_INTERFACE.inputs}
        training.average.eval()
        with torch.no_grad():
            weights = training.average(**inputs, time=sample.time)[0]
        expected = SHARE * weights.numpy()
        expected[0] += 1 - SHARE  # that much is left to softsplat
        given = NetworkPictures(
            {name: picture[0].numpy() for name, picture in inputs.items()}, float(sample.time[0])
        )
        ((_, found),) = load_lookahead(model, 1, "cpu").weigh(given)
        np.testing.assert_allclose(found, expected, atol=1e-5)


def _settings_of(folder: Path) -> LookAheadSettings:
    return LookAheadSettings(**json.loads((folder / "settings.json").read_text()))
