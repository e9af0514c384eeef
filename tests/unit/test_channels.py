"""Recognising channels by name."""

from __future__ import annotations

import pytest

from exwarp_cli.domain.motion import PRESETS, AxisMap, MotionConvention
from exwarp_cli.io.channels import (
    CRYPTOMATTE_NAME,
    Layout,
    Role,
    detect_layout,
)
from exwarp_cli.io.exr.header import Channel


def channels(*names: str) -> list[Channel]:
    return [Channel(0, i, name, name, "float") for i, name in enumerate(names)]


def expand(*layers: str) -> list[str]:
    """Spell out ``layer.XYZ``: one channel for every letter after the last dot."""
    out = []
    for spec in layers:
        layer, _, letters = spec.rpartition(".")
        out += [f"{layer}.{letter}" if layer else letter for letter in letters]
    return out


def found(*layers: str) -> Layout:
    return detect_layout({"": channels(*expand(*layers))})


def names(layout: Layout, role: Role) -> list[str]:
    return [ref.name for ref in layout.roles.get(role, ())]


BLENDER_5 = (
    "ViewLayer.Combined.RGBA",
    "ViewLayer.Depth.Z",
    "ViewLayer.Position.XYZ",
    "ViewLayer.Normal.XYZ",
    "ViewLayer.Vector.XYZW",
    "ViewLayer.Object Index.X",
    "ViewLayer.Diffuse Color.RGB",
    "ViewLayer.Glossy Color.RGB",
    "ViewLayer.CryptoObject00.rgba",
)


class TestBlender:
    def test_multi_part_names(self):
        layout = found(*BLENDER_5)
        assert names(layout, Role.COLOUR) == expand("ViewLayer.Combined.RGBA")
        assert names(layout, Role.DEPTH) == ["ViewLayer.Depth.Z"]
        assert names(layout, Role.POSITION) == expand("ViewLayer.Position.XYZ")
        assert names(layout, Role.NORMAL) == expand("ViewLayer.Normal.XYZ")
        assert names(layout, Role.MOTION) == expand("ViewLayer.Vector.XYZW")
        assert names(layout, Role.STENCIL) == ["ViewLayer.Object Index.X"]
        assert names(layout, Role.ALBEDO) == expand("ViewLayer.Diffuse Color.RGB")
        assert names(layout, Role.SPECULAR) == expand("ViewLayer.Glossy Color.RGB")
        assert layout.guess == PRESETS["blender"] and layout.producer == "Blender"

    @pytest.mark.parametrize(
        "prefix", ["View Layer.", "RenderLayer.", "Hero shot.v2.", "été_01.", ""]
    )
    def test_old_names_under_any_layer_name(self, prefix):
        layout = found(
            *(f"{prefix}{name}" for name in ("Combined.RGBA", "Depth.Z", "Vector.XYZW")),
            *(f"{prefix}{name}" for name in ("IndexOB.X", "IndexMA.X", "DiffCol.RGB")),
        )
        assert names(layout, Role.COLOUR) == expand(f"{prefix}Combined.RGBA")
        assert names(layout, Role.DEPTH) == [f"{prefix}Depth.Z"]
        assert names(layout, Role.MOTION) == expand(f"{prefix}Vector.XYZW")
        assert names(layout, Role.STENCIL) == [f"{prefix}IndexOB.X"]
        assert names(layout, Role.ALBEDO) == expand(f"{prefix}DiffCol.RGB")
        assert layout.guess == PRESETS["blender"]

    def test_components_come_in_their_order_whatever_the_file_s(self):
        # OpenEXR sorts channels by name: A B G R, and W X Y Z.
        layout = detect_layout(
            {"": channels("V.Combined.A", "V.Combined.B", "V.Combined.G", "V.Combined.R",
                          "V.Vector.W", "V.Vector.X", "V.Vector.Y", "V.Vector.Z")}
        )  # fmt: skip
        assert [ref.component for ref in layout.roles[Role.COLOUR]] == list("RGBA")
        assert [ref.component for ref in layout.roles[Role.MOTION]] == list("XYZW")

    @pytest.mark.parametrize("first", ["A", "B"])
    def test_of_several_view_layers_the_first_counts_throughout(self, first):
        second = "B" if first == "A" else "A"
        layers = ("Combined.RGBA", "Depth.Z", "Vector.XYZW", "Normal.XYZ")
        layout = found(*(f"{name}.{layer}" for name in (first, second) for layer in layers))
        for refs in layout.roles.values():
            assert {ref.name.split(".")[0] for ref in refs} == {first}

    def test_geometry_of_another_view_layer_is_no_better_for_its_name(self):
        layout = found("Fog.Vector.XYZW", "Fog.Depth.Z", "Main.Combined.RGBA", "Main.velocity.XY",
                       "Main.hero_depth.Z")  # fmt: skip
        assert names(layout, Role.MOTION) == expand("Main.velocity.XY")
        assert names(layout, Role.DEPTH) == ["Main.hero_depth.Z"]

    def test_passes_for_denoising_are_no_geometry(self):
        # Blender follows mirrors in them, and the normals are the camera's.
        layout = found("V.Combined.RGBA", "V.Denoising Normal.XYZ", "V.Denoising Depth.Z",
                       "V.Denoising Albedo.RGB", "V.Noisy Image.RGBA")  # fmt: skip
        assert set(layout.roles) == {Role.COLOUR}

    def test_geometry_comes_from_the_layer_of_the_colour_where_it_is(self):
        layout = found("Fog.Depth.Z", "Fog.Vector.XYZW", "Main.Combined.RGBA", "Main.Depth.Z")
        assert names(layout, Role.DEPTH) == ["Main.Depth.Z"]
        assert names(layout, Role.MOTION) == expand("Fog.Vector.XYZW")

    def test_cryptomatte_is_taken_for_nothing(self):
        layout = found("V.CryptoObject00.rgba", "V.CryptoMaterial00.rgba", "V.Depth.Z")
        assert set(layout.roles) == {Role.DEPTH}


