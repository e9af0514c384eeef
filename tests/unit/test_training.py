"""Training of extrapolation networks on a tiny scene."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import torch

from exwarp_cli.domain.extrapolator import INPUTS, TIME, NetworkInputs
from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.io.dataset import RenderedScene, open_scene
from exwarp_cli.io.models import load_extrapolator
from exwarp_cli.metrics.registry import score
from exwarp_cli.training import crops as batches
from exwarp_cli.training.crops import Crops, varied
from exwarp_cli.training.extrapolator import (
    CHECKPOINT,
    COLUMNS,
    CURVE,
    Training,
    train_extrapolator,
)
from exwarp_cli.training.losses import FEW, HOLES, SQUARED, decibels, loss_of, shown
from exwarp_cli.training.networks import ARCHITECTURES, STRIDE, Architecture, build
from exwarp_cli.training.samples import CropSettings, choices, crops_of, write_crops
from exwarp_cli.training.selection import select, split
from exwarp_cli.training.settings import TrainingSettings
from tests.unit.analytic_scene import INSTANTS, write_scene

SIDE = 64
MADE = CropSettings(frames=6, side=SIDE, seed=1)
TINY = TrainingSettings(
    architecture="blend", width=8, steps=6, batch=4, patch=32, frames=6, side=SIDE, seed=1
)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    for name in ("first", "second"):
        write_scene(folder / name, scene=name, role="training")
    return folder


@pytest.fixture(scope="module")
def scenes(data) -> list[RenderedScene]:
    return [open_scene(data / name) for name in ("first", "second")]


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("crops")


@pytest.fixture(scope="module")
def crops(scenes, cache) -> Crops:
    write_crops(scenes[0], MADE, cache / "one")
    return Crops([cache / "one"])


def quiet(_line: str) -> None: ...


@pytest.fixture
def unexported(monkeypatch):
    """Exporting takes torch seconds; one test does it."""
    monkeypatch.setattr(Training, "export", lambda self: self.folder)


def train(scenes, folder: Path, cache: Path, settings: TrainingSettings = TINY) -> Path:
    return train_extrapolator(scenes, folder, cache, settings, 2, 1, quiet)


def weights(folder: Path) -> dict[str, torch.Tensor]:
    kept = torch.load(folder / CHECKPOINT, weights_only=True)
    return kept["network"] | {f"average.{name}": t for name, t in kept["average"].items()}


def same(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> bool:
    return all(torch.equal(a[name], b[name]) for name in a)


def test_frames_are_chosen_by_the_seed_and_mostly_with_history():
    many = choices(INSTANTS, 400, 0)
    assert choices(INSTANTS, 400, 0) == many != choices(INSTANTS, 400, 1)
    assert {c.slot for c in many} == {1, 2, 3}
    assert {c.setting for c in many} == {"key", "slot"}
    assert {c.bare for c in many} == {True, False}
    assert {c.variant.backwards for c in many} == {True, False}
    few = choices(INSTANTS, 40, 0)
    assert np.mean([c.k >= 2 for c in few]) > 0.7


def test_crops_are_parts_of_what_was_rendered(scenes, crops):
    again = crops_of(scenes[0], MADE)
    batch = crops.batch(range(len(crops)))
    assert len(crops) == len(again["time"])
    np.testing.assert_array_equal(batch.target.numpy(), again["target"].astype(np.float32))
    assert batch.warped.shape[1:] == (6, SIDE, SIDE)
    gain = decibels(batch.plain, batch.target)
    assert gain.mean() > 20  # the warp shows about what was rendered
    hole = batch.mask == 0
    assert (batch.warped[:, :3] * hole == 0).all()


def test_scenes_smaller_than_a_crop_are_refused(scenes):
    with pytest.raises(InputError, match="128x80, smaller than crops of 96"):
        crops_of(scenes[0], CropSettings(2, 96, 0))


def test_batches_follow_from_seed_and_step(crops):
    first = crops.drawn(3, 4, 32, 7)
    for a, b in zip(first.inputs, crops.drawn(3, 4, 32, 7).inputs, strict=True):
        assert torch.equal(a, b)
    assert not torch.equal(first.warped, crops.drawn(4, 4, 32, 7).warped)
    order = [crops._nth(n, 7) for n in range(2 * len(crops))]
    assert sorted(order[: len(crops)]) == sorted(order[len(crops) :]) == list(range(len(crops)))
    assert order[: len(crops)] != order[len(crops) :]


@pytest.mark.parametrize("seed", range(6))
def test_variation_keeps_pictures_and_truth_together(crops, seed):
    """The filled warp is as far from the truth as before, whatever is turned or re-coloured."""
    batch = crops.batch(range(8))
    found = varied(batch, np.random.default_rng(seed))
    error = (encoded(batch.plain) - encoded(batch.target)).abs()
    changed = (encoded(found.plain) - encoded(found.target)).abs()
    share = (error > 0.05).float().mean((1, 2, 3)), (changed > 0.05).float().mean((1, 2, 3))
    assert torch.allclose(*share, atol=0.1)
    assert torch.equal(found.mask.sum((1, 2, 3)), batch.mask.sum((1, 2, 3)))
    length = found.features[:, :3].norm(dim=1)
    assert ((length < 1.01) & ((length > 0.9) | (length < 0.01))).float().mean() > 0.95


def encoded(linear: torch.Tensor) -> torch.Tensor:
    return batches.encode(linear)


def test_coding_is_that_of_synthesis():
    from exwarp_cli.synthesis import modulation

    linear = np.linspace(-3, 60, 100, dtype=np.float32)
    coded = batches.encode(torch.from_numpy(linear))
    np.testing.assert_allclose(coded.numpy(), modulation.encode(linear), rtol=1e-6)
    np.testing.assert_allclose(batches.decode(coded).numpy(), linear, rtol=1e-5, atol=1e-6)


def test_decibels_are_the_metric_s():
    rng = np.random.default_rng(0)
    truth = rng.random((40, 50, 3), np.float32) * 1.5
    made = truth + rng.normal(0, 0.05, truth.shape).astype(np.float32)
    mask = rng.random((40, 50)) < 0.2
    overall, inside = score(truth, made, mask)
    a, b = (torch.from_numpy(x.transpose(2, 0, 1)[None]) for x in (made, truth))
    assert float(decibels(a, b)) == pytest.approx(overall.psnr_db, abs=1e-3)
    where = torch.from_numpy(mask[None, None].astype(np.float32))
    assert float(decibels(a, b, where)) == pytest.approx(inside.psnr_db, abs=1e-3)


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
    expected = 0.1 + HOLES * hole + 1 + SQUARED * (0.1 + 1)
    assert float(loss_of(made, truth, plain, mask)) == pytest.approx(expected, abs=1e-3)


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
    found = shown(linear)
    np.testing.assert_allclose(
        found[:6].numpy(), [-0.5, 0, 0.02584, 0.46136, 0.73536, 1.0], atol=1e-4
    )
    assert (found[1:] > found[:-1]).all()
    linear.requires_grad_(True)
    shown(linear).sum().backward()
    assert torch.isfinite(linear.grad).all()


@pytest.fixture(params=ARCHITECTURES)
def network(request):
    torch.manual_seed(0)
    return build(request.param, 8).eval()


def example(height: int, width: int, seed: int = 0) -> dict[str, torch.Tensor]:
    rng = torch.Generator().manual_seed(seed)
    pictures = {
        name: torch.rand(1, channels, height, width, generator=rng)
        for name, channels in INPUTS.items()
    }
    pictures["mask"] = (pictures["mask"] > 0.2).float()
    return pictures | {TIME: torch.tensor([0.5])}


@pytest.mark.parametrize("size", [(STRIDE, 2 * STRIDE), (48, 80)])
def test_networks_answer_at_any_multiple_of_the_stride(network, size):
    answer = network(**example(*size))
    assert answer.shape == (1, 3, *size)
    assert torch.isfinite(answer).all()


@pytest.mark.parametrize(
    "name", [n for n, a in ARCHITECTURES.items() if not (a.residual or a.patched)]
)
def test_weights_invent_nothing(name):
    """Where all candidates are of one colour, so is the answer."""
    torch.manual_seed(1)
    network = build(name, 8).eval()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    given = example(32, 48)
    given["warped"][:, 3:] = 0.7
    for index in range(3):
        given["history"][:, 4 * index : 4 * index + 3] = 0.7
    np.testing.assert_allclose(network(**given).detach().numpy(), 0.7, rtol=1e-5)


def test_an_unknown_past_is_replaced_by_the_filled_warp():
    network = build("kernels", 8).eval()
    given = example(32, 32)
    given["warped"][:, 3:] = 0.7
    given["history"].zero_()
    np.testing.assert_allclose(network(**given).detach().numpy(), 0.7, rtol=1e-5)


def test_candidates_are_counted_right():
    for name, architecture in ARCHITECTURES.items():
        network = build(name, 8)
        given = example(32, 32)
        flow = torch.zeros(1, 2 * architecture.flow, 32, 32)
        made = network._candidates(
            given["warped"][:, 3:], given["history"], given[TIME].reshape(-1, 1, 1, 1), flow
        )
        assert not architecture.candidates or len(made) == network._count()


def test_a_candidate_can_be_moved():
    from exwarp_cli.training.networks import _moved

    frame = torch.arange(12.0).reshape(1, 1, 3, 4).repeat(1, 3, 1, 1)
    flow = torch.zeros(1, 2, 3, 4)
    flow[:, 0] = 1
    np.testing.assert_allclose(_moved(frame, flow)[0, 0, :, :3], frame[0, 0, :, 1:], atol=1e-5)


def test_architectures_differ():
    assert len(set(ARCHITECTURES.values())) == len(ARCHITECTURES) >= 4
    assert Architecture() == ARCHITECTURES["blend"]


def test_training_gets_better_and_is_exported(scenes, cache, tmp_path):
    settings = TrainingSettings(**(vars(TINY) | {"steps": 40, "rate": 5e-3}))
    model = train(scenes, tmp_path / "run", cache, settings)
    with (tmp_path / "run" / CURVE).open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert [int(row["step"]) for row in rows] == list(range(2, 41, 2))
    losses = [float(row["loss"]) for row in rows]
    assert np.mean(losses[-5:]) < np.mean(losses[:5])
    network = load_extrapolator(model, 1, "cpu")
    pictures = {name: p[0].numpy() for name, p in example(40, 50).items() if name != TIME}
    answer = network(NetworkInputs(**pictures, time=0.5))
    assert answer.shape == (3, 40, 50)


def test_a_broken_training_goes_on_to_the_same_weights(
    scenes, cache, tmp_path, monkeypatch, unexported
):
    train(scenes, tmp_path / "whole", cache)
    learn, count = Training._learn, []

    def breaks(self, batch):
        count.append(1)
        if len(count) == 4:
            raise KeyboardInterrupt
        return learn(self, batch)

    monkeypatch.setattr(Training, "_learn", breaks)
    with pytest.raises(KeyboardInterrupt):
        train(scenes, tmp_path / "broken", cache)
    monkeypatch.setattr(Training, "_learn", learn)
    train(scenes, tmp_path / "broken", cache)
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "broken"))
    with (tmp_path / "broken" / CURVE).open() as file:
        assert [int(row["step"]) for row in csv.DictReader(file)] == [2, 4, 6]


def test_another_seed_makes_another_network(scenes, cache, tmp_path, unexported):
    train(scenes, tmp_path / "a", cache)
    train(scenes, tmp_path / "b", cache, TrainingSettings(**(vars(TINY) | {"seed": 2})))
    assert not same(weights(tmp_path / "a"), weights(tmp_path / "b"))


def test_a_folder_of_another_training_is_refused(scenes, cache, tmp_path, unexported):
    train(scenes, tmp_path / "a", cache)
    with pytest.raises(UsageError, match="other settings"):
        train(scenes, tmp_path / "a", cache, TrainingSettings(**(vars(TINY) | {"rate": 1e-4})))


def test_scenes_are_held_out_by_name(scenes):
    learnt, held = split(scenes[::-1])
    assert [s.name for s in learnt] == ["first"]
    assert [s.name for s in held] == ["second"]
    with pytest.raises(InputError, match="1 scene to train on"):
        split(scenes[:1])


def test_scenes_are_selected_by_name_and_completeness(data, tmp_path):
    said: list[str] = []
    assert [s.name for s in select(data, (), (), said.append)] == ["first", "second"]
    assert [s.name for s in select(data, ("f*",), (), said.append)] == ["first"]
    assert [s.name for s in select(data, (), ("f*",), said.append)] == ["second"]
    assert said == []
    with pytest.raises(InputError, match="no scene to learn from"):
        select(data, ("third",), (), said.append)
    write_scene(tmp_path / "data" / "benchmark", instants=9)
    write_scene(tmp_path / "data" / "cut", scene="cut", instants=9, role="training")
    (tmp_path / "data" / "cut" / "instants" / "cut.0004.exr").unlink()
    with pytest.raises(InputError, match="no scene to learn from"):
        select(tmp_path / "data", (), (), said.append)
    assert said == ["cut is not rendered to the end and left out"]
