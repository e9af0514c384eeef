"""Training that begins with the weights of another one."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.research.training.extrapolation_network import STRIDE
from exwarp_cli.research.training.extrapolator_training import (
    MODEL,
    ExtrapolatorTraining,
    set_statistics,
)
from exwarp_cli.research.training.onnx_export import export_extrapolator
from exwarp_cli.research.training.resumable_training import CHECKPOINT
from exwarp_cli.research.training.training_settings import ExtrapolatorSettings
from tests.unit.network_inputs import example

TINY = ExtrapolatorSettings(architecture="blend", width=4, steps=4)


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
    def other(tmp_path_factory) -> ExtrapolatorTraining:
        """One whose layers have seen batches; read only, as its export takes long."""
        made = ExtrapolatorTraining(tmp_path_factory.mktemp("other") / "other", TINY, said)
        made.average.train()
        with torch.no_grad():
            for seed in range(4):
                made.average(**{name: 2 * part for name, part in example(32, 32, seed).items()})
        export_extrapolator(made.average, made.folder / MODEL, stride=STRIDE, about="a test")
        return made

    @pytest.fixture
    def begun(self, other, tmp_path) -> ExtrapolatorTraining:
        made = ExtrapolatorTraining(tmp_path / "b", replace(TINY, seed=5), said)
        made.begin_with(other.folder / MODEL)
        return made

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
        made = ExtrapolatorTraining(tmp_path / "b", replace(TINY, width=8), said)
        with pytest.raises(LayoutError, match="holds another network than blend"):
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
