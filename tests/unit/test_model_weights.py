"""Weights beside a model: which files are read, and that no others are."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper, onnx_ml_pb2

from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.models.model_file import NESTED_MESSAGES, embed_weights
from exwarp_cli.models.picture_network import load_extrapolator
from tests.unit.test_models import random_inputs
from tests.unit.tiny_models import convolution, filled_warp, save

GAIN = np.array(0.5, np.float32).tobytes()


def apart(made: onnx.ModelProto, location: str | None, **more: Any) -> onnx.ModelProto:
    """Have a model keep its gain in a file."""
    (gain,) = (tensor for tensor in made.graph.initializer if tensor.name == "gain")
    move(gain, location, **more)
    return made


def move(tensor: TensorProto, location: str | None, **more: Any) -> None:
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    for key, value in {"location": location, **more}.items():
        if value is not None:
            tensor.external_data.add(key=key, value=str(value))


@pytest.fixture
def home(tmp_path) -> Path:
    """A folder for a model, with weights in it and weights beside it."""
    folder = tmp_path / "home"
    folder.mkdir()
    for place in (folder, tmp_path):
        (place / "gain.bin").write_bytes(GAIN)
    return folder


class TestBeside:
    @pytest.mark.parametrize("threads", [1, 2])
    def test_it_is_the_same_network(self, tmp_path, threads):
        """As exporters write it, which keep all in one file."""
        made = convolution()
        whole = load_extrapolator(save(tmp_path / "whole.onnx", made), threads, "cpu")
        options = {"save_as_external_data": True, "location": "w.data", "size_threshold": 0}
        onnx.save(made, str(tmp_path / "parted.onnx"), **options)
        parted = load_extrapolator(tmp_path / "parted.onnx", threads, "cpu")
        taken = random_inputs(37, 61)
        np.testing.assert_array_equal(parted(taken), whole(taken))
        path = tmp_path / "parted.onnx"
        assert embed_weights(path, path.read_bytes())[1] == (tmp_path / "w.data",)

    @pytest.mark.parametrize(
        ("location", "more"),
        [
            ("gain.bin", {}),
            ("./gain.bin", {"length": 4}),
            ("sub/../gain.bin", None),
            ("sub/gain.bin", {"offset": 3, "length": 4, "checksum": "unused"}),
            ("sub/gain.bin", {"offset": 3}),
        ],
    )
    def test_where_it_begins(self, home, location, more):
        (home / "sub").mkdir()
        (home / "sub" / "gain.bin").write_bytes(b"abc" + GAIN)
        path = save(home / "model.onnx", apart(filled_warp(), location, **(more or {})))
        if more is None:
            with pytest.raises(LayoutError):
                load_extrapolator(path, 1, "cpu")
            return
        made, _ = embed_weights(path, path.read_bytes())
        assert made == filled_warp(0.5).SerializeToString()
        assert load_extrapolator(path, 1, "cpu").checksum == hashlib.sha256(made).hexdigest()

    def test_a_cache_of_links(self, home, tmp_path):
        """As Hugging Face's, in which both are links into a folder of blobs."""
        (home / "blob").write_bytes(apart(filled_warp(), "gain.bin").SerializeToString())
        snapshot = tmp_path / "snapshot"
        snapshot.mkdir()
        (snapshot / "model.onnx").symlink_to(home / "blob")
        (snapshot / "gain.bin").symlink_to(home / "gain.bin")
        load_extrapolator(snapshot / "model.onnx", 1, "cpu")

    def test_what_needs_no_other_file_stays_as_it_is(self):
        data = convolution().SerializeToString()
        assert embed_weights(Path("m.onnx"), data)[0] is data


def in_an_attribute(location: str) -> onnx.ModelProto:
    made = filled_warp()
    kept = [tensor for tensor in made.graph.initializer if tensor.name != "gain"]
    (gain,) = (tensor for tensor in made.graph.initializer if tensor.name == "gain")
    move(gain, location)
    node = helper.make_node("Constant", [], ["gain"], value=gain)
    del made.graph.initializer[:]
    made.graph.initializer.extend(kept)
    made.graph.node.insert(0, node)
    return made


def in_a_subgraph(location: str) -> onnx.ModelProto:
    made, inner = filled_warp(), filled_warp().graph
    for tensor in inner.initializer:
        move(tensor, location)
    made.graph.node.append(helper.make_node("If", ["gain"], ["x"], then_branch=inner))
    return made


def in_a_function(location: str) -> onnx.ModelProto:
    made = filled_warp()
    tensor = helper.make_tensor("t", TensorProto.FLOAT, [1], [0.5])
    move(tensor, location)
    nodes = [helper.make_node("Constant", [], ["y"], value=tensor)]
    made.functions.append(helper.make_function("own", "F", [], ["y"], nodes, []))
    return made


def in_a_sparse_tensor(location: str) -> onnx.ModelProto:
    made = filled_warp()
    sparse = made.graph.sparse_initializer.add()
    move(sparse.values, location)
    return made


def in_training(location: str) -> onnx.ModelProto:
    made = filled_warp()
    move(made.training_info.add().algorithm.initializer.add(), location)
    return made


PLACES = [in_an_attribute, in_a_subgraph, in_a_function, in_a_sparse_tensor, in_training]


