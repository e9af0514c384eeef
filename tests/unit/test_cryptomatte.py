"""Cryptomattes found in files: layers, what the header tells, and which is the best stencil."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.errors import DamagedFileError, LayoutError
from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.cryptomatte import (
    IdKind,
    find_cryptomattes,
    find_dynamic_objects,
    hash_name,
    read_manifest,
    require_lossless_ids,
    surface_ids,
)
from exwarp_cli.io.exr.reader import ExrFile
from tests.reference.ranked import identity
from tests.unit.cryptomatte_files import (
    COMPRESSIONS,
    SPELLINGS,
    Style,
    attributes_of,
    found_in,
    headers_of,
    planes_of,
    ranks_in,
    write_cryptomatte,
)
from tests.unit.exr_files import plane, rgba, write_parts, write_single

LEFT, RIGHT = np.zeros((6, 8), np.float32), np.zeros((6, 8), np.float32)
LEFT[:, :4], RIGHT[:, 5:] = 1, 1
SHARES = {"left": LEFT, "right": RIGHT}
EXPECTED = np.where(
    LEFT > 0, identity(hash_name("left")), np.where(RIGHT > 0, identity(hash_name("right")), 0)
)


def write(path: Path, style: Style | None = None, multipart: bool = False, **attributes) -> Path:
    return write_cryptomatte(path, SHARES, style, rgba(6, 8), multipart, **attributes)


def names_of(path: Path, beside: str = "") -> list[str]:
    return [cryptomatte.name for cryptomatte in found_in(path, beside)]


class TestLayers:
    @pytest.mark.parametrize("multipart", [False, True])
    @pytest.mark.parametrize("spelling", SPELLINGS)
    def test_channels_in_order_and_ids(self, tmp_path, spelling, multipart):
        path = write(tmp_path / "a.exr", Style(spelling=spelling), multipart)
        (found,) = found_in(path)
        assert (found.aov, found.name, len(found.ranks)) == ("", "crypto_object", 3)
        letters = SPELLINGS[spelling]
        assert found.ranks[1] == tuple(ChannelRef("", f"crypto_object01.{c}") for c in letters)
        assert [len(rank) for rank in found.ranks] == [4, 4, 4]
        np.testing.assert_array_equal(surface_ids(ranks_in(path, found)), EXPECTED)

    def test_parts_whose_channels_have_no_layer(self, tmp_path):
        layers = planes_of(SHARES, Style("VRayCryptomatte", spelling="upper"))
        parts = {"rgb": (rgba(6, 8), attributes_of([], Style("VRayCryptomatte", manifest="none")))}
        for layer, planes in layers.items():
            parts[layer] = ({name[-1]: plane for name, plane in planes.items()}, {})
        path = write_parts(tmp_path / "a.exr", parts)
        (found,) = found_in(path)
        assert found.ranks[0][0].name == "VRayCryptomatte00.R"
        np.testing.assert_array_equal(surface_ids(ranks_in(path, found)), EXPECTED)

    @pytest.mark.parametrize(
        ("name", "stated"),
        [
            ("ViewLayer.CryptoObject", "ViewLayer.CryptoObject"),  # Blender
            ("ViewLayer.CryptoObject", "CryptoObject"),
            ("CryptoObject", "ViewLayer.CryptoObject"),
            ("ViewLayer_CryptoObject", "CryptoObject"),
            ("uCryptoMaterial", "uCryptoMaterial"),
            ("ActorHitProxyMask", "ActorHitProxyMask"),  # Unreal
            ("Objekte größer", "Objekte größer"),
            ("ids of things", "ids of things"),  # any name, as the header tells it
            ("crypto_object", ""),  # the header was lost
        ],
    )
    def test_names(self, tmp_path, name, stated):
        path = write(tmp_path / "a.exr", Style(name, stated, key="abc" if stated else ""))
        (found,) = found_in(path)
        assert found.name == name
        assert (found.manifest is not None) == bool(stated)

    def test_a_header_that_a_compositor_wrote_on(self, tmp_path):
        attributes = {
            f"exr/{name}": text for name, text in attributes_of(["left"], Style()).items()
        }
        planes = planes_of(SHARES, Style())["crypto_object00"] | rgba(6, 8)
        path = write_single(tmp_path / "a.exr", planes, **attributes)
        (found,) = found_in(path)
        assert list(read_manifest(found, path).ids) == ["left"]

    def test_what_is_none(self, tmp_path):
        others = {f"light{n}.{c}": plane(6, 8, 1) for n in ("00", "01") for c in "RGBA"}
        others |= {f"crypto_object.{c}": plane(6, 8, 1) for c in "RGBA"}  # a preview
        others |= {f"crypto_asset00.{c}": plane(6, 8, 1) for c in "RGB"}  # a channel is missing
        others |= {f"crypto_material01.{c}": plane(6, 8, 1) for c in "RGBA"}  # no first layer
        others |= {f"grid00.{c}": plane(6, 8, 1) for c in "RGBA"}
        attributes = {"cryptomatte/abc/name": "id"}  # whose layers are not there
        assert names_of(write_single(tmp_path / "a.exr", others, **attributes)) == []
        assert names_of(write_single(tmp_path / "b.exr", rgba(6, 8))) == []

    def test_ranks_end_at_a_gap(self, tmp_path):
        planes = planes_of(SHARES, Style())
        kept = planes["crypto_object00"] | planes["crypto_object02"] | rgba(6, 8)
        (found,) = found_in(write_single(tmp_path / "a.exr", kept))
        assert len(found.ranks) == 1

    def test_a_frame_of_several_files(self, tmp_path):
        path = write(tmp_path / "crypto.exr")
        beauty = write_single(tmp_path / "beauty.exr", rgba(6, 8))
        channels, headers = {}, {}
        for aov, one in (("", beauty), ("crypto", path)):
            with ExrFile(one) as file:
                channels[aov] = file.parts[0].channels
            headers[aov] = headers_of(one)
        (found,) = find_cryptomattes(channels, headers)
        assert found.ranks[0][0] == ChannelRef("crypto", "crypto_object00.r")
        assert found.manifest is not None


class TestChoice:
    def write_all(self, path: Path, names: list[str]) -> Path:
        planes = rgba(6, 8)
        attributes: dict[str, str] = {}
        for i, name in enumerate(names):
            style = Style(name, key=f"key{i}")
            for layer in planes_of(SHARES, style, 2).values():
                planes |= layer
            attributes |= attributes_of([name], style)
        return write_single(path, planes, **attributes)

    def test_objects_come_first(self, tmp_path):
        names = ["crypto_material", "crypto_asset", "crypto_wood", "crypto_object"]
        path = self.write_all(tmp_path / "a.exr", names)
        found = found_in(path)
        assert [one.name for one in found] == names[::-1]
        assert [one.kind for one in found] == [
            IdKind.OBJECT, IdKind.OTHER, IdKind.ASSET, IdKind.MATERIAL
        ]  # fmt: skip
        # Each has its own entry of the header.
        assert [list(read_manifest(one, path).ids) for one in found] == [[n] for n in names[::-1]]

    def test_the_view_layer_of_the_beauty_before_others(self, tmp_path):
        names = ["A.CryptoObject", "B.CryptoMaterial", "B.CryptoAsset"]
        path = self.write_all(tmp_path / "a.exr", names)
        assert names_of(path, "A.Combined.R") == [names[0], names[2], names[1]]
        assert names_of(path, "B.Combined.R") == [names[2], names[1], names[0]]

    def test_names_that_contain_each_other(self, tmp_path):
        names = ["Object", "CryptoObject", "CryptoObjectMaterial", "Material"]
        path = self.write_all(tmp_path / "a.exr", names)
        listed = {one.name: list(read_manifest(one, path).ids) for one in found_in(path)}
        assert listed == {name: [name] for name in names}

    def test_the_entry_that_says_most(self, tmp_path):
        planes = rgba(6, 8)
        for layer in planes_of(SHARES, Style("A.crypto_object"), 2).values():
            planes |= layer
        attributes: dict[str, str] = {}
        for key, name in (("1", "object"), ("2", "crypto_object")):
            attributes |= attributes_of([name], Style(name, key=key))
        path = write_single(tmp_path / "a.exr", planes, **attributes)
        (found,) = found_in(path)
        assert list(read_manifest(found, path).ids) == ["crypto_object"]


class TestPrecision:
    def test_half_ids_are_refused(self, tmp_path):
        with np.errstate(over="ignore"):
            path = write(tmp_path / "a.exr", Style(dtype=np.float16))
        (found,) = found_in(path)
        with pytest.raises(LayoutError) as caught:
            found.require_exact(str(path))
        assert str(caught.value) == (
            f"{path} does not hold the ids of its Cryptomatte 'crypto_object' as 32-bit floats, so "
            "they cannot be distinguished; write that pass as 32-bit float, not half"
        )

    def test_floats_are_exact(self, tmp_path):
        path = write(tmp_path / "a.exr")
        (found,) = found_in(path)
        found.require_exact(str(path))
        assert not found.rounded

    @pytest.mark.parametrize("multipart", [False, True])
    def test_pxr24_rounds_ids_and_names_alike(self, tmp_path, multipart):
        attributes = {"compression": COMPRESSIONS["pxr24"]}
        path = write(tmp_path / "a.exr", Style(), multipart, **attributes)
        (found,) = found_in(path)
        found.require_exact(str(path))
        assert found.rounded
        ranks = ranks_in(path, found)
        require_lossless_ids(ranks, str(path))
        ids = surface_ids(ranks, rounded=True)
        manifest = read_manifest(found, path)
        for name, column in (("left", 0), ("right", 7)):
            dynamic = find_dynamic_objects(name, [manifest], "a", rounded=True)
            assert dynamic.ids == (ids[0, column],)
        # And as a file that lost nothing has them, when that one's are rounded too.
        (exact,) = found_in(other := write(tmp_path / "b.exr"))
        np.testing.assert_array_equal(surface_ids(ranks_in(other, exact), rounded=True), ids)

    def test_dwa_destroys_ids_in_upper_case_channels(self, tmp_path):
        count = 12
        shares = {f"object {i}": np.zeros((48, 64), np.float32) for i in range(count)}
        for i, one in enumerate(shares.values()):
            one.reshape(-1, 64)[4 * i : 4 * i + 4] = 1
        attributes = {"compression": COMPRESSIONS["dwaa"]}
        for spelling, damaged in (("upper", True), ("lower", False)):
            path = tmp_path / f"{spelling}.exr"
            write_cryptomatte(path, shares, Style(spelling=spelling), **attributes)
            (found,) = found_in(path)
            if damaged:
                with pytest.raises(DamagedFileError, match="lossy compression"):
                    require_lossless_ids(ranks_in(path, found), str(path))
            else:
                require_lossless_ids(ranks_in(path, found), str(path))
