"""Training of extrapolation networks on a tiny scene."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from exwarp_cli.domain.frame import Window
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.io.dataset import (
    RenderedScene,
    SceneManifest,
    open_scene,
    select_scenes,
    split_scenes,
)
from exwarp_cli.metrics.registry import score_frame
from exwarp_cli.research.training import crop_cache as batches
from exwarp_cli.research.training.crop_cache import (
    IN_HOLES,
    SHORT,
    Crops,
    FrameChoice,
    _crop_weight,
    _draw_view,
    choose_frames,
    to_device,
    vary,
    write_arrays,
)
from exwarp_cli.research.training.extrapolation_network import ARCHITECTURES, ExtrapolationNetwork
from exwarp_cli.research.training.extrapolator_training import (
    FEW,
    HOLES,
    SQUARED,
    SQUARED_HOLES,
    ExtrapolatorTraining,
    loss_of,
    psnr,
    to_display,
)
from exwarp_cli.research.training.resumable_training import CHECKPOINT, CURVE
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.research.training.training_settings import ExtrapolatorSettings
from tests.unit.analytic_scene import INSTANTS, manifest, write_manifest, write_scene

SIDE = 64
TINY = ExtrapolatorSettings(
    architecture="blend", width=8, steps=6, batch=4, patch=32, frames=6, side=SIDE, seed=1
)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    for name in ("first", "second"):
        write_scene(folder / name, instants=9, scene=name, role="training")
    return folder


@pytest.fixture(scope="module")
def scenes(data) -> list[RenderedScene]:
    return [open_scene(data / name) for name in ("first", "second")]


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("crops")


@pytest.fixture(scope="module")
def crops(scenes, cache) -> Crops:
    folder = Crops.folder_of(scenes[0], TINY, cache)
    write_arrays(Crops.prepare(scenes[0], TINY), folder)
    return Crops([folder])


def quiet(_line: str) -> None: ...


@pytest.fixture
def unexported(monkeypatch):
    """Exporting takes torch seconds; `test_training_start` does it."""
    monkeypatch.setattr(ExtrapolatorTraining, "export", lambda self: self.folder)


def train(scenes, folder: Path, cache: Path, settings: ExtrapolatorSettings = TINY) -> Path:
    return ExtrapolatorTraining.train(scenes, folder, cache, settings, 2, 1, quiet)


def weights(folder: Path) -> dict[str, torch.Tensor]:
    kept = torch.load(folder / CHECKPOINT, weights_only=True)
    return kept["network"] | {f"average.{name}": t for name, t in kept["average"].items()}


def same(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> bool:
    return all(torch.equal(a[name], b[name]) for name in a)


@pytest.fixture
def manifest_with(tmp_path) -> Callable[..., SceneManifest]:
    """The manifest of the analytic scene, with changes."""

    def read(**changes: object) -> SceneManifest:
        write_manifest(tmp_path, manifest(**changes))
        return open_scene(tmp_path).manifest

    return read


def chosen(manifest: SceneManifest, frames: int, seed: int = 0) -> list[FrameChoice]:
    return choose_frames(manifest, ExtrapolatorSettings(frames=frames, side=SIDE, seed=seed))


def test_frames_are_chosen_by_the_seed_and_mostly_with_history(manifest_with):
    many = chosen(manifest_with(), 400, 0)
    assert chosen(manifest_with(), 400, 0) == many != chosen(manifest_with(), 400, 1)
    assert {c.slot for c in many} == {1, 2, 3}
    assert {c.setting for c in many} == {"key", "slot"}
    assert len({c.look for c in many}) > 50
    assert {c.variant.backwards for c in many} == {True, False}
    assert chosen(manifest_with(name="lab"), 400, 0) != chosen(manifest_with(name="town"), 400, 0)
    for choice in many:
        shown = len(choice.variant.order(INSTANTS))
        last = FACTOR * choice.k + (FACTOR if choice.setting == "key" else choice.slot)
        assert last < shown  # the next key frame is rendered, or the slot alone
    few = chosen(manifest_with(), 40, 0)
    assert np.mean([c.k >= 2 for c in few]) > 0.6


def test_where_every_instant_is_a_key_frame_too_the_last_one_may_be_chosen(manifest_with):
    keys = [c for c in chosen(manifest_with(key_step=1), 800, 0) if c.setting == "key"]
    ends = {(c.variant.phase, FACTOR * (c.k + 1) - len(c.variant.order(INSTANTS))) for c in keys}
    assert {phase for phase, beyond in ends if beyond == 0} == {1}  # slot 3 is the last instant
    assert max(beyond for _, beyond in ends) == 0
    assert all(c.k < 3 or c.variant.phase < 2 for c in keys)


def test_longer_scenes_give_more_frames(manifest_with):
    lengths = (6, SHORT + 1, 4 * SHORT + 1)
    assert [len(chosen(manifest_with(count=n), 30)) for n in lengths] == [30, 30, 60]


def test_parts_of_frames_hold_a_crop_and_lie_inside():
    whole, rng = Window(-3, 5, 128, 80), np.random.default_rng(0)
    views = [_draw_view(whole, SIDE, rng) for _ in range(400)]
    assert all(whole.covers(v) and min(v.shape) >= SIDE for v in views)
    assert 0.4 < np.mean([v == whole for v in views]) < 0.6
    assert {v.corners for v in views} >= {whole.corners} and len(set(views)) > 150


def test_half_of_the_crops_are_about_holes_however_small(scenes):
    interval = SceneClip(scenes[0]).causal(1, "key")
    hole = interval.back(3).hole
    weight = _crop_weight(interval, 3)
    assert 0 < hole.mean() < 0.1
    assert IN_HOLES < weight[hole].sum() / weight.sum() < IN_HOLES + hole.mean() * 3
    assert weight.min() > 0


def test_crops_are_parts_of_what_was_rendered(scenes, crops):
    again = Crops.prepare(scenes[0], TINY)
    batch = crops.batch(range(len(crops)))
    assert len(crops) == len(again["time"])
    np.testing.assert_array_equal(batch.target.numpy(), again["target"].astype(np.float32))
    assert batch.warped.shape[1:] == (6, SIDE, SIDE)
    gain = psnr(batch.plain, batch.target)
    assert gain.mean() > 20  # the warp shows about what was rendered
    hole = batch.mask == 0
    assert (batch.warped[:, :3] * hole == 0).all()


def test_scenes_smaller_than_a_crop_are_refused(scenes):
    with pytest.raises(InputError, match="128x80, smaller than crops of 96"):
        Crops.prepare(scenes[0], ExtrapolatorSettings(frames=2, side=96, seed=0))


def test_batches_follow_from_seed_and_step(crops, monkeypatch):
    first = crops.draw(3, 4, 32, 7)
    for a, b in zip(first.inputs, crops.draw(3, 4, 32, 7).inputs, strict=True):
        assert torch.equal(a, b)
    assert not torch.equal(first.warped, crops.draw(4, 4, 32, 7).warped)
    assert not torch.equal(first.warped, crops.draw(3, 4, 32, 8).warped)
    monkeypatch.setattr(Crops, "batch", lambda self, indices, side, rng: indices)
    order = [i for step in range(2) for i in crops.draw(step, len(crops), 32, 7)]
    assert crops.draw(1, len(crops) + 2, 32, 7)[:-4] == order[len(crops) + 2 :]
    assert sorted(order[: len(crops)]) == sorted(order[len(crops) :]) == list(range(len(crops)))
    assert order[: len(crops)] != order[len(crops) :]


def test_the_edges_of_crops_are_often_those_of_patches(crops, monkeypatch):
    """What lies there is hidden like nothing else, and has to be learnt."""
    places = np.arange(SIDE, dtype=np.float16) + np.zeros((len(crops), 3, SIDE, 1), np.float16)
    monkeypatch.setitem(
        crops._files[0], "target", places.swapaxes(2, 3)
    )  # every pixel is its row's number
    monkeypatch.setattr(batches, "vary", lambda batch, rng: batch)
    drawn = [crops.draw(step, 4, 32, 0).target[:, 0, 0, 0] for step in range(100)]
    rows = torch.cat(drawn).numpy()
    assert rows.min() == 0 and rows.max() == SIDE - 32
    for edge in (0, SIDE - 32):
        assert 0.15 < np.mean(rows == edge) < 0.35


@pytest.mark.parametrize("seed", range(6))
def test_variation_keeps_pictures_and_truth_together(crops, seed):
    """The filled warp is as far from the truth as before, whatever is turned or re-coloured."""
    batch = crops.batch(range(8))
    found = vary(batch, np.random.default_rng(seed))
    error = (encoded(batch.plain) - encoded(batch.target)).abs()
    changed = (encoded(found.plain) - encoded(found.target)).abs()
    share = (error > 0.05).float().mean((1, 2, 3)), (changed > 0.05).float().mean((1, 2, 3))
    assert torch.allclose(*share, atol=0.1)
    assert torch.equal(found.mask.sum((1, 2, 3)), batch.mask.sum((1, 2, 3)))
    length = found.features[:, :3].norm(dim=1)
    assert ((length < 1.01) & ((length > 0.9) | (length < 0.01))).float().mean() > 0.95


def test_nothing_of_a_step_changes_the_device(crops):
    """On the meta device arithmetic with a tensor of any other device is an error."""
    batch = crops.batch(range(4))
    meta = to_device(batch, "meta")
    for seed in range(12):  # all that is left out or turned by chance
        found = vary(meta, np.random.default_rng(seed))
        assert {plane.device.type for plane in found} == {"meta"}
    for name in ARCHITECTURES:
        network = ExtrapolationNetwork(name, 8).to("meta")
        made = found.finish(network(*found.inputs))
        loss = loss_of(made, found.target, found.plain, found.mask)
        assert loss.device.type == made.device.type == "meta"
        assert psnr(made, found.target, 1 - found.mask).device.type == "meta"


def encoded(linear: torch.Tensor) -> torch.Tensor:
    return batches.encode(linear)


def test_coding_is_that_of_synthesis():
    from exwarp_cli.synthesis import extrapolation

    linear = np.linspace(-3, 60, 100, dtype=np.float32)
    coded = batches.encode(torch.from_numpy(linear))
    np.testing.assert_allclose(coded.numpy(), extrapolation.encode(linear), rtol=1e-6)
    np.testing.assert_allclose(batches.decode(coded).numpy(), linear, rtol=1e-5, atol=1e-6)


def test_decibels_are_the_metric_s():
    rng = np.random.default_rng(0)
    truth = rng.random((40, 50, 3), np.float32) * 1.5
    made = truth + rng.normal(0, 0.05, truth.shape).astype(np.float32)
    mask = rng.random((40, 50)) < 0.2
    overall, inside = score_frame(truth, made, mask)
    a, b = (torch.from_numpy(x.transpose(2, 0, 1)[None]) for x in (made, truth))
    assert float(psnr(a, b)) == pytest.approx(overall.psnr_db, abs=1e-3)
    where = torch.from_numpy(mask[None, None].astype(np.float32))
    assert float(psnr(a, b, where)) == pytest.approx(inside.psnr_db, abs=1e-3)


def test_the_loss_counts_holes_and_the_hardest_tenth_again():
    truth = torch.zeros(1, 3, 10, 10)
    plain = torch.full_like(truth, 1.0)
    made, mask = truth.clone(), torch.ones(1, 1, 10, 10)
    assert loss_of(truth, truth, plain, mask) == 0
    made[..., 0, :] = 1.0  # a tenth of the pixels is wrong by 1, as are all of the plain ones
    seen = float(loss_of(made, truth, plain, mask))
    assert seen == pytest.approx(0.1 + 1.0 + SQUARED * 0.1, abs=1e-4)
    mask[..., 0, :] = 0
    hole = 1 / (1 + 10 * FEW)
    expected = 0.1 + HOLES * hole + 1 + SQUARED * 0.1
    assert float(loss_of(made, truth, plain, mask)) == pytest.approx(expected, abs=1e-3)


def test_gains_in_holes_count_in_decibels():
    truth, plain = torch.zeros(1, 3, 10, 10), torch.ones(1, 3, 10, 10)
    mask = torch.zeros(1, 1, 10, 10)

    def squared_part(error: float) -> float:
        seen = to_display(torch.tensor(error)).item()
        others = 2 * seen + HOLES * seen / (1 + FEW) + SQUARED * seen**2
        return float(loss_of(plain * error, truth, plain, mask)) - others

    steps = np.diff([squared_part(error) for error in (0.9, 0.5, 0.2)])
    curve = [
        2 * SQUARED_HOLES * np.log(to_display(torch.tensor(e)).item()) for e in (0.9, 0.5, 0.2)
    ]
    np.testing.assert_allclose(steps, np.diff(curve), atol=1e-3)


def test_a_decibel_is_worth_the_same_on_every_picture():
    truth = torch.full((2, 3, 8, 8), 0.5)
    plain = truth + torch.tensor([0.01, 0.2]).reshape(2, 1, 1, 1)
    mask = torch.ones(2, 1, 8, 8)
    worse = [plain.clone(), plain.clone()]
    for index, made in enumerate(worse):
        made[index] = truth[index]
    good_gain, bad_gain = (float(loss_of(made, truth, plain, mask)) for made in worse)
    assert 0.2 < good_gain / bad_gain < 5


def test_shown_is_the_srgb_curve_and_goes_on_above_white():
    linear = torch.tensor([-0.5, 0.0, 0.002, 0.18, 0.5, 1.0, 4.0, 1000.0])
    found = to_display(linear)
    np.testing.assert_allclose(
        found[:6].numpy(), [-0.5, 0, 0.02584, 0.46136, 0.73536, 1.0], atol=1e-4
    )
    assert (found[1:] > found[:-1]).all()
    linear.requires_grad_(True)
    to_display(linear).sum().backward()
    assert torch.isfinite(linear.grad).all()


def test_training_gets_better_and_is_exported(scenes, cache, tmp_path, monkeypatch, unexported):
    """On the same few crops, again and again."""
    draw, settings = Crops.draw, replace(TINY, steps=16, rate=5e-2)
    monkeypatch.setattr(Crops, "draw", lambda self, step, **rest: draw(self, 0, **rest))
    assert train(scenes, tmp_path / "run", cache, settings) == tmp_path / "run"
    with (tmp_path / "run" / CURVE).open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == ExtrapolatorTraining.columns
    assert [int(row["step"]) for row in rows] == list(range(2, 17, 2))
    losses = [float(row["loss"]) for row in rows]
    assert losses == sorted(losses, reverse=True) and losses[-1] < 0.9 * losses[0]


def test_a_broken_training_goes_on_to_the_same_weights(
    scenes, cache, tmp_path, monkeypatch, unexported
):
    train(scenes, tmp_path / "whole", cache)
    learn, count = ExtrapolatorTraining._learn, []

    def breaks(self, batch):
        count.append(1)
        if len(count) == 4:
            raise KeyboardInterrupt
        return learn(self, batch)

    monkeypatch.setattr(ExtrapolatorTraining, "_learn", breaks)
    with pytest.raises(KeyboardInterrupt):
        train(scenes, tmp_path / "broken", cache)
    monkeypatch.setattr(ExtrapolatorTraining, "_learn", learn)
    train(scenes, tmp_path / "broken", cache)
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "broken"))
    with (tmp_path / "broken" / CURVE).open() as file:
        assert [int(row["step"]) for row in csv.DictReader(file)] == [2, 4, 6]


def test_another_seed_makes_another_network(tmp_path):
    one, other = (
        ExtrapolatorTraining(tmp_path / "run", replace(TINY, seed=seed), quiet).network.state_dict()
        for seed in (1, 2)
    )
    assert not same(one, other)


def test_a_folder_of_another_training_is_refused(scenes, cache, tmp_path, unexported):
    train(scenes, tmp_path / "a", cache)
    with pytest.raises(UsageError, match="other settings"):
        train(scenes, tmp_path / "a", cache, replace(TINY, rate=1e-4))


def test_scenes_are_held_out_by_name(scenes):
    learnt, held = split_scenes(scenes[::-1])
    assert [s.name for s in learnt] == ["first"]
    assert [s.name for s in held] == ["second"]
    with pytest.raises(InputError, match="1 scene to train on"):
        split_scenes(scenes[:1])


def test_scenes_are_selected_by_name_and_completeness(data, tmp_path):
    said: list[str] = []
    assert [s.name for s in select_scenes(data, (), (), said.append)] == ["first", "second"]
    assert [s.name for s in select_scenes(data, ("f*",), (), said.append)] == ["first"]
    assert [s.name for s in select_scenes(data, (), ("f*",), said.append)] == ["second"]
    assert said == []
    with pytest.raises(InputError, match="no scene to learn from"):
        select_scenes(data, ("third",), (), said.append)
    write_scene(tmp_path / "data" / "benchmark", instants=9)
    write_scene(tmp_path / "data" / "cut", scene="cut", instants=9, role="training")
    (tmp_path / "data" / "cut" / "instants" / "cut.0004.exr").unlink()
    with pytest.raises(InputError, match="no scene to learn from"):
        select_scenes(tmp_path / "data", (), (), said.append)
    assert said == ["cut is not rendered to the end and left out"]
