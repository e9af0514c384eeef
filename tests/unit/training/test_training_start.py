"""Training that begins with the weights of another one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
import torch

from exwarp_cli.domain.network_api import TIME_INPUT, NetworkPictures
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.models.picture_network import load_extrapolator
from exwarp_cli.research.training.extrapolation_network import ARCHITECTURES, STRIDE, Architecture
from exwarp_cli.research.training.extrapolator_training import (
    MODEL,
    ExtrapolatorTraining,
    set_statistics,
)
from exwarp_cli.research.training.resumable_training import CHECKPOINT
from exwarp_cli.research.training.training_settings import ExtrapolatorSettings
from tests.unit.training.network_inputs import example

TINY = ExtrapolatorSettings(architecture="blend", width=4, steps=4)
SMALL = replace(TINY, architecture="small", scenes={"training": []})


def said(_line: str) -> None: ...


def trained(folder, settings: ExtrapolatorSettings = TINY) -> ExtrapolatorTraining:
    made = ExtrapolatorTraining(folder, settings, said)
    made._save()
    return made


def weights(training: ExtrapolatorTraining) -> torch.Tensor:
    return torch.cat([p.flatten() for p in training.average.parameters()])


def test_it_begins_with_the_average_of_the_other(tmp_path):
    other = trained(tmp_path / "a")
    made = ExtrapolatorTraining(tmp_path / "b", replace(TINY, seed=5), said)
    assert not torch.equal(weights(made), weights(other))
    made.begin_with(tmp_path / "a" / CHECKPOINT)
    assert torch.equal(weights(made), weights(other))
    assert made.step == 0


def test_one_that_is_under_way_goes_on(tmp_path):
    trained(tmp_path / "a")
    made = ExtrapolatorTraining(tmp_path / "b", replace(TINY, seed=5), said)
    before, made.step = weights(made), 3
    made.begin_with(tmp_path / "a" / CHECKPOINT)
    assert torch.equal(weights(made), before)


def test_it_may_be_larger(tmp_path):
    other = trained(tmp_path / "a")
    made = ExtrapolatorTraining(tmp_path / "b", replace(TINY, width=8), said)
    made.begin_with(tmp_path / "a" / CHECKPOINT)
    given = example(16, 16)
    found, expected = (t.average.eval()(**given) for t in (made, other))
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("changed", [{"width": 8}, {"architecture": "blend-detail"}])
def test_another_network_is_refused(tmp_path, changed):
    trained(tmp_path / "a", replace(TINY, **changed))
    made = ExtrapolatorTraining(tmp_path / "b", TINY, said)
    with pytest.raises(LayoutError, match="holds another network than blend or a smaller one"):
        made.begin_with(tmp_path / "a" / CHECKPOINT)


class TestModel:
    """A network that begins with an exported one, in which normalisation is folded."""

    @pytest.fixture(scope="class")
    @staticmethod
    def other(tmp_path_factory) -> Iterator[ExtrapolatorTraining]:
        """One whose layers have seen batches; read only, as its export takes long.

        It has all parts of the network that is shipped, and few layers.
        """
        few: dict[str, Any] = {"growth": (1,), "taps": (1, 0, 0), "blurs": (3,), "detail": 4}
        with pytest.MonkeyPatch.context() as patch:
            small = replace(ARCHITECTURES["kernels-light"], **few)
            patch.setitem(cast(dict[str, Architecture], ARCHITECTURES), "small", small)
            made = ExtrapolatorTraining(tmp_path_factory.mktemp("other") / "other", SMALL, said)
            made.average.train()
            with torch.no_grad():
                for parameter in made.average.parameters():
                    parameter.add_(0.05 * torch.randn_like(parameter))
                for seed in range(4):
                    made.average(**{name: 2 * part for name, part in example(32, 32, seed).items()})
            assert made.export() == made.folder / MODEL
            yield made

    @pytest.fixture
    def begun(self, other, tmp_path) -> ExtrapolatorTraining:
        made = ExtrapolatorTraining(tmp_path / "b", replace(SMALL, seed=5), said)
        made.begin_with(other.folder / MODEL)
        return made

    @pytest.mark.parametrize(("height", "width"), [(16, 32), (60, 107)])
    def test_the_model_answers_as_the_network(self, other, height, width):
        """Rows and columns up to the next multiple of the stride repeat the edge."""
        given = example(height, width)
        pictures = {name: p[0].numpy() for name, p in given.items() if name != TIME_INPUT}
        around = ((0, 0), (0, -height % STRIDE), (0, -width % STRIDE))
        padded = {
            name: torch.from_numpy(np.pad(picture, around, mode="edge"))[None]
            for name, picture in pictures.items()
        }
        with torch.no_grad():
            expected = other.average.eval()(**padded, time=given[TIME_INPUT])[0].numpy()
        found = load_extrapolator(other.folder / MODEL, 1, "cpu")(NetworkPictures(pictures, 0.5))
        np.testing.assert_allclose(found, expected[:, :height, :width], atol=1e-4)
        assert np.abs(found - pictures["warped"][3:]).mean() > 0.01, "the network does something"

    def test_it_answers_as_the_model_does(self, other, begun):
        given = example(32, 32)
        found, expected = begun.network.eval()(**given), other.average.eval()(**given)
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)

    def test_it_still_does_once_layers_normalise_by_batches(self, other, begun):
        batches = [Given(example(32, 32, seed)) for seed in (7, 8)]
        set_statistics(begun.network, batches)
        given = example(32, 32, 7)
        found, expected = begun.network.eval()(**given), other.average.eval()(**given)
        torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-4)
        norm = begun.network.net.first.norm
        seen = []
        norm.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
        for batch in batches:
            begun.network(*batch.inputs)
        torch.testing.assert_close(
            norm.running_mean, torch.cat(seen).mean((0, 2, 3)), rtol=1e-3, atol=1e-4
        )

    def test_another_network_is_refused(self, other, tmp_path):
        made = ExtrapolatorTraining(tmp_path / "b", replace(SMALL, width=8), said)
        with pytest.raises(LayoutError, match="holds another network than small"):
            made.begin_with(other.folder / MODEL)

    def test_what_is_no_model_is_refused(self, tmp_path):
        made, path = ExtrapolatorTraining(tmp_path / "b", TINY, said), tmp_path / "wrong.onnx"
        path.write_bytes(b"junk")
        with pytest.raises(DamagedFileError, match=r"wrong\.onnx is no ONNX model"):
            made.begin_with(path)
        with pytest.raises(InputError, match=r"cannot read .*none\.onnx"):
            made.begin_with(tmp_path / "none.onnx")


class Given:
    """A batch as the network is given it."""

    def __init__(self, parts: dict[str, torch.Tensor]) -> None:
        self.inputs = tuple(parts.values())


@pytest.mark.parametrize("content", [b"", b"PK junk", None])
def test_what_is_no_checkpoint_is_refused(tmp_path, content):
    path = tmp_path / "wrong.pt"
    if content is None:
        torch.save([1, 2], path)
    else:
        path.write_bytes(content)
    made = ExtrapolatorTraining(tmp_path / "b", TINY, said)
    with pytest.raises(DamagedFileError, match=r"wrong\.pt is damaged, or no checkpoint"):
        made.begin_with(path)
    with pytest.raises(InputError, match=r"cannot read .*none\.pt"):
        made.begin_with(tmp_path / "none.pt")