class TestPlain:
    def test_forward_alone(self):
        layout = found("RGBA", "Z", "forward.uv")
        assert names(layout, Role.COLOUR) == list("RGBA")
        assert names(layout, Role.DEPTH) == ["Z"]
        assert names(layout, Role.MOTION) == ["forward.u", "forward.v"]
        assert layout.guess == PRESETS["forward"] and layout.producer == "Nuke convention"

    def test_backward_alone(self):
        layout = found("RGB", "backward.uv")
        assert names(layout, Role.COLOUR) == list("RGB")
        assert layout.guess == PRESETS["backward"]

    @pytest.mark.parametrize(
        "order", [("forward.uv", "backward.uv"), ("backward.uv", "forward.uv")]
    )
    def test_both_forward_first(self, order):
        layout = found("RGBA", *order)
        assert names(layout, Role.MOTION) == expand("forward.uv", "backward.uv")
        assert layout.guess == PRESETS["forward+backward"]

    def test_lower_case(self):
        layout = found("rgba", "z", "motion.xy", "n.xyz", "p.xyz", "id")
        assert names(layout, Role.COLOUR) == list("rgba")
        assert names(layout, Role.DEPTH) == ["z"]
        assert names(layout, Role.MOTION) == ["motion.x", "motion.y"]
        assert names(layout, Role.NORMAL) == expand("n.xyz")
        assert names(layout, Role.POSITION) == expand("p.xyz")
        assert layout.guess is None and layout.producer == "unknown"

    @pytest.mark.parametrize("name", ["id", "ID"])
    def test_a_bare_id(self, name):
        layout = detect_layout({"": channels("R", "G", "B", name)})
        assert names(layout, Role.STENCIL) == [name]

    @pytest.mark.parametrize(
        "layer", ["depth.Z", "SceneDepth.R", "Z-Depth.V", "shot_01.depth.y", "Z.R"]
    )
    def test_depth_under_other_names(self, layer):
        assert names(found("RGB", layer), Role.DEPTH) == [layer]

    @pytest.mark.parametrize("layer", ["motionvector.RG", "velocity.XY", "Motion Vectors.uv"])
    def test_motion_of_unknown_meaning(self, layer):
        layout = found("RGB", layer)
        assert names(layout, Role.MOTION) == expand(layer) and layout.guess is None

    @pytest.mark.parametrize(
        "prefix", ["hero_", "hero-", "shot 10 ", "sc010:", "A.B.hero_", "FinalImage_"]
    )
    def test_geometry_under_a_prefix(self, prefix):
        layers = ("world_position.XYZ", "depth.Z", "motionVectors.RG", "WorldNormal.RGB")
        layout = found("RGB", *(f"{prefix}{layer}" for layer in layers))
        for role, layer in zip(
            (Role.POSITION, Role.DEPTH, Role.MOTION, Role.NORMAL), layers, strict=True
        ):
            assert names(layout, role) == expand(f"{prefix}{layer}")

    def test_a_name_of_its_own_is_preferred_to_one_with_a_prefix(self):
        layout = found("RGB", "volume_depth.Z", "depth.Z", "coat_normal.XYZ", "N.XYZ")
        assert names(layout, Role.DEPTH) == ["depth.Z"]
        assert names(layout, Role.NORMAL) == expand("N.XYZ")

    @pytest.mark.parametrize(
        "layer", ["spec_color.RGB", "spec_rgb.RGB", "light_id.X", "mask_z.R", "tangent_n.XYZ",
                  "coat_roughness.X", "clear coat albedo.RGB", "view_vector.XYZW"]
    )  # fmt: skip
    def test_last_words_that_say_nothing(self, layer):
        assert set(found("RGB", layer).roles) == {Role.COLOUR}

    @pytest.mark.parametrize(
        "layer", ["shadow_depth.Z", "camera_normal.XYZ", "view position.XYZ", "rest_position.XYZ",
                  "bump_normal.RGB", "variance_depth.Z", "id.RGB", "motion blur amount.RG"]
    )  # fmt: skip
    def test_what_only_sounds_like_geometry(self, layer):
        assert set(found("RGB", layer).roles) == {Role.COLOUR}

    def test_words_before_that_change_nothing(self):
        layout = found("RGB", "camera_depth.Z", "shadow pass depth.Z", "object_world_position.XYZ")
        assert names(layout, Role.DEPTH) == ["camera_depth.Z"]
        assert names(layout, Role.POSITION) == expand("object_world_position.XYZ")

    def test_mv_is_the_only_short_name_that_ends_longer_ones(self):
        layout = found("RGB", "scene_mv.RG", "scene_id.X", "scene_z.R")
        assert names(layout, Role.MOTION) == expand("scene_mv.RG")
        assert set(layout.roles) == {Role.COLOUR, Role.MOTION}

    def test_a_beauty_without_shadows_and_noise(self):
        layout = found("noisy_beauty.RGB", "shadow_beauty.RGB", "x_beauty.RGB")
        assert names(layout, Role.COLOUR) == expand("x_beauty.RGB")

    def test_a_bare_z_is_depth_before_pictures_of_it(self):
        assert names(found("RGBA", "zdepth.R", "depth.RGB", "Z"), Role.DEPTH) == ["Z"]
        assert Role.DEPTH not in found("XYZ")

    def test_words_for_components(self):
        layout = detect_layout(
            {"": channels(*(f"rgba.{c}" for c in ("red", "green", "blue", "alpha")))}
        )
        assert [ref.component for ref in layout.roles[Role.COLOUR]] == [
            "red", "green", "blue", "alpha",
        ]  # fmt: skip

    def test_a_bare_word_is_a_layer(self):
        layout = detect_layout({"": channels("R", "G", "B", "zdepth", "renderId")})
        assert names(layout, Role.DEPTH) == ["zdepth"]
        assert names(layout, Role.STENCIL) == ["renderId"]

    def test_red_and_green_alone_are_vectors(self):
        layout = found("RG")
        assert names(layout, Role.MOTION) == ["R", "G"]
        assert layout.producer == "ReelSmart or Twixtor"
        assert found("RG", "Z").roles.keys() == {Role.DEPTH}

    def test_a_lone_rgb_layer_of_any_name_is_colour(self):
        assert names(found("foo.RGB", "Z"), Role.COLOUR) == expand("foo.RGB")
        assert Role.COLOUR not in found("foo.RGB", "bar.RGB")
        assert Role.COLOUR not in found("Normal.RGB")

    def test_the_beauty_is_preferred_to_other_layers(self):
        layout = found("spec.RGB", "beauty.RGB", "DiffCol.RGB")
        assert names(layout, Role.COLOUR) == expand("beauty.RGB")
        assert names(found("beauty.RGB", "RGBA"), Role.COLOUR) == list("RGBA")

    def test_half_a_layer_is_not_taken_and_it_is_said(self):
        layout = found("R", "forward.u", "Normal.XY", "Vector.XZ")
        assert layout.roles == {} and layout.guess is None
        assert layout.incomplete == {
            Role.MOTION: "'Vector' has only X, Z",
            Role.NORMAL: "'Normal' has only X, Y",
        }

    def test_half_of_the_vectors_beside_whole_ones_is_said_too(self):
        layout = found("RGB", "forward.uv", "backward.u")
        assert layout.guess == PRESETS["forward"]
        assert layout.incomplete == {Role.MOTION: "'backward' has only u"}

    def test_unknown_names(self):
        layout = found("foo.X", "bar.QW", "mask")
        assert layout.roles == {} and layout.producer == "unknown"
        assert Role.DEPTH not in layout


