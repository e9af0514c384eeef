"""Names of ids: hashes, manifests good and bad, and what --dynamic picks of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.errors import UsageError
from exwarp_cli.io import cryptomatte
from exwarp_cli.io.cryptomatte import (
    Manifest,
    find_dynamic_objects,
    hash_name,
    murmur3,
    parse_manifest,
    quote_name,
    read_manifest,
)
from tests.reference.ranked import identity
from tests.unit.cryptomatte_files import Style, found_in, manifest_of, write_cryptomatte

BLENDER = (
    '{"sun":"3e796cdb","house left":"bee6aa05","car wheel.001":"5e757b15",'
    '"Würfel "B"\\2":"e5129574","object":"055ec73d"}'
)
"""As Blender 5.0.1 writes it: no JSON."""
NAMES = ["sun", "house left", "car wheel.001", 'Würfel "B"\\2', "object"]


class TestHash:
    @pytest.mark.parametrize(
        ("text", "expected"),
        [
            (b"", 0),
            (b"a", 0x3C2569B2),
            (b"hello", 0x248BFA47),
            (b"hello, world", 0x149BBB7F),
            (b"The quick brown fox jumps over the lazy dog", 0x2E4FF723),
        ],
    )
    def test_published_values(self, text, expected):
        assert murmur3(text) == expected

    @pytest.mark.parametrize(
        ("name", "expected"),
        [
            ("bunny", 0x13851A76),  # the specification's
            ("default", 0x42C9679F),
            ('Würfel "B"\\2', 0xE5129574),  # Blender's
            ("/obj/box:polygons:1", 0x9D416418),  # Houdini's
        ],
    )
    def test_ids_as_renderers_make_them(self, name, expected):
        assert hash_name(name) == expected

    @given(st.text())
    def test_ids_are_finite_normal_floats(self, name):
        bits = np.uint32(hash_name(name))
        value = bits.view(np.float32)
        assert np.isfinite(value) and abs(value) >= np.finfo(np.float32).tiny
        # Only an exponent at either end is changed.
        hashed = murmur3(name.encode("utf-8", "surrogatepass"))
        assert int(bits) == hashed or (hashed >> 23 & 0xFF) in (0, 255)

    def test_exponents_are_clamped_to_the_nearest(self):
        found = {}
        for i in range(4000):
            hashed = murmur3(str(i).encode())
            if hashed >> 23 & 0xFF in (0, 255):
                found[hashed >> 23 & 0xFF] = hash_name(str(i)) >> 23 & 0xFF
        assert found == {0: 1, 255: 254}


class TestParsing:
    def test_blenders(self):
        with pytest.raises(ValueError):
            json.loads(BLENDER)
        assert parse_manifest(BLENDER) == {name: hash_name(name) for name in NAMES}

    @given(st.dictionaries(st.text(), st.integers(0, 2**32 - 1), max_size=6), st.booleans())
    def test_any_json(self, ids, ascii_only):
        text = json.dumps({n: f"{i:08x}" for n, i in ids.items()}, ensure_ascii=ascii_only)
        assert parse_manifest(text) == ids

    @given(st.lists(st.text(st.characters(exclude_characters='"')), max_size=6))
    def test_names_that_are_not_escaped(self, names):
        """Their hash tells that a backslash is a backslash."""
        entries = ",".join(f'"{name}":"{hash_name(name):08x}"' for name in names)
        assert parse_manifest(f"{{{entries}}}") == {name: hash_name(name) for name in names}

    @pytest.mark.parametrize("name", ["C:\\new\\table", "a\\u00e9", "\\\\server"])
    def test_backslashes_that_look_like_escapes(self, name):
        bits = f"{hash_name(name):08x}"
        as_it_stands, as_json = f'{{"{name}":"{bits}"}}', json.dumps({name: bits})
        assert parse_manifest(as_it_stands) == parse_manifest(as_json) == {name: hash_name(name)}

    def test_escapes_beside_what_should_have_been_escaped(self):
        assert parse_manifest('{"a\\"\n":"0000002a"}') == {'a"\n': 42}

    @pytest.mark.parametrize("cut", range(0, len(BLENDER), 7))
    def test_what_is_cut_off_loses_its_end_alone(self, cut):
        found = parse_manifest(BLENDER[:cut])
        whole = parse_manifest(BLENDER)
        assert list(found.items()) == list(whole.items())[: len(found)]
        assert len(found) >= BLENDER[:cut].count('",')

    def test_blanks_and_short_ids(self):
        text = '\n{ "a" : "1f" ,\n\t"b":"0000ABCD" }\n'
        assert parse_manifest(text) == {"a": 0x1F, "b": 0xABCD}

    @pytest.mark.parametrize(
        "text", ["", "{}", "[1,2]", "not a manifest", '{"a":1,"b":null}', "\0"]
    )
    def test_nothing_in_it(self, text):
        assert parse_manifest(text) == {}

    def test_time_grows_with_the_length_alone(self):
        """Text that would make a careless pattern look again and again: it ends at all."""
        for text in ('"' * 200_000, '"a":' * 60_000, '" ' * 100_000, '"":"' + "0" * 200_000):
            assert len(parse_manifest(text)) <= 1

    def test_bytes_that_are_no_text_keep_their_hash(self):
        name = b"W\xfcrfel".decode("utf-8", "surrogateescape")
        text = f'{{"{name}":"{hash_name(name):08x}"}}'
        assert parse_manifest(text) == {name: hash_name(name)}
        assert quote_name(name) == "'W?rfel'"
        assert hash_name("\ud800") != hash_name("\ud801")  # from JSON, and no bytes at all


SHARES = {name: np.ones((2, 2), np.float32) for name in ("ball", "box")}
IDS = {name: hash_name(name) for name in SHARES}


class TestReading:
    def manifest(self, path: Path, style: Style) -> Manifest:
        write_cryptomatte(path, SHARES, style)
        (found,) = found_in(path)
        return read_manifest(found, path)

    def test_from_the_header(self, tmp_path):
        found = self.manifest(tmp_path / "a.exr", Style())
        assert found == Manifest(IDS)

    @pytest.mark.parametrize(
        ("sidecar", "place"),
        [
            ("./m.json", "m.json"),
            ("../m.json", "../m.json"),
            ("sub\\m.json", "sub/m.json"),
            ("C:\\renders\\shot\\m.json", "m.json"),  # moved along with the frames
            ("/renders/shot/m.json", "m.json"),
        ],
    )
    def test_from_a_file_beside(self, tmp_path, sidecar, place):
        folder = tmp_path / "frames"
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(exist_ok=True)
        (folder / place).write_text("\ufeff" + manifest_of(list(SHARES)), encoding="utf-8")
        path = folder / "a.exr"
        write_cryptomatte(path, SHARES, Style(manifest="none"))
        (found,) = found_in(path)
        assert read_manifest(replace(found, sidecar=sidecar), path).ids == IDS

    @pytest.mark.parametrize(
        ("sidecar", "problem"),
        [
            ("gone.json", "its manifest 'gone.json' is not there"),
            (".", "its manifest '.' is not there"),
            ("x" * 5000, f"its manifest '{'x' * 59}…' is not there"),
            ("a\0b", "its manifest 'a?b' is not there"),
        ],
    )
    def test_files_that_are_not_there(self, tmp_path, sidecar, problem):
        path = tmp_path / "a.exr"
        write_cryptomatte(path, SHARES, Style(manifest="none"))
        (found,) = found_in(path)
        assert read_manifest(replace(found, sidecar=sidecar), path) == Manifest({}, problem)

    def test_without_any(self, tmp_path):
        found = self.manifest(tmp_path / "a.exr", Style(manifest="none"))
        assert found == Manifest({}, "its header has no manifest")

    def test_without_names(self, tmp_path):
        found = self.manifest(tmp_path / "a.exr", Style(manifest="oops"))
        assert found == Manifest({}, "its header's manifest holds no names that can be read")

    def test_too_large(self, tmp_path, monkeypatch):
        monkeypatch.setattr(cryptomatte, "MAX_MANIFEST_SIZE", 20)
        found = self.manifest(tmp_path / "a.exr", Style())
        assert found.ids == {} and "its header's manifest is larger than" in found.problem
        sidecar = tmp_path / "m.json"
        sidecar.write_text(" " * 21)
        found = self.manifest(tmp_path / "b.exr", Style(manifest=Path("m.json")))
        assert found.ids == {} and f"{sidecar} is larger than" in found.problem

    def test_bytes_that_are_no_text(self, tmp_path):
        name = b"W\xfcrfel".decode("utf-8", "surrogateescape")
        (tmp_path / "m.json").write_bytes(b'{"W\xfcrfel":"%08x"}' % hash_name(name))
        found = self.manifest(tmp_path / "b.exr", Style(manifest=Path("m.json")))
        assert found.ids == {name: hash_name(name)}

    @pytest.mark.parametrize("attribute", ["hash", "conversion"])
    def test_another_hash_is_known_by_its_manifest_alone(self, tmp_path, attribute):
        path = tmp_path / "a.exr"
        entry = {f"cryptomatte/d593dd7/{attribute}": "another"}
        write_cryptomatte(path, SHARES, Style(key=""), **entry, **{
            "cryptomatte/d593dd7/name": "crypto_object"
        })  # fmt: skip
        (found,) = found_in(path)
        manifest = read_manifest(found, path)
        assert not found.hashed and not manifest.hashed
        with pytest.raises(UsageError, match="its header has no manifest; render with a manifest"):
            find_dynamic_objects("ball", [manifest], "shot")


def manifest(*names: str) -> Manifest:
    return Manifest({name: hash_name(name) for name in names})


class TestDynamic:
    FRAMES = (manifest("car", "car wheel.1", "ground"), manifest("car", "ball", "Ball", "a[1]"))

    @pytest.mark.parametrize(
        ("option", "names"),
        [
            ("ball", ("ball",)),
            ("car*", ("car", "car wheel.1")),
            ("ball, car", ("ball", "car")),
            ("?all", ("Ball", "ball")),
            ("[Bc]a*", ("Ball", "car", "car wheel.1")),
            ("a[1]", ("a[1]",)),  # a whole name, though it looks like a pattern
            ("*", ("Ball", "a[1]", "ball", "car", "car wheel.1", "ground")),
        ],
    )
    def test_names_of_all_frames(self, option, names):
        found = find_dynamic_objects(option, self.FRAMES, "shot")
        assert found.names == names
        assert found.ids == tuple(sorted(identity(hash_name(name)) for name in names))

    def test_one_glob_without_a_match_is_an_error(self):
        with pytest.raises(UsageError) as caught:
            find_dynamic_objects("car*,lorry*", self.FRAMES, "shot")
        assert str(caught.value) == (
            "--dynamic 'lorry*' matches no name in the Cryptomatte manifests, which have 'Ball', "
            "'a[1]', 'ball', 'car', 'car wheel.1', 'ground'; name objects of these"
        )

    def test_few_of_many_names_are_listed(self):
        many = manifest(*(f"object\n{i:04d}" for i in range(500)))
        with pytest.raises(UsageError, match="'object\\?0007' and 492 more; name") as caught:
            find_dynamic_objects("car", [many], "shot")
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize("option", ["", " , "])
    def test_nothing_named(self, option):
        with pytest.raises(UsageError, match="--dynamic names nothing"):
            find_dynamic_objects(option, self.FRAMES, "shot")

    def test_whole_names_need_no_manifest(self):
        frames = [Manifest(problem="its header has no manifest")] * 2
        found = find_dynamic_objects("ball,box", frames, "shot")
        assert found.ids == tuple(sorted(identity(hash_name(name)) for name in ("ball", "box")))
        with pytest.raises(UsageError) as caught:
            find_dynamic_objects("ball,b*", frames, "shot")
        assert str(caught.value) == (
            "--dynamic 'b*' cannot be looked up: shot has no names, as its header has no manifest; "
            "give whole names, or render with a manifest"
        )

    def test_a_name_with_another_id_in_another_frame(self):
        other = Manifest({"ball": 0x12345678})
        found = find_dynamic_objects("ball", [*self.FRAMES, other], "shot")
        assert found.ids == tuple(sorted((identity(hash_name("ball")), 0x12345678)))
