"""Cutting pictures into tiles, and how far networks see."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import helper

from exwarp_cli.domain.extrapolator import INPUTS, OUTPUT, NetworkInputs, cut
from exwarp_cli.io import models
from exwarp_cli.io.models import OnnxExtrapolator, load_extrapolator, reach_of
from tests.unit.tiny_models import blur, convolution, filled_warp, inputs, model, save

STRIDE = 8
TINY = 4096
"""Pixels of a tile in these tests."""


@given(
    st.tuples(st.integers(1, 60), st.integers(1, 60)),
    st.sampled_from([1, 8, 16]),
    st.integers(0, 100),
    st.integers(256, 60000),
)
def test_tiles_cover_each_pixel_once_and_keep_off_borders_inside(cells, stride, seen, most):
    size = (cells[0] * stride, cells[1] * stride)
    count = np.zeros(size, int)
    tiles = cut(size, stride, seen, most)
    for tile in tiles:
        count[tile[0].kept, tile[1].kept] += 1
        for span, length in zip(tile, size, strict=True):
            assert span.begin % stride == span.end % stride == 0
            assert 0 <= span.begin <= span.first < span.last <= span.end <= length
            assert span.begin == span.first == 0 or span.first - span.begin >= seen
            assert span.end == span.last == length or span.end - span.last >= seen
    assert (count == 1).all()
    assert len({tuple(s.end - s.begin for s in tile) for tile in tiles}) == 1


@pytest.mark.parametrize("size", [(1088, 1920), (2160, 3840), (4320, 7680)])
@pytest.mark.parametrize("most", [2**19, 2**20])
def test_tiles_of_large_frames_fit_and_cost_little_more(size, most):
    tiles = cut(size, 16, 80, most)
    pixels = [(row.end - row.begin) * (column.end - column.begin) for row, column in tiles]
    assert max(pixels) <= most
    assert sum(pixels) <= 1.65 * size[0] * size[1]


def test_a_picture_that_fits_is_one_tile():
    assert len(cut((480, 864), 16, 80, 2**20)) == 1


def _shifted(pictures: Mapping[str, np.ndarray], by: int) -> np.ndarray:
    """Answer with the sum of a picture and itself moved, which leaves 0 behind."""
    colour = pictures["warped"][:3]
    width = colour.shape[2]
    moved = np.zeros_like(colour)
    moved[..., max(by, 0) : width + min(by, 0)] = colour[..., max(-by, 0) : width - max(by, 0)]
    return colour + moved


def _normalised(pictures: Mapping[str, np.ndarray]) -> np.ndarray:
    colour = pictures["warped"][:3]
    return colour - colour.mean()


def _placed(pictures: Mapping[str, np.ndarray]) -> np.ndarray:
    colour = pictures["warped"][:3]
    return colour + np.float32(1e-3) * np.arange(colour.shape[2], dtype=np.float32)


def _swallowing(pictures: Mapping[str, np.ndarray]) -> np.ndarray:
    """Look 20 pixels away where NaN does not show."""
    colour = pictures["warped"][:3]
    return colour + np.nan_to_num(np.roll(colour, 20, axis=2))


class TestReach:
    @pytest.mark.parametrize(("by", "found"), [(0, 0), (1, 8), (8, 8), (9, 16), (-20, 24)])
    def test_is_found_in_strides(self, by, found):
        assert reach_of(lambda p: _shifted(p, by), STRIDE) == found

    def test_a_larger_picture_is_tried_where_the_first_is_too_small(self):
        first = models.SIDES[0]
        assert reach_of(lambda p: _shifted(p, first * 3 // 4), STRIDE) is not None

    @pytest.mark.parametrize("run", [_normalised, _placed, _swallowing])
    def test_what_cannot_be_cut_up_is_told(self, run):
        assert reach_of(run, STRIDE) is None


@pytest.fixture
def load(tmp_path, monkeypatch) -> Callable[[onnx.ModelProto], OnnxExtrapolator]:
    monkeypatch.setattr(models, "MOST_PIXELS", TINY)

    def run(made: onnx.ModelProto) -> OnnxExtrapolator:
        return load_extrapolator(save(tmp_path / "model.onnx", made), 1, "cpu")

    return run


def given_inputs(height: int, width: int) -> NetworkInputs:
    rng = np.random.default_rng(height)
    planes = {name: rng.random((n, height, width), np.float32) for name, n in INPUTS.items()}
    return NetworkInputs(**planes, time=0.75)


def in_one(network: OnnxExtrapolator, given: NetworkInputs, monkeypatch) -> np.ndarray:
    """Have a network make a frame whole."""
    monkeypatch.setattr(models, "MOST_PIXELS", 2**30)
    try:
        return network(given)
    finally:
        monkeypatch.setattr(models, "MOST_PIXELS", TINY)


def parts_of(network: OnnxExtrapolator, given: NetworkInputs, monkeypatch) -> int:
    """Count the parts that a frame is made of."""
    asked = []
    whole = NetworkInputs.part

    def part(self: NetworkInputs, rows: slice, columns: slice, *room: object) -> NetworkInputs:
        asked.append((rows, columns))
        return whole(self, rows, columns)

    monkeypatch.setattr(NetworkInputs, "part", part)
    network(given)
    return len(asked)


MADE = {
    "convolution": lambda: convolution(),
    "at half the size": lambda: convolution(scale=2, exwarp__stride="2"),
    "a wide blur": lambda: blur(31),
    "the warp": lambda: filled_warp(),
}


@pytest.mark.parametrize("size", [(96, 128), (101, 203), (40, 300)])
@pytest.mark.parametrize("name", MADE)
def test_there_are_no_seams(load, monkeypatch, name, size):
    network, given = load(MADE[name]()), given_inputs(*size)
    whole = in_one(network, given, monkeypatch)
    np.testing.assert_allclose(network(given), whole, rtol=0, atol=1e-5)
    assert parts_of(network, given, monkeypatch) > 1


def test_a_margin_that_is_too_small_shows(load, monkeypatch):
    """The comparison above can fail."""
    network, given = load(blur(31)), given_inputs(96, 128)
    whole = in_one(network, given, monkeypatch)
    monkeypatch.setattr(network, "_reach", 8, raising=False)
    assert np.abs(network(given) - whole).max() > 1e-3


def test_a_network_that_sees_everything_is_given_everything(load, monkeypatch):
    """Such as one that takes off the picture's mean."""
    taken = filled_warp()
    nodes = [
        *(replace_output(node, OUTPUT, "own") for node in taken.graph.node),
        helper.make_node("GlobalAveragePool", ["own"], ["mean"]),
        helper.make_node("Sub", ["own", "mean"], [OUTPUT]),
    ]
    weights = {t.name: onnx.numpy_helper.to_array(t) for t in taken.graph.initializer}
    network = load(model(nodes, inputs(["warped", "mask"]), weights=weights))
    given = given_inputs(96, 128)
    own = given.warped[3:]
    mean = own.mean(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(network(given), own - mean, rtol=0, atol=1e-5)
    assert parts_of(network, given, monkeypatch) == 1


def replace_output(node: onnx.NodeProto, old: str, new: str) -> onnx.NodeProto:
    copy = onnx.NodeProto()
    copy.CopyFrom(node)
    copy.output[:] = [new if name == old else name for name in node.output]
    return copy


def test_the_shipped_network_has_no_seams(monkeypatch):
    network = load_extrapolator(None, 2, "cpu")
    given = given_inputs(330, 504)
    whole = network(given)
    monkeypatch.setattr(models, "MOST_PIXELS", 272 * 320)
    found = network(given)
    assert network._reach == 96
    np.testing.assert_allclose(found, whole, rtol=0, atol=1e-5)
    assert parts_of(network, given, monkeypatch) >= 4


def test_a_part_of_the_inputs_is_that_of_the_planes():
    whole = given_inputs(20, 30)
    rows, columns = slice(3, 9), slice(11, 40)
    part = replace(whole).part(rows, columns)
    assert part.shape == (6, 19) and part.time == whole.time
    for name, planes in part.pictures.items():
        np.testing.assert_array_equal(planes, whole.pictures[name][:, rows, columns])
