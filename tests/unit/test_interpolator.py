"""Interpolation networks: what they are fed by their cards, and how the answer is read."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto

from exwarp_cli.domain.colour import ShoulderCurve
from exwarp_cli.domain.frame import Float32
from exwarp_cli.models.interpolator import OnnxInterpolator, load_interpolator
from tests.unit.tiny_interpolators import (
    CARDS,
    PAIR,
    box_blur,
    convolution,
    first_frame,
    put,
    rife,
    untimed,
)

SIZES = [(1, 1), (5, 3), (32, 64), (37, 61)]
TIMED = PAIR | {"timestep": "time"}

Load = Callable[..., OnnxInterpolator]


@pytest.fixture
def load(tmp_path) -> Load:
    def run(made: onnx.ModelProto, threads: int | None = None, **keys: Any) -> OnnxInterpolator:
        return load_interpolator(put(tmp_path / "net.onnx", made, keys), threads, "cpu")

    return run


def frames(height: int, width: int, peak: float = 1.0, channels: int = 3) -> list[Float32]:
    rng = np.random.default_rng(height * 1000 + width)
    return [(peak * rng.random((height, width, channels))).astype(np.float32) for _ in range(2)]


def faded(before: Float32, after: Float32, time: float, encoding: str = "srgb") -> Float32:
    """Cross-fade what networks see."""
    curve = ShoulderCurve.of(encoding, before, after)
    first, second = curve.encode(before), curve.encode(after)
    return curve.decode(first + np.float32(time) * (second - first))


class TestShapes:
    @pytest.mark.parametrize("size", SIZES)
    @pytest.mark.parametrize("shape", CARDS)
    def test_every_shape_gets_its_frames_and_the_time(self, load, shape, size):
        made, keys = CARDS[shape]
        network, (before, after) = load(made, **keys), frames(*size)
        for time in (0.25, 0.5, 0.75):
            found = network(before, after, time)
            assert found.dtype == np.float32 and found.flags.c_contiguous
            np.testing.assert_allclose(found, faded(before, after, time), atol=2e-6)

    @pytest.mark.parametrize("span", [[0, 1], [-1, 1], [0, 255], [1, 0]])
    def test_ranges(self, load, span):
        (before, after), network = frames(7, 9, peak=3), load(rife(), inputs=TIMED, range=span)
        np.testing.assert_allclose(
            network(before, after, 0.25), faded(before, after, 0.25), rtol=2e-4, atol=1e-6
        )

    def test_what_it_sees_lies_in_the_range(self, load):
        """A gain that turns [0, 255] into [0, 1] fits where the output is said to have that."""
        gain, (before, after) = (1 / 255,) * 3, frames(7, 9)
        output = {"name": "out", "range": [0, 1]}
        network = load(first_frame(gain), output=output, range=[0, 255])
        np.testing.assert_allclose(network(before, after, 0.5), before, atol=1e-6)

    @pytest.mark.parametrize("encoding", ["srgb", "linear", "log"])
    def test_encodings(self, load, encoding):
        network = load(rife(), inputs=TIMED, encoding=encoding)
        before, after = frames(6, 5, peak=20)
        found = network(before, after, 0.75)
        expected = faded(before, after, 0.75, encoding)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)

    @pytest.mark.parametrize(("order", "kept"), [("RGB", 0), ("BGR", 2)])
    def test_order_of_the_channels(self, load, order, kept):
        network, (before, after) = load(first_frame((1, 0, 0)), order=order), frames(4, 6)
        found = network(before, after, 0.5)
        expected = np.zeros_like(before)
        expected[..., kept] = before[..., kept]
        np.testing.assert_allclose(found, expected, atol=1e-6)

    def test_the_output_may_have_another_order(self, load):
        network = load(first_frame(), output={"name": "out", "order": "BGR"})
        before, after = frames(4, 6)
        np.testing.assert_allclose(network(before, after, 0.5), before[..., ::-1], atol=1e-6)

    def test_one_of_several_frames(self, load):
        output = {"name": "out", "first_channel": 6}
        network, (before, after) = load(first_frame(copies=3), output=output), frames(4, 6)
        np.testing.assert_allclose(network(before, after, 0.5), before, atol=1e-6)
        black = load(first_frame(copies=3), output={"name": "out", "first_channel": 3})
        assert (black(before, after, 0.5) == 0).all()

    def test_half_floats(self, load):
        network = load(rife(kind=TensorProto.FLOAT16), inputs=TIMED)
        before, after = frames(8, 8)
        found = network(before, after, 0.25)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, faded(before, after, 0.25), atol=4e-3)


class TestPadding:
    @pytest.mark.parametrize("place", ["end", "centre"])
    @pytest.mark.parametrize("mode", ["edge", "reflect", "zero"])
    @pytest.mark.parametrize("size", [(5, 10), (7, 8), (13, 3)])
    def test_what_lies_beside_the_frame(self, load, place, mode, size):
        padding = {"multiple": 8, "mode": mode, "place": place}
        network, (before, after) = load(box_blur(), padding=padding), frames(*size)
        found = network(before, after, 0.5)
        shown = ShoulderCurve.of("srgb", before, after).encode(before)
        rows, columns = -size[0] % 8, -size[1] % 8
        above, left = (rows // 2, columns // 2) if place == "centre" else (0, 0)
        ways = {"edge": "edge", "reflect": "reflect", "zero": "constant"}
        added = ((above, rows - above), (left, columns - left), (0, 0))
        padded = np.pad(np.pad(shown, added, mode=ways[mode]), ((1, 1), (1, 1), (0, 0)))
        height, width = size
        blurred = sum(
            padded[above + y : above + y + height, left + x : left + x + width]
            for y in range(3)
            for x in range(3)
        )
        expected = ShoulderCurve.of("srgb", before, after).decode(blurred / 9)
        np.testing.assert_allclose(found, expected, atol=2e-6)

    def test_black_is_black_in_any_range(self, load, monkeypatch):
        padding = {"multiple": 8, "mode": "zero"}
        network = load(first_frame(), padding=padding, range=[-1, 1])
        fed: dict[str, np.ndarray] = {}
        true = network._answer

        def answer(output: str, feeds: Any, size: Any, stride: int, advice: str) -> Any:
            fed.update(feeds)
            return true(output, feeds, size, stride, advice)

        monkeypatch.setattr(network, "_answer", answer)
        white = np.ones((5, 5, 3), np.float32)
        network(white, white, 0.5)
        given = fed["img0"][0]
        np.testing.assert_allclose(given[:, :5, :5], 1, atol=1e-6)
        assert (given[:, 5:] == -1).all()


class TestHighDynamicRange:
    def test_highlights_and_negative_values_come_back(self, load):
        network, (before, after) = load(first_frame()), frames(8, 8)
        before[2, 3], before[4, 4], after[5, 5] = 9000, -0.25, 20
        found = network(before, after, 0.5)
        np.testing.assert_allclose(found, before, rtol=1e-4, atol=1e-6)

    def test_alpha_is_blended_by_time(self, load):
        network, (before, after) = load(rife(), inputs=TIMED), frames(6, 7, channels=4)
        found = network(before, after, 0.25)
        assert found.shape == before.shape
        expected = 0.75 * before[..., 3] + 0.25 * after[..., 3]
        np.testing.assert_allclose(found[..., 3], expected, atol=1e-6)
        np.testing.assert_allclose(
            found[..., :3], faded(before[..., :3], after[..., :3], 0.25), atol=1e-6
        )

    def test_alpha_is_no_highlight(self, load):
        network, (before, after) = load(rife(), inputs=TIMED), frames(6, 7, channels=4)
        plain = network(before[..., :3], after[..., :3], 0.5)
        after[..., 3] = 50
        np.testing.assert_array_equal(network(before, after, 0.5)[..., :3], plain)


def strides(network: OnnxInterpolator, monkeypatch: Any) -> list[int]:
    """The stride by which threads are bounded, of every run from now on."""
    runs: list[int] = []
    true = network._answer

    def answer(output: str, feeds: Any, size: Any, stride: int, advice: str) -> Any:
        runs.append(stride)
        return true(output, feeds, size, stride, advice)

    monkeypatch.setattr(network, "_answer", answer)
    return runs


class TestWithoutTime:
    def test_the_middle_is_made_once_for_three_slots(self, load, monkeypatch):
        network, (before, after) = load(untimed()), frames(6, 7)
        runs = strides(network, monkeypatch)
        for time in (0.25, 0.5, 0.75):
            network(before, after, time)
        assert len(runs) == 3
        other, _ = frames(6, 7, peak=0.5)
        for pair in ((before, other), (other, after), (other, before)):
            found = network(*pair, 0.5)
            np.testing.assert_allclose(found, faded(*pair, 0.5), atol=1e-6)

    def test_only_quarters_can_be_reached(self, load):
        before, after = frames(6, 7)
        with pytest.raises(ValueError, match=r"does not reach 0\.4"):
            load(untimed())(before, after, 0.4)


class TestIdentity:
    def test_name_and_checksums(self, load, tmp_path):
        network = load(untimed())
        files = [tmp_path / "net.onnx", tmp_path / "net.json"]
        sums = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
        assert [network.checksum, network.card.checksum] == sums
        assert (network.name, network.path, network.device) == ("net", files[0], "cpu")
        assert load(untimed(), name="RIFE 4.25").name == "RIFE 4.25"

    @pytest.mark.parametrize("size", [(16, 24), (72, 128)])
    @pytest.mark.parametrize(("hidden", "scale"), [(18, 1), (33, 2)])
    def test_threads_change_nothing(self, load, hidden, scale, size):
        given, keys = frames(*size), {"inputs": TIMED, "padding": {"multiple": scale}}
        alone = load(convolution(hidden, scale=scale), 1, **keys)(*given, 0.25)
        for threads in (2, 3, 16, None):
            made = load(convolution(hidden, scale=scale), threads, **keys)
            np.testing.assert_array_equal(made(*given, 0.25), alone)

    @pytest.mark.parametrize(("multiple", "stride"), [(1, 32), (64, 64)])
    def test_threads_are_few_even_if_the_card_tells_no_multiple(
        self, load, monkeypatch, multiple, stride
    ):
        network = load(untimed(), padding={"multiple": multiple})
        runs = strides(network, monkeypatch)
        network(*frames(6, 7), 0.5)
        assert runs == [stride]

    def test_frames_are_not_touched(self, load):
        given = frames(6, 7, channels=4)
        before = [frame.copy() for frame in given]
        load(rife(), inputs=TIMED)(*given, 0.5)
        for frame, copy in zip(given, before, strict=True):
            np.testing.assert_array_equal(frame, copy)
