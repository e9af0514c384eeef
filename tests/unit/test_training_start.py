"""Training that begins with the weights of another one."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.training.extrapolator import CHECKPOINT, Training
from exwarp_cli.training.settings import TrainingSettings
from tests.unit.network_inputs import example

TINY = TrainingSettings(architecture="blend", width=4, steps=4)


def said(_line: str) -> None: ...


def trained(folder, settings: TrainingSettings = TINY) -> Training:
    made = Training(folder, settings, said)
    made._save()
    return made


def weights(training: Training) -> torch.Tensor:
    return torch.cat([p.flatten() for p in training.average.parameters()])


def test_it_begins_with_the_average_of_the_other(tmp_path):
    other = trained(tmp_path / "a")
    made = Training(tmp_path / "b", replace(TINY, seed=5), said)
    assert not torch.equal(weights(made), weights(other))
    made.begin_with(tmp_path / "a" / CHECKPOINT)
    assert torch.equal(weights(made), weights(other))
    assert made.step == 0


def test_one_that_is_under_way_goes_on(tmp_path):
    trained(tmp_path / "a")
    made = Training(tmp_path / "b", replace(TINY, seed=5), said)
    before, made.step = weights(made), 3
    made.begin_with(tmp_path / "a" / CHECKPOINT)
    assert torch.equal(weights(made), before)


def test_it_may_be_larger(tmp_path):
    other = trained(tmp_path / "a")
    made = Training(tmp_path / "b", replace(TINY, width=8), said)
    made.begin_with(tmp_path / "a" / CHECKPOINT)
    given = example(16, 16)
    found, expected = (t.average.eval()(**given) for t in (made, other))
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("changed", [{"width": 8}, {"architecture": "blend-detail"}])
def test_another_network_is_refused(tmp_path, changed):
    trained(tmp_path / "a", replace(TINY, **changed))
    made = Training(tmp_path / "b", TINY, said)
    with pytest.raises(LayoutError, match="holds another network than blend or a smaller one"):
        made.begin_with(tmp_path / "a" / CHECKPOINT)


@pytest.mark.parametrize("content", [b"", b"PK junk", None])
def test_what_is_no_checkpoint_is_refused(tmp_path, content):
    path = tmp_path / "wrong.pt"
    if content is None:
        torch.save([1, 2], path)
    else:
        path.write_bytes(content)
    made = Training(tmp_path / "b", TINY, said)
    with pytest.raises(DamagedFileError, match=r"wrong\.pt is damaged, or no checkpoint"):
        made.begin_with(path)
    with pytest.raises(InputError, match=r"cannot read .*none\.pt"):
        made.begin_with(tmp_path / "none.pt")
