"""Which layers a file has, of what kind, and which of them are asked for."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.errors import UsageError
from exwarp_cli.io.channels import Layout, Role, detect_layout
from exwarp_cli.io.exr.header import Channel
from exwarp_cli.io.exr.reader import ExrFile
from exwarp_cli.io.layers import Layer, LayerKind, group_layers, select_layers
from exwarp_cli.io.views import view_channels
from tests.unit.exr_files import plane, rgba, write_parts


def part(names: str, index: int = 0) -> dict[str, Channel]:
    """Channels such as ``Depth.Z`` or, above 24 bits, ``uint:ID``, by name."""
    channels = {}
    for i, spec in enumerate(names.split()):
        kind, _, name = spec.rpartition(":")
        name = name.replace("_", " ")
        channels[name] = Channel(index, i, name, name, kind or "half")
    return channels


def found(*parts: dict[str, Channel]) -> tuple[tuple[Layer, ...], Layout]:
    channels = {name: channel for part in parts for name, channel in part.items()}
    layout = detect_layout({"": channels.values()})
    return group_layers({"": channels}, layout), layout


def kinds(names: str) -> dict[str, LayerKind]:
    return {layer.name: layer.kind for layer in found(part(names))[0]}


def spelled(layer: str, components: str) -> str:
    return " ".join(f"{layer}.{letter}" for letter in components)


BLENDER = " ".join(
    spelled(layer, components)
    for layer, components in {
        "V.Combined": "RGBA",
        "V.Depth": "Z",
        "V.Mist": "Z",
        "V.Position": "XYZ",
        "V.Normal": "XYZ",
        "V.Vector": "XYZW",
        "V.UV": "UVA",
        "V.Object_Index": "X",
        "V.Material_Index": "X",
        "V.Diffuse_Direct": "RGB",
        "V.Glossy_Indirect": "RGB",
        "V.Emission": "RGB",
        "V.Ambient_Occlusion": "RGB",
        "V.Shadow_Catcher": "RGB",
        "V.Denoising_Albedo": "RGB",
        "V.Denoising_Normal": "XYZ",
        "V.Denoising_Depth": "Z",
        "V.CryptoObject00": "rgba",
        "V.CryptoObject01": "rgba",
        "V.Roughness": "X",
        "V.Lightgroup_Key": "RGB",
    }.items()
)


class TestKinds:
    def test_blender(self):
        table = {name.removeprefix("V."): kind.value for name, kind in kinds(BLENDER).items()}
        colour = (
            "Combined Mist Diffuse_Direct Glossy_Indirect Emission Ambient_Occlusion "
            "Shadow_Catcher Denoising_Albedo Roughness Lightgroup_Key"
        )
        assert {name for name, kind in table.items() if kind == "colour"} == {
            name.replace("_", " ") for name in colour.split()
        }
        assert {name: kind for name, kind in table.items() if kind != "colour"} == {
            "Depth": "depth",
            "Position": "position",
            "Normal": "normal",
            "Vector": "motion",
            "UV": "data",
            "Object Index": "id",
            "Material Index": "id",
            "Denoising Normal": "normal",
            "Denoising Depth": "depth",
            "CryptoObject00": "cryptomatte",
            "CryptoObject01": "cryptomatte",
        }

    @pytest.mark.parametrize(
        ("names", "expected"),
        [
            ("Y Z", {"Y": LayerKind.COLOUR, "Z": LayerKind.DEPTH}),
            ("R G B A Z", {"RGBA": LayerKind.COLOUR, "Z": LayerKind.DEPTH}),
            ("R G B ID u v", {"RGB": LayerKind.COLOUR, "ID": LayerKind.ID, "uv": LayerKind.DATA}),
            ("R G B crypto_material00.R", {"crypto material00": LayerKind.CRYPTOMATTE}),
            ("R G B ActorHitProxyMask00.R", {"ActorHitProxyMask00": LayerKind.CRYPTOMATTE}),
            ("R G B Pref.R Pref.G Pref.B", {"Pref": LayerKind.DATA}),
            (
                "R G B a.P.X a.P.Y a.P.Z P.X P.Y P.Z",
                {"a.P": LayerKind.POSITION, "P": LayerKind.POSITION},
            ),
            (
                "R G B N.X N.Y N.Z Nref.X Nref.Y Nref.Z",
                {"N": LayerKind.NORMAL, "Nref": LayerKind.DATA},
            ),
            ("R G B specular_motion.R specular_motion.G", {"specular motion": LayerKind.MOTION}),
            ("R G B v.X v.Y v.Z", {"v": LayerKind.DATA}),
            ("R G B tangent.X tangent.Y tangent.Z", {"tangent": LayerKind.DATA}),
            (
                "R G B grid.R fluid.R solid.V",
                dict.fromkeys(("grid", "fluid", "solid"), LayerKind.COLOUR),
            ),
            (
                "R G B materialId.R renderID.R",
                {"materialId": LayerKind.ID, "renderID": LayerKind.ID},
            ),
            ("R G B uint:anything.R", {"anything": LayerKind.ID}),
            ("R G B uint:crypto_asset02.R", {"crypto asset02": LayerKind.CRYPTOMATTE}),
            (
                "R G B float:shadow.R float:myaov.V",
                {"shadow": LayerKind.COLOUR, "myaov": LayerKind.COLOUR},
            ),
            ("R G B l.R l.G l.B l.Z", {"l": LayerKind.COLOUR, "l.Z": LayerKind.DEPTH}),
        ],
    )
    def test_names_of_renderers(self, names, expected):
        table = kinds(names)
        assert {name: table[name] for name in expected} == expected

    def test_vectors_of_unknown_convention_are_data(self):
        blender = f"{spelled('V.Combined', 'RGBA')} {spelled('V.Vector', 'XYZW')}"
        table = kinds(f"{blender} {spelled('velocity', 'XYZ')}")
        assert table["V.Vector"] is LayerKind.MOTION and table["velocity"] is LayerKind.DATA

    def test_the_header_tells_of_cryptomattes_by_any_name(self):
        layout = detect_layout({})
        parts = {"": part("R G B who00.r who00.g who.r whose.r")}
        table = {layer.name: layer.kind for layer in group_layers(parts, layout, ("who",))}
        assert table["who00"] is table["who"] is LayerKind.CRYPTOMATTE
        assert table["whose"] is LayerKind.COLOUR

    def test_alpha_that_vectors_are_premultiplied_by_stays_colour(self):
        file = part("A B G R motionvector.X motionvector.Y")
        layers, layout = found(file)
        roles = dict(layout.roles)
        roles[Role.MOTION] = (*roles[Role.MOTION], roles[Role.COLOUR][3])
        again = group_layers({"": file}, Layout(roles))
        assert [layer.kind for layer in again] == [layer.kind for layer in layers]
        assert again[0].kind is LayerKind.COLOUR


class TestStructure:
    def test_channels_keep_their_order_and_their_part(self):
        layers, _ = found(part("A B G R"), part("d.Z", 1), part("n.Z n.Y n.X", 2))
        places = [(layer.channels[0].part, layer.name) for layer in layers]
        assert places == [(0, "ABGR"), (1, "d"), (2, "n")]
        assert [ref.name for ref in layers[2].refs] == ["n.Z", "n.Y", "n.X"]

    def test_every_channel_is_in_one_layer(self):
        file = part(BLENDER + " R G B A Z ID AR AG AB u v st.S st.T q.R q.X q.Y q.foo q.bar Q.r")
        layers, _ = found(file)
        channels = [c for layer in layers for c in layer.channels]
        assert sorted(channels, key=lambda c: c.index) == list(file.values())
        assert len({layer.name for layer in layers}) == len(layers)

    def test_one_name_in_two_parts_is_two_layers(self):
        channels = {"a.R": Channel(0, 0, "a.R", "a.R", "half")}
        channels["a.Z"] = Channel(1, 0, "a.Z", "a.Z", "float")
        layers = group_layers({"": channels}, detect_layout({}))
        assert [(layer.name, len(layer.refs)) for layer in layers] == [("a", 1), ("a", 1)]

    def test_files_of_one_aov_each(self):
        files = {"Depth": part("R"), "Colour": part("R G B")}
        layers = group_layers(
            files, detect_layout({aov: file.values() for aov, file in files.items()})
        )
        assert [(layer.refs[0].aov, layer.name) for layer in layers] == [
            ("Depth", "Depth"),
            ("Colour", "Colour"),
        ]
        assert layers[0].kind is LayerKind.DEPTH

    def test_of_a_real_file_with_two_views(self, tmp_path):
        ids = plane(6, 8, 2**24 + 1, np.uint32)
        parts = {
            f"{view}.{name}": (planes, {"view": view})
            for view in ("left", "right")
            for name, planes in {"Combined": rgba(6, 8), "Object Index": {"X": ids}}.items()
        }
        path = write_parts(tmp_path / "a.exr", parts)
        with ExrFile(path) as file:
            channels = view_channels(file.parts, "right")
            layers = group_layers({"": channels}, detect_layout({"": channels.values()}))
            read = file.read(layers[1].channels)
        assert [layer.name.rsplit(".", 1)[-1] for layer in layers] == ["Combined", "Object Index"]
        assert [layer.channels[0].part for layer in layers] == [2, 3]
        assert [layer.channels[0].pixel_type for layer in layers] == ["half", "uint"]
        assert (read[layers[1].channels[0]] == 2**24 + 1).all()


class TestRendered:
    def test_a_slots_own_layer_of_the_same_name_and_components(self):
        layers, _ = found(part(BLENDER))
        own, _ = found(part(f"R G B {spelled('V.Depth', 'Z')} {spelled('V.Normal', 'XY')}"))
        taken = {layer.name.rsplit(".", 1)[-1]: layer.rendered_in(own) for layer in layers}
        assert {name for name, layer in taken.items() if layer is not None} == {"Depth"}
        assert taken["Depth"] is own[1]

    def test_colour_and_vectors_are_never_taken(self):
        layers, _ = found(part(BLENDER))
        refused = {layer.kind for layer in layers if layer.rendered_in(layers) is None}
        assert refused == {LayerKind.COLOUR, LayerKind.MOTION}


class TestChosen:
    def names(self, text: str) -> list[str]:
        layers, layout = found(part(BLENDER))
        return [layer.name.removeprefix("V.") for layer in select_layers(layers, text, layout)]

    def test_the_beauty_alone(self):
        assert self.names("beauty") == ["Combined"]

    def test_all(self):
        assert len(self.names("all")) == 21

    @pytest.mark.parametrize(
        ("text", "expected"),
        [
            ("Depth", ["Combined", "Depth"]),
            ("V.Depth", ["Combined", "Depth"]),
            ("*Depth", ["Combined", "Depth", "Denoising Depth"]),
            ("Crypto*, Mist", ["Combined", "Mist", "CryptoObject00", "CryptoObject01"]),
            ("beauty,UV", ["Combined", "UV"]),
        ],
    )
    def test_by_name(self, text, expected):
        assert self.names(text) == expected

    @pytest.mark.parametrize("text", ["depth", "Depth,Dpth", "X.*"])
    def test_a_name_that_matches_nothing_lists_the_layers(self, text):
        with pytest.raises(UsageError, match=r"matches no layer; there are V.Combined, V.Depth"):
            self.names(text)

    @pytest.mark.parametrize("text", ["", " , "])
    def test_nothing_is_refused(self, text):
        with pytest.raises(UsageError, match="--layers is empty"):
            self.names(text)