class TestBlendersFileOutput:
    @pytest.mark.parametrize(("letters", "used"), [("XYZ", "XY"), ("XY", "XY"), ("RGB", "RG")])
    def test_x_and_y_lead_to_the_previous_frame(self, letters, used):
        layout = found("Image.RGBA", "Depth.V", f"Vector.{letters}")
        assert names(layout, Role.COLOUR) == expand("Image.RGBA")
        assert names(layout, Role.DEPTH) == ["Depth.V"]
        assert names(layout, Role.MOTION) == expand(f"Vector.{used}")
        assert layout.producer == "Blender" and layout.incomplete == {}
        assert layout.guess == MotionConvention(AxisMap(0, 1, 1, -1), None)

    def test_four_components_under_a_colour_s_letters(self):
        layout = found("RGBA", "Vector.RGBA")
        assert names(layout, Role.MOTION) == expand("Vector.RGBA")
        assert layout.guess == PRESETS["blender"]

    def test_vectors_by_both_names_are_preferred(self):
        assert names(found("RGB", "Vector.XYZ", "forward.uv"), Role.MOTION) == expand("forward.uv")


class TestUnreal:
    def test_one_file_per_aov(self):
        aovs = {
            "": "RGBA", "MotionVector": "RG", "SceneDepth": "R", "WorldNormal": "RGB",
            "WorldPosition": "RGB", "MyStencil": "R", "BaseColor": "RGB", "Roughness": "R",
            "Metallic": "R", "NoV": "R",
        }  # fmt: skip
        layout = detect_layout({aov: channels(*letters) for aov, letters in aovs.items()})
        expected = {
            Role.COLOUR: "", Role.MOTION: "MotionVector", Role.DEPTH: "SceneDepth",
            Role.NORMAL: "WorldNormal", Role.POSITION: "WorldPosition",
            Role.STENCIL: "MyStencil", Role.ALBEDO: "BaseColor", Role.ROUGHNESS: "Roughness",
            Role.METALLIC: "Metallic",
        }  # fmt: skip
        assert {role: {ref.aov for ref in refs} for role, refs in layout.roles.items()} == {
            role: {aov} for role, aov in expected.items()
        }
        assert [ref.component for ref in layout.roles[Role.MOTION]] == ["R", "G"]
        assert layout.guess == PRESETS["unreal"] and layout.producer.startswith("Unreal")

    def test_files_with_more_letters_than_they_need(self):
        layout = detect_layout({"MotionVector": channels(*"RGBA"), "SceneDepth": channels(*"RGBA")})
        assert [ref.component for ref in layout.roles[Role.MOTION]] == ["R", "G"]
        assert names(layout, Role.DEPTH) == ["R"]