class TestElsewhere:
    @pytest.mark.parametrize(
        "location",
        ["../gain.bin", "sub/../../gain.bin", "ABSOLUTE", "link.bin", "sub/gain.bin", "", "a\0b",
         "..\\gain.bin", "C:\\gain.bin", "\\\\host\\gain.bin", "/dev/zero", "loop.bin", None],
    )  # fmt: skip
    def test_files_outside_of_the_folder_are_not_opened(self, home, tmp_path, location):
        (home / "link.bin").symlink_to("../gain.bin")
        (home / "loop.bin").symlink_to("loop.bin")
        (home / "sub").symlink_to(tmp_path)
        named = str(tmp_path / "gain.bin") if location == "ABSOLUTE" else location
        path = save(home / "model.onnx", apart(filled_warp(), named))
        with pytest.raises(LayoutError, match="only files in the folder of a model are read"):
            load_extrapolator(path, 1, "cpu")

    def test_nor_are_those_of_the_current_folder(self, home, tmp_path, monkeypatch):
        options = {"save_as_external_data": True, "location": "w.data", "size_threshold": 0}
        onnx.save(convolution(), str(home / "model.onnx"), **options)
        (home / "w.data").rename(tmp_path / "w.data")
        monkeypatch.chdir(tmp_path)
        with pytest.raises(InputError, match=r"keeps weights in .*w\.data, which cannot be read"):
            load_extrapolator(home / "model.onnx", 1, "cpu")

    @pytest.mark.parametrize("build", PLACES)
    def test_wherever_a_model_may_have_a_tensor(self, home, build: Callable[..., Any]):
        path = home / "model.onnx"
        with pytest.raises(LayoutError, match="only files in the folder"):
            embed_weights(path, build("../gain.bin").SerializeToString())
        data, _ = embed_weights(path, build("gain.bin").SerializeToString())
        made = onnx.load_from_string(data)
        assert b"gain.bin" not in made.SerializeToString()

    def test_onnx_has_tensors_nowhere_else(self):
        messages = onnx_ml_pb2.DESCRIPTOR.message_types_by_name
        holds = {"TensorProto"}
        inside: dict[str, dict[int, str]] = {}
        while True:
            inside = {
                name: found
                for name, message in messages.items()
                if (found := {
                    f.number: f.message_type.name
                    for f in message.fields
                    if f.message_type is not None and f.message_type.name in holds
                })
            }  # fmt: skip
            if set(inside) <= holds:
                break
            holds |= set(inside)
        assert inside == NESTED_MESSAGES


class TestDamage:
    @pytest.mark.parametrize(
        ("more", "words"),
        [
            ({"offset": 1, "length": 4}, "has 4 bytes and should have 5"),
            ({"length": 1 << 50}, "has 4 bytes"),
            ({"offset": 1 << 50}, "has 4 bytes"),
            ({"offset": -4}, "offset '-4'"),
            ({"length": "9" * 400}, "no number of bytes"),
            ({"length": "٤"}, "no number of bytes"),
        ],
    )
    def test_numbers_that_cannot_be(self, home, more, words):
        path = save(home / "model.onnx", apart(filled_warp(), "gain.bin", **more))
        with pytest.raises(DamagedFileError, match=words):
            load_extrapolator(path, 1, "cpu")

    @pytest.mark.parametrize("kind", ["folder", "pipe"])
    def test_what_is_no_file(self, home, kind):
        (home / "w").mkdir() if kind == "folder" else os.mkfifo(home / "w")
        path = save(home / "model.onnx", apart(filled_warp(), "w"))
        with pytest.raises(InputError, match="which cannot be read"):
            load_extrapolator(path, 1, "cpu")

    def test_much_in_little(self, home):
        """A small model may name a large file a thousand times."""
        with (home / "large.bin").open("wb") as file:
            file.truncate(1 << 25)
        made = filled_warp()
        for _ in range(65):
            move(made.graph.initializer.add(), "large.bin")
        with pytest.raises(LayoutError, match="more than 2 GiB of weights"):
            embed_weights(home / "model.onnx", made.SerializeToString())

    def test_messages_in_each_other(self):
        data = b""
        for _ in range(200):
            for number in (6, 5, 1):  # a graph in an attribute of a node of a graph
                size = len(data)
                head = bytes([number << 3 | 2, size & 0x7F | 0x80, size >> 7])
                data = head + data
        size = len(data)
        whole = bytes([7 << 3 | 2, size & 0x7F | 0x80, size >> 7]) + data
        with pytest.raises(DamagedFileError, match="nested too deeply"):
            embed_weights(Path("m.onnx"), whole)

    def test_a_value_that_is_cut_to_32_bits(self):
        """Readers of Protocol Buffers take 2^32 + 1 for 1."""
        tensor = bytes([14 << 3, 0x81, 0x80, 0x80, 0x80, 0x10])
        graph = bytes([5 << 3 | 2, len(tensor)]) + tensor
        with pytest.raises(LayoutError, match="only files"):
            embed_weights(Path("m.onnx"), bytes([7 << 3 | 2, len(graph)]) + graph)

    @given(st.integers(0, 10**6), st.integers(0, 7), st.booleans())
    def test_bytes_that_are_damaged(self, at, bit, cut):
        data = bytearray(apart(filled_warp(), "../x").SerializeToString())
        data[at % len(data)] ^= 1 << bit
        if cut:
            del data[at % len(data) :]
        try:
            embed_weights(Path("m.onnx"), bytes(data))
        except InputError as error:
            assert "m.onnx" in str(error)

    @given(st.binary(max_size=200))
    def test_any_bytes(self, data):
        try:
            embed_weights(Path("m.onnx"), data)
        except InputError as error:
            assert "m.onnx" in str(error)
