"""Networks of torch as ONNX models: what is written, and that it does the same."""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from torch import nn
from torch.nn import functional as F

from exwarp_cli.domain.network_api import EXTRAPOLATOR_INTERFACE, NetworkPictures
from exwarp_cli.errors import OutputError
from exwarp_cli.models.picture_network import load_extrapolator
from exwarp_cli.research.training.onnx_export import export_network

export_extrapolator = partial(export_network, interface=EXTRAPOLATOR_INTERFACE)


class Small(nn.Module):
    """What networks are made of, at half the size."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(5)
        self.coarse = nn.Conv2d(26, 8, 3, stride=2, padding=1, padding_mode="replicate")
        self.norm, self.batch = nn.InstanceNorm2d(8, affine=True), nn.BatchNorm2d(8)
        self.shuffled = nn.Conv2d(8, 12, 1)
        self.out = nn.Conv2d(8, 3, 1)
        self.drop = nn.Dropout(0.5)

    def forward(self, time, history, features, mask, warped):  # in an order of its own
        when = time.reshape(1, 1, 1, 1).expand_as(mask)
        x = torch.cat([warped, mask, features, history, when], dim=1)
        x = self.batch(F.leaky_relu(self.norm(self.coarse(x))))
        x = x + F.interpolate(F.avg_pool2d(x, 2), x.shape[2:], mode="bilinear")
        y = F.pixel_shuffle(self.shuffled(F.max_pool2d(x, 3, 1, 1)), 2)
        x = F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)
        x = F.grid_sample(x, self.grid(x, y), padding_mode="border", align_corners=False)
        return warped[:, 3:] + self.drop(self.out(x) - x.amax((2, 3), keepdim=True)[:, :3])

    def grid(self, x, shift):
        height, width = x.shape[2:]
        across = (torch.arange(width) * 2 + 1) / width - 1
        along = (torch.arange(height) * 2 + 1) / height - 1
        grid = torch.stack([across.expand(height, width), along[:, None].expand(height, width)])
        return (grid + 0.01 * shift[0, :2]).permute(1, 2, 0)[None]


class Filled(nn.Module):
    """Do with two inputs, and give the filled warp in holes."""

    def forward(self, warped, mask):
        return warped[:, :3] + warped[:, 3:] * (1 - mask)


class Normed(nn.Module):
    """One that differs between training and use."""

    def __init__(self) -> None:
        super().__init__()
        self.norm, self.drop = nn.BatchNorm2d(3), nn.Dropout(0.5)

    def forward(self, warped, mask):
        return self.drop(self.norm(warped[:, :3])) * mask


class Foreign(nn.Module):
    def forward(self, warped, mask, colour):
        return warped[:, :3]


class Maskless(nn.Module):
    def forward(self, warped):
        return warped[:, :3]


class Coarse(nn.Module):
    def forward(self, warped, mask):
        return warped[:, :3, ::2, ::2] * mask[..., ::2, ::2]


class Fixed(nn.Module):
    """Tied to the size that it is traced with."""

    def forward(self, warped, mask):
        ramp = torch.linspace(0, 1, warped.shape[3])
        return warped[:, :3] * mask * ramp


def given(height: int, width: int) -> NetworkPictures:
    rng = np.random.default_rng(9)
    planes = {
        name: rng.random((n, height, width), np.float32)
        for name, n in EXTRAPOLATOR_INTERFACE.inputs.items()
    }
    return NetworkPictures(planes, 0.75)


def answer(module: nn.Module, inputs: NetworkPictures, names: tuple[str, ...]) -> np.ndarray:
    tensors = {name: torch.from_numpy(array)[None] for name, array in inputs.pictures.items()}
    tensors["time"] = torch.tensor([inputs.time])
    with torch.no_grad():
        return module(**{name: tensors[name] for name in names})[0].numpy()


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("small") / "small.onnx"
    export_extrapolator(Small(), path, stride=4, about="a small one")
    return path


@pytest.mark.parametrize(("height", "width"), [(8, 12), (48, 36), (132, 200)])
def test_the_model_does_what_the_network_does(small, height, width):
    inputs = given(height, width)
    expected = answer(Small().eval(), inputs, (*EXTRAPOLATOR_INTERFACE.inputs, "time"))
    np.testing.assert_allclose(load_extrapolator(small, 1, "cpu")(inputs), expected, atol=1e-4)


def test_the_model_holds_nothing_but_the_network(small):
    model = onnx.load(small, load_external_data=False)
    assert [node.name for node in model.graph.input] == [
        "time", "history", "features", "mask", "warped",
    ]  # fmt: skip
    sizes = [
        dim.dim_param or dim.dim_value for dim in model.graph.output[0].type.tensor_type.shape.dim
    ]
    assert [node.name for node in model.graph.output] == ["colour"]
    assert sizes == [1, 3, "height", "width"]
    assert {fact.key: fact.value for fact in model.metadata_props} == {
        "exwarp.interface": "exwarp.extrapolator/1",
        "exwarp.stride": "4",
        "exwarp.about": "a small one",
    }
    assert [opset.domain for opset in model.opset_import] == [""]
    assert str(Path(__file__).parent).encode() not in small.read_bytes()
    assert list(small.parent.iterdir()) == [small]


def test_inputs_may_be_left_out_and_the_stride_be_1(tmp_path):
    export_extrapolator(Filled(), tmp_path / "f.onnx", stride=1, about="")
    inputs = given(5, 7)
    found = load_extrapolator(tmp_path / "f.onnx", 1, "cpu")(inputs)
    np.testing.assert_allclose(found, answer(Filled(), inputs, ("warped", "mask")), atol=1e-6)


def test_once_more_the_same_bytes_in_silence_from_a_network_that_stays_as_it_was(tmp_path, capfd):
    network, level = Normed().train(), logging.getLogger("torch.onnx").level
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    for name in ("once", "again"):
        export_extrapolator(network, tmp_path / name, stride=4, about="a small one")
    assert (tmp_path / "again").read_bytes() == (tmp_path / "once").read_bytes()
    assert network.training and network.norm.training
    assert all(torch.equal(t, before[name]) for name, t in network.state_dict().items())
    assert logging.getLogger("torch.onnx").level == level
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("network", "words"),
    [
        (
            Foreign(),
            "takes warped, mask, colour; it must take warped and mask, and may take others",
        ),
        (Maskless(), "forward takes warped; it must take warped and mask"),
        (Coarse(), r"returns torch.float32 \[1, 3, 32, 36\] for 64 rows of 72 pixels"),
    ],
)
def test_what_does_not_fit_the_interface_is_refused(tmp_path, network, words):
    with pytest.raises(ValueError, match=words):
        export_extrapolator(network, tmp_path / "a.onnx", stride=8, about="")
    assert list(tmp_path.iterdir()) == []


def test_a_network_of_one_size_is_refused(tmp_path):
    with pytest.raises(torch._dynamo.exc.UserError, match="specialized it to be a constant"):
        export_extrapolator(Fixed(), tmp_path / "a.onnx", stride=8, about="")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(OutputError, match="the folder does not exist"):
        export_extrapolator(Filled(), tmp_path / "no" / "f.onnx", stride=1, about="")