class TestThirdChannel:
    """What may be a vector's length, or the alpha that it is premultiplied by."""

    @pytest.mark.parametrize(
        ("layers", "taken", "producer"),
        [
            (("RGBA", "motionvector.RGB"), ["R", "G", "B"], "Arnold"),
            (("RGBA", "motionvector.RG", "N.XYZ"), ["R", "G"], "Arnold"),
            (("RGBA", "motionvector.RG", "hitPz.R"), ["R", "G"], "Karma"),
            (("RGBA", "velocity.XYZ"), ["X", "Y", "Z"], "V-Ray"),
            (("RGBA", "velocity.RG", "renderId.R"), ["R", "G"], "V-Ray"),
            (("RGBA", "velocity.RG"), ["R", "G"], "unknown"),
            (("RGBA", "MotionVectors.RG"), ["R", "G"], "Redshift"),
            (("RGBA", "motion_vectors.RG"), ["R", "G", "A"], "MoonRay"),
            (("RGB", "motion_vectors.RG"), ["R", "G"], "MoonRay"),
        ],
    )
    def test_it_is_taken_along(self, layers, taken, producer):
        layout = found(*layers)
        assert [ref.component for ref in layout.roles[Role.MOTION]] == taken
        assert layout.producer == producer
        assert layout.guess is None or layout.guess.count <= len(taken)

    def test_the_guess_does_without_what_is_not_there(self):
        assert found("RGB", "motion_vectors.RG").guess == MotionConvention(
            None, AxisMap(0, 1, 0.5, -0.5), of_frame=True
        )
        assert found("RGB", "motionvector.RG", "P.XYZ").guess == PRESETS["forward"]

    @pytest.mark.parametrize(
        ("layer", "guess"),
        [
            ("motionFore.XY", MotionConvention(None, AxisMap(0, 1, 1, 1))),
            ("motionBack.XY", MotionConvention(AxisMap(0, 1, 1, 1), None)),
        ],
    )
    def test_one_direction_of_two(self, layer, guess):
        layout = found("RGB", layer)
        assert (layout.guess, layout.producer) == (guess, "RenderMan")


@pytest.mark.parametrize(
    "layer",
    ["crypto_object", "crypto_object00", "A.CryptoMaterial02", "CryptoAsset00", "Cryptomatte00",
     "ActorHitProxyMask00", "FinalImage_ActorHitProxyMask01"],
)  # fmt: skip
def test_cryptomatte_by_its_usual_names(layer):
    assert CRYPTOMATTE_NAME.search(layer)
    assert found(f"{layer}.RGBA").roles == {}


@pytest.mark.parametrize("layer", ["object", "cryptid.mask", "HitProxy", "uCryptomatteManifest.x"])
def test_other_names_are_no_cryptomatte(layer):
    assert not CRYPTOMATTE_NAME.search(layer)
