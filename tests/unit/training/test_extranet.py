"""ExtraNet's architecture against a plain twin, its inputs, and its checkpoint as a model."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from exwarp_cli.domain.network_api import EXTRAPOLATOR_INTERFACE, NetworkPictures
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.models.picture_network import load_extrapolator
from exwarp_cli.research.training.extranet_import import (
    ExtraNet,
    ExtraNetAdapter,
    ReleasedGate,
    import_extranet,
    read_extranet,
)
from tests.reference import extranet as reference
from tests.unit.training.extranet_checkpoint import checkpoint, save, shapes, state


def inputs(height: int, width: int, seed: int = 3) -> dict[str, np.ndarray]:
    """Inputs [C, H, W] as they are for a frame with sky above and holes."""
    rng = np.random.default_rng(seed)
    size = (height, width)
    planes = {
        name: rng.standard_normal((n, *size), np.float32)
        for name, n in EXTRAPOLATOR_INTERFACE.inputs.items()
    }
    planes["mask"] = (rng.random((1, *size)) > 0.2).astype(np.float32)
    planes["history"][3::4] = rng.random((3, *size)) > 0.3
    distance = 10 * rng.random(size, np.float32) + 0.5
    planes["features"][3] = distance / (distance + np.median(distance))
    planes["features"][4:] = rng.random((2, *size))
    planes["features"][:4, : height // 3] = np.array([0, 0, 0, 1])[:, None, None]
    return planes


def batch(planes: dict[str, np.ndarray]) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(array)[None] for name, array in planes.items()}


@pytest.fixture(scope="module")
def network() -> ExtraNet:
    made = ExtraNet()
    made.load_state_dict(state(), strict=True)
    return made.eval()


@pytest.fixture(scope="module")
def adapter(network) -> ExtraNetAdapter:
    return ExtraNetAdapter(network).eval()


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("extranet")
    import_extranet(checkpoint(folder / "ours.pth.tar"), folder / "e.onnx", overwrite=False)
    return folder / "e.onnx"


def answer(module: torch.nn.Module, planes: dict[str, np.ndarray]) -> np.ndarray:
    with torch.no_grad():
        return module(**batch(planes))[0].numpy()


class TestNetwork:
    def test_it_has_the_tensors_of_the_release(self):
        made = ExtraNet()
        assert {name: tuple(t.shape) for name, t in made.state_dict().items()} == shapes()
        assert sum(weights.numel() for weights in made.parameters()) == 262_141
        assert sum(statistics.numel() for statistics in made.buffers()) == 1_359

    def test_it_is_its_twin(self, network):
        given = inputs(24, 40)
        pictures, mask, features = given["warped"], given["mask"], given["features"]
        history = list(given["history"].reshape(3, 4, 24, 40))
        tensors = [torch.from_numpy(array)[None] for array in (pictures, mask, features)]
        with torch.no_grad():
            ours = network(*tensors, [torch.from_numpy(frame)[None] for frame in history])
        arrays = {name: tensor.double().numpy() for name, tensor in state().items()}
        twin = reference.extranet(pictures, mask, features, history, arrays)
        assert np.abs(twin - pictures[:3]).max() > 0.5  # the layers do tell something
        np.testing.assert_allclose(ours[0].numpy(), twin, atol=1e-4)

    def test_a_gate_weighs_all_features_alike(self):
        layer = ReleasedGate(1, 2)
        for weights in layer.parameters():
            torch.nn.init.zeros_(weights)
        layer.conv_feature.bias.data = torch.tensor([1.0, -2.0])
        layer.conv_mask[0].bias.data = torch.tensor([3.0]).log()
        out = layer(torch.zeros(1, 1, 4, 4))
        assert out[0, :, 1, 1].tolist() == pytest.approx([0.75, -1.5])


def translated(ours: torch.Tensor) -> torch.Tensor:
    """What the adapter gives to the released network of our features, [1, 6, H, W]."""
    given = []

    def network(pictures: torch.Tensor, mask: object, features: torch.Tensor, history: object):
        given.append(features)
        return pictures[:, :3]

    plane = torch.zeros(1, 1, *ours.shape[2:])
    adapter = ExtraNetAdapter(network)  # type: ignore[arg-type]
    adapter(plane.repeat(1, 6, 1, 1), plane, ours, plane.repeat(1, 12, 1, 1))
    return given[0]


class TestAdapter:
    def test_inputs_are_translated(self, network, adapter):
        given = inputs(16, 24)
        near = np.maximum(given["history"], 0).reshape(3, 4, 16, 24)
        features = given["features"].copy()
        shown = features[3] < 1
        features[:3, ~shown] = -1
        distance = np.where(shown, features[3] / np.where(shown, 1 - features[3], 1), 0)
        features[3] = distance / distance.max()
        pictures = np.concatenate([near[0, :3], np.maximum(given["warped"][3:], 0)])
        arrays = {name: tensor.double().numpy() for name, tensor in state().items()}
        twin = reference.extranet(pictures, given["mask"], features, list(near[::-1]), arrays)
        np.testing.assert_allclose(answer(adapter, given), np.maximum(twin, 0), atol=1e-4)

    def test_distances_are_scaled_over_the_frame(self):
        distance = torch.tensor([1.0, 2.0, 3.0, 5.0])
        ours = torch.zeros(1, 6, 1, 4)
        ours[0, 3] = distance / (distance + 2.5)
        assert translated(ours)[0, 3, 0].tolist() == pytest.approx([0, 0.25, 0.5, 1], abs=1e-5)
        ours[0, 3, 0, 1] = 1  # background comes to lie before all else
        assert translated(ours)[0, 3, 0].tolist() == pytest.approx([0.2, 0, 0.6, 1], abs=1e-5)

    @pytest.mark.parametrize("depth", [0.5, 1.0])
    def test_a_frame_of_one_depth_is_at_0(self, depth):
        ours = torch.full((1, 6, 2, 2), depth)
        assert translated(ours)[0, 3].tolist() == [[0, 0], [0, 0]]

    def test_what_is_unknown_looks_like_sky(self):
        ours = torch.zeros(1, 6, 1, 2)
        ours[0, :3, 0, 1] = torch.tensor([0.0, 0.0, 1.0])
        assert translated(ours)[0, :3, 0].T.tolist() == [[-1, -1, -1], [0, 0, 1]]


class TestModel:
    def test_it_says_what_it_is(self, model):
        facts = {fact.key: fact.value for fact in onnx.load(model).metadata_props}
        assert facts == {
            "exwarp.interface": "exwarp.extrapolator/1",
            "exwarp.stride": "8",
            "exwarp.about": "ExtraNet (Guo et al. 2021), imported from ours.pth.tar",
        }

    @pytest.mark.parametrize(("height", "width"), [(8, 8), (40, 56), (37, 51)])
    def test_it_runs_as_the_network_does(self, model, adapter, height, width):
        given = inputs(height, width)
        ours = load_extrapolator(model, 1, "cpu")(NetworkPictures(given, 0.5))
        edges = ((0, 0), (0, -height % 8), (0, -width % 8))
        whole = {name: np.pad(array, edges, mode="edge") for name, array in given.items()}
        expected = answer(adapter, whole)[:, :height, :width]
        assert ours.shape == (3, height, width)
        np.testing.assert_allclose(ours, expected, atol=1e-4)


class TestCheckpoint:
    def refuse(self, path, tensors, words):
        with pytest.raises(LayoutError, match=words):
            read_extranet(checkpoint(path, tensors))

    def test_it_is_read_with_and_without_what_is_around(self, tmp_path):
        plain, wrapped = state(), {f"module.{name}": tensor for name, tensor in state().items()}
        files = (
            checkpoint(tmp_path / "a.pth.tar"),
            checkpoint(tmp_path / "b.pth.tar", wrapped),
            save(tmp_path / "c.pkl", plain),
        )
        for path in files:
            network = read_extranet(path)
            assert not network.training
            assert all(torch.equal(t, plain[name]) for name, t in network.state_dict().items())

    def test_old_files_are_read(self, tmp_path):
        torch.save(state(), tmp_path / "old.pth", _use_new_zipfile_serialization=False)
        assert torch.equal(read_extranet(tmp_path / "old.pth").outc.bias, state()["outc.bias"])

    def test_a_missing_file(self, tmp_path):
        with pytest.raises(InputError, match=r"cannot read .*none\.tar: No such file"):
            read_extranet(tmp_path / "none.tar")
        with pytest.raises(InputError, match=r"cannot read .*: Is a directory"):
            read_extranet(tmp_path)

    def test_missing_tensors(self, tmp_path):
        tensors = state()
        del tensors["bn1.weight"], tensors["outc.bias"]
        self.refuse(tmp_path / "a", tensors, r"a lacks bn1\.weight and 1 more; give")

    def test_foreign_tensors(self, tmp_path):
        tensors = state() | {"fc.weight": torch.zeros(1)}
        self.refuse(tmp_path / "a", tensors, r"that ExtraNet has not: fc\.weight; give")

    def test_other_shapes(self, tmp_path):
        tensors = state() | {"conv1.conv_feature.weight": torch.zeros(24, 15, 3, 3)}
        self.refuse(tmp_path / "a", tensors, r"another shape of conv1\.conv_feature\.weight; give")

    def test_values_that_are_none(self, tmp_path):
        tensors = state() | {"outc.bias": torch.full((3,), torch.nan)}
        self.refuse(tmp_path / "a", tensors, r"not finite in outc\.bias; give")

    @pytest.mark.parametrize("content", [torch.zeros(3), [1], {"state_dict": 1}])
    def test_something_else(self, tmp_path, content):
        with pytest.raises(LayoutError, match="holds no state dict; give the file"):
            read_extranet(save(tmp_path / "a", content))

    @pytest.mark.parametrize("keep", [0, 1, 100, 10_000, 600_000, -1])
    def test_a_damaged_file(self, tmp_path, keep):
        whole = checkpoint(tmp_path / "a").read_bytes()
        (tmp_path / "b").write_bytes(whole[:keep])
        with pytest.raises(DamagedFileError, match="b is damaged, is no PyTorch checkpoint"):
            read_extranet(tmp_path / "b")

    def test_code_is_not_run(self, tmp_path):
        content = {"state_dict": state(), "hook": _Trap(tmp_path / "ran")}
        with pytest.raises(DamagedFileError, match="more than tensors"):
            read_extranet(save(tmp_path / "a", content))
        assert not (tmp_path / "ran").exists()


class _Trap:
    """Touches a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_footage_needs_no_torch():
    code = (
        "import sys\n"
        "from exwarp_cli.research.training import scene_clip, training_settings\n"
        "print(sorted({'torch', 'onnx', 'onnxruntime'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
