"""Cards of interpolation networks: what is refused and why, and how one is begun."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto

from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, OutputExistsError
from exwarp_cli.models.interpolator import SCHEMA, SHAPES, begin_card, load_interpolator, parse_card
from tests.unit.tiny_interpolators import (
    CARDS,
    PAIR,
    box_blur,
    card,
    convolution,
    ema_vfi,
    film,
    first_frame,
    nchw,
    put,
    rife,
    stacked,
    untimed,
    value,
)
from tests.unit.tiny_models import model, save

PATH = Path("net.json")
TIMED = PAIR | {"timestep": "time"}


def without(key: str) -> dict[str, Any]:
    return {name: value for name, value in card().items() if name != key}


SENSELESS: list[tuple[Any, tuple[str, ...]]] = [
    ([], ("[] as the card", "an object")),
    (without("schema"), ("null as schema", SCHEMA)),
    (card(schema="exwarp.interpolator/2"), ("interpolator/2", SCHEMA)),
    (card(input={}), ("unknown key 'input'", "inputs")),
    (without("inputs"), ("null as inputs", "first, second, time")),
    (card(inputs={"a": "first"}), ("no input the second frame",)),
    (card(inputs=PAIR | {"c": "third"}), ("\"third\" as input 'c'", "first, second, time")),
    (card(inputs=PAIR | {"c": []}), ("[] as input 'c'",)),
    (card(inputs=PAIR | {"c": [["time"]]}), ("input 'c'",)),
    (card(inputs=PAIR | {"c": [1] * 65}), ("input 'c'", "1 to 64")),
    (card(inputs=PAIR | {"c": True}), ("true as input 'c'",)),
    (card(inputs=PAIR | {"c": float("nan")}), ("NaN as input 'c'",)),
    (without("output"), ("null as output",)),
    (card(output={"name": "out", "channel": 1}), ("unknown key 'channel'", "first_channel")),
    (card(output={"name": "out", "first_channel": -1}), ("-1 as first_channel", "from 0")),
    (card(output={"name": ""}), ('"" as the output\'s name',)),
    (card(layout="CHW"), ('"CHW" as layout', "one of NCHW, NHWC")),
    (card(layout=["NCHW"]), ("as layout",)),
    (card(order="rgb"), ('"rgb" as order', "RGB, BGR")),
    (card(encoding="gamma"), ('"gamma" as encoding', "srgb, linear, log")),
    (card(range=[1, 1]), ("[1, 1] as range", "[0, 1]")),
    (card(range=255), ("255 as range",)),
    (card(name=7), ("7 as name", "a text")),
    (card(name="a\nb"), ("as name",)),
    (card(padding=32), ("32 as padding", "multiple, mode, place")),
    (card(padding={"multiple": 0}), ("0 as multiple", "from 1 to 512")),
    (card(padding={"multiple": 1.5}), ("1.5 as multiple",)),
    (card(padding={"mode": "wrap"}), ('"wrap" as mode', "edge, reflect, zero")),
    (card(padding={"place": "start"}), ('"start" as place', "end, centre")),
]


def message_of(caught: pytest.ExceptionInfo[Exception]) -> str:
    text = str(caught.value)
    assert "\n" not in text and ("; " in text or " or " in text)
    return text


class TestCards:
    @pytest.mark.parametrize(("document", "words"), SENSELESS)
    def test_what_makes_no_sense(self, document, words):
        with pytest.raises(LayoutError) as caught:
            parse_card(PATH, document)
        for word in ("the card net.json", *words):
            assert word in message_of(caught)

    def test_defaults(self):
        found = parse_card(PATH, card())
        assert (found.name, found.output, found.first_channel) == ("net", "out", 0)
        assert found.inputs == {"img0": ("first",), "img1": ("second",)}
        picture = found.input_format
        assert (picture.layout, picture.order, picture.low, picture.high) == ("NCHW", "RGB", 0, 1)
        assert found.output_format == picture and found.encoding == "srgb" and not found.timed
        assert (found.padding.multiple, found.padding.mode) == (1, "edge")
        assert not found.padding.centred

    def test_the_output_differs_only_where_it_says_so(self):
        output = {"name": "y", "layout": "NHWC"}
        found = parse_card(PATH, card(output=output, range=[-1, 1], order="BGR"))
        assert (found.output, found.output_format.layout, found.input_format.layout) == (
            "y",
            "NHWC",
            "NCHW",
        )
        assert (found.output_format.order, found.output_format.low) == ("BGR", -1)

    def test_none(self, tmp_path):
        path = save(tmp_path / "net.onnx", untimed())
        with pytest.raises(InputError) as caught:
            load_interpolator(path, 1, "cpu")
        assert "net.onnx has no card net.json beside it" in message_of(caught)

    @pytest.mark.parametrize("data", [b"", b"{", b"\xff\xfe{}", b"[" * 100_000])
    def test_no_json(self, tmp_path, data):
        path = put(tmp_path / "net.onnx", untimed(), {})
        path.with_suffix(".json").write_bytes(data)
        with pytest.raises(DamagedFileError, match=r"net\.json is no JSON \(.*\); mend it"):
            load_interpolator(path, 1, "cpu")

    def test_a_folder(self, tmp_path):
        path = save(tmp_path / "net.onnx", untimed())
        path.with_suffix(".json").mkdir()
        with pytest.raises(InputError, match="cannot read the card"):
            load_interpolator(path, 1, "cpu")


def fixed_size() -> onnx.ModelProto:
    made = untimed()
    for node in (*made.graph.input, *made.graph.output):
        node.type.tensor_type.shape.dim[2].dim_value = 64
        node.type.tensor_type.shape.dim[3].dim_value = 96
    return made


def doubles() -> onnx.ModelProto:
    takes = [nchw(name, 3, TensorProto.DOUBLE) for name in PAIR]
    nodes = [onnx.helper.make_node("Add", list(PAIR), ["out"])]
    return model(nodes, takes, [nchw("out", 3, TensorProto.DOUBLE)])


def two_times() -> onnx.ModelProto:
    made = rife()
    made.graph.input[2].CopyFrom(value("timestep", [2]))
    return made


def many_axes() -> onnx.ModelProto:
    made = rife()
    made.graph.input[2].CopyFrom(value("timestep", [1] * 70))
    return made


def texts() -> onnx.ModelProto:
    nodes = [
        onnx.helper.make_node("Add", list(PAIR), ["sum"]),
        onnx.helper.make_node("Cast", ["sum"], ["out"], to=TensorProto.STRING),
    ]
    takes = [nchw(name, 3) for name in PAIR]
    return model(nodes, takes, [nchw("out", 3, TensorProto.STRING)])


def a_sequence() -> onnx.ModelProto:
    out = onnx.helper.make_tensor_sequence_value_info("out", TensorProto.FLOAT, None)
    nodes = [onnx.helper.make_node("SequenceConstruct", list(PAIR), ["out"])]
    return model(nodes, [nchw(name, 3) for name in PAIR], [out])


def a_number() -> onnx.ModelProto:
    nodes = [
        onnx.helper.make_node("Add", list(PAIR), ["sum"]),
        onnx.helper.make_node("ReduceMax", ["sum"], ["out"], keepdims=0),
    ]
    return model(nodes, [nchw(name, 3) for name in PAIR], [value("out", [])])


MISFITS: list[tuple[onnx.ModelProto, dict[str, Any], tuple[str, ...]]] = [
    (rife(), {}, ("input 'timestep'", "does not name")),
    (untimed(), {"inputs": TIMED}, ("no input 'timestep'", "img0, img1")),
    (untimed(), {"output": "image"}, ("no output 'image'", "its outputs are out")),
    (stacked(8), {**CARDS["rife of 7 channels"][1]}, ("[1, 8, H, W]", "[1, 7, H, W]")),
    (untimed(), {"layout": "NHWC"}, ("[1, 3, H, W]", "[1, H, W, 3]")),
    (fixed_size(), {}, ("[1, 3, 64, 96]", "any height and width")),
    (doubles(), {}, ("tensor(double)", "float inputs")),
    (two_times(), {"inputs": TIMED}, ("'timestep'", "[2]", "[1]")),
    (rife(), {"inputs": {"img0": ["first", "time"], "img1": "second", "timestep": 1}}, ("4, H",)),
    (untimed(), {"output": {"name": "out", "layout": "NHWC"}}, ("gives [1, 3, ", ", 3]")),
    (untimed(), {"output": {"name": "out", "first_channel": 1}}, ("gives [1, 3, ", "[1, 4, ")),
    (many_axes(), {"inputs": TIMED}, ("'timestep'", "[1, 1, 1, 1]; mend the card")),
    (texts(), {}, ("output 'out' as tensor(string)", "no picture")),
    (a_sequence(), {}, ("output 'out' as seq(tensor(float))", "no picture")),
    (a_number(), {}, ("gives [] for ", "says [1, 3, ")),
    (convolution(scale=2), {"inputs": TIMED}, ("fails on ", "padding in its card")),
]


class TestNetworks:
    @pytest.mark.parametrize(("made", "keys", "words"), MISFITS)
    def test_one_that_does_not_fit_its_card(self, tmp_path, capfd, made, keys, words):
        path = put(tmp_path / "net.onnx", made, keys)
        with pytest.raises(LayoutError) as caught:
            load_interpolator(path, 1, "cpu")
        for word in ("net.onnx", "net.json", *words):
            assert word in message_of(caught)
        assert capfd.readouterr() == ("", "")

    @pytest.mark.parametrize("gain", [np.nan, np.inf, 255])
    def test_answers_that_are_no_colour(self, tmp_path, gain):
        path = put(tmp_path / "net.onnx", first_frame((gain,) * 3), {})
        with pytest.raises(InputError, match=r"NaN or values far outside.*net\.json.*mend"):
            load_interpolator(path, 1, "cpu")

    @pytest.mark.parametrize("multiple", [1, 2, 4])
    def test_a_multiple_that_the_card_does_not_tell_shows_at_once(self, tmp_path, multiple):
        keys = {"inputs": TIMED, "padding": {"multiple": multiple}}
        path = put(tmp_path / "n.onnx", convolution(scale=4), keys)
        if multiple == 4:
            load_interpolator(path, 1, "cpu")
        else:
            with pytest.raises(LayoutError, match="fails on"):
                load_interpolator(path, 1, "cpu")

    def test_weights_in_another_file(self, tmp_path):
        path = put(tmp_path / "net.onnx", untimed(), {"inputs": TIMED})
        options = {"save_as_external_data": True, "location": "w.bin", "size_threshold": 0}
        onnx.save(convolution(), str(path), **options)
        load_interpolator(path, 1, "cpu")
        (tmp_path / "w.bin").rename(tmp_path / "x.bin")
        with pytest.raises(InputError, match=r"net\.onnx keeps weights in .*w\.bin"):
            load_interpolator(path, 1, "cpu")

    def test_no_model(self, tmp_path):
        path = put(tmp_path / "net.onnx", untimed(), {})
        path.write_bytes(b"text" * 50)
        with pytest.raises(DamagedFileError, match="no ONNX model"):
            load_interpolator(path, 1, "cpu")
        path.unlink()
        with pytest.raises(InputError, match=r"there is no model .*net\.onnx"):
            load_interpolator(path, 1, "cpu")


BEGUN: list[tuple[str, Callable[[], onnx.ModelProto], dict[str, Any]]] = [
    ("rife", rife, TIMED),
    ("rife", untimed, PAIR),
    ("rife", stacked, {"input": ["first", "second", "time", 1.0]}),
    ("rife", lambda: stacked(7), {"input": ["first", "second", "time"]}),
    ("ema-vfi", ema_vfi, {"x": ["first", "second"], "timestep": "time"}),
    ("film", film, {"time": "time", "x0": "first", "x1": "second"}),
]


class TestBeginning:
    @pytest.mark.parametrize(("shape", "make", "inputs"), BEGUN)
    def test_the_card_of_a_known_export(self, tmp_path, shape, make, inputs):
        path = save(tmp_path / "net.onnx", make())
        found = json.loads(begin_card(path, shape).read_text())
        assert found["inputs"] == inputs and found["name"] == "net"
        assert found["padding"] == SHAPES[shape]["padding"]
        frame = np.full((5, 6, 3), 0.3, np.float32)
        made = load_interpolator(path, 1, "cpu")(frame, frame, 0.25)
        np.testing.assert_allclose(made, frame, atol=1e-5)

    def test_a_card_is_not_replaced_unasked(self, tmp_path):
        path = put(tmp_path / "net.onnx", rife(), {"name": "mine"})
        with pytest.raises(OutputExistsError, match=r"net\.json exists"):
            begin_card(path, "rife")
        assert "mine" in path.with_suffix(".json").read_text()
        begin_card(path, "rife", overwrite=True)
        assert "mine" not in path.with_suffix(".json").read_text()

    @pytest.mark.parametrize(("shape", "make"), [("film", rife), ("rife", film)])
    def test_another_export(self, tmp_path, shape, make):
        path = save(tmp_path / "net.onnx", make())
        with pytest.raises(LayoutError, match=rf"not those of a {shape} export; write its card"):
            begin_card(path, shape)
        assert not path.with_suffix(".json").exists()

    def test_one_that_fails_leaves_no_card(self, tmp_path):
        path = save(tmp_path / "net.onnx", first_frame((9, 9, 9)))
        with pytest.raises(InputError, match="far outside of the range"):
            begin_card(path, "rife")
        assert not path.with_suffix(".json").exists()


def test_tiny_networks_are_sound():
    for made, _ in CARDS.values():
        onnx.checker.check_model(made, full_check=True)
    for made in (first_frame(), first_frame(copies=3), box_blur(), convolution(scale=2)):
        onnx.checker.check_model(made, full_check=True)
