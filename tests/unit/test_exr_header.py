"""Headers whose text is no UTF-8, in and out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from exwarp_cli.domain.frame import Image, Window
from exwarp_cli.errors import DamagedFileError
from exwarp_cli.io import generated_frames
from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.exr.header import attributes_in, in_utf8, replace_non_utf8, restore_non_utf8
from exwarp_cli.io.exr.reader import ExrFile, read_headers
from exwarp_cli.io.exr.writer import ViewLayers, read_template
from tests.unit.exr_files import header, rgba, write_parts, write_single

MANIFEST = "cryptomatte/d593dd7/manifest"
RAW = '{"Bäume":"0123abcd"}'.encode("latin-1")
TEXT = RAW.decode("utf-8", "surrogateescape")
GOOD = {"owner": "Käthe", "exposure": 2.5, "software": "one"}


def latin(path: Path, marked: str = "B\x02ume") -> Path:
    """Put a Latin-1 letter wherever a file's text has the mark."""
    data = path.read_bytes()
    assert marked.encode() in data
    path.write_bytes(data.replace(marked.encode(), marked.encode().replace(b"\x02", b"\xe4")))
    return path


def single(path: Path, **more: object) -> Path:
    written = {MANIFEST: '{"B\x02ume":"0123abcd"}', **GOOD, **more}
    return latin(write_single(path, rgba(3, 4), **written))


def double(path: Path) -> Path:
    """Two parts, of which the second has the text; both have one of the same name and length."""
    parts = {
        "V.Combined": (
            {f"V.Combined.{c}": p for c, p in rgba(3, 4).items()},
            {"note": "B\x01ume", **GOOD},
        ),
        "V.Dirt": ({"V.Dirt.X": rgba(3, 4)["R"]}, {"note": "B\x02ume"}),
    }
    return latin(write_parts(path, parts))


def rewritten(source: Path, out: Path, *wanted: ViewLayers) -> Path:
    kept = read_template(source, wanted)
    image = Image(np.ones((3, 4, 4), np.float32), Window(0, 0, 4, 3), Window(0, 0, 4, 3))
    image_planes = {plane.key for plane in kept.colour}
    blank = generated_frames.Plane(np.zeros((3, 4), np.float32), image.data_window)
    beside = {p.key: blank for part in kept.parts for p in part.planes if p.key not in image_planes}
    generated_frames.write_picture(out, image, kept, {generated_frames.FINGERPRINT: "abc"}, beside)
    return out


def refs(prefix: str = "") -> tuple[ChannelRef, ...]:
    return tuple(ChannelRef("", prefix + c) for c in "RGBA")


class TestReading:
    def test_bytes_are_kept_as_the_decoder_keeps_them(self, tmp_path):
        path = single(tmp_path / "a.exr")
        with pytest.raises(UnicodeDecodeError):
            OpenEXR.File(str(path), header_only=True)
        (found,) = read_headers(path)
        with ExrFile(path) as file:
            assert found[MANIFEST] == file.header.texts[0][MANIFEST] == TEXT
        assert {name: found[name] for name in GOOD} == GOOD
        assert found["compression"] == OpenEXR.ZIP_COMPRESSION

    def test_of_parts_each_keeps_its_own(self, tmp_path):
        first, second = read_headers(double(tmp_path / "a.exr"))
        assert (first["note"], second["note"]) == ("B\x01ume", "B\udce4ume")

    def test_what_has_such_a_name_is_left_out(self, tmp_path):
        path = single(tmp_path / "a.exr", **{"B\x02ume": "text", "list": ["one", "B\x02ume"]})
        (found,) = read_headers(path)
        left_out = set(read_headers(write_single(tmp_path / "b.exr", rgba(3, 4), **GOOD))[0])
        assert set(found) - left_out == {MANIFEST}

    def test_channels_with_such_names(self, tmp_path):
        planes = rgba(3, 4) | {"B\x02ume.X": rgba(3, 4)["R"]}
        path = latin(write_single(tmp_path / "a.exr", planes, **GOOD))
        assert read_headers(path)[0]["owner"] == GOOD["owner"]

    @pytest.mark.parametrize("size", [0, 5, 20, 90, 250])
    def test_cut_off(self, tmp_path, size):
        path = single(tmp_path / "a.exr")
        path.write_bytes(path.read_bytes()[:size])
        with pytest.raises(DamagedFileError, match=r"a\.exr"):
            read_headers(path)
        with pytest.raises(ValueError, match=r"OpenEXR|end|found"):
            in_utf8(path.read_bytes())

    def test_what_is_utf8_stays(self, tmp_path):
        data = write_single(tmp_path / "a.exr", rgba(3, 4), **GOOD).read_bytes()
        assert in_utf8(data) == (data, {})
        assert replace_non_utf8("Käthe") == "Käthe"
        assert len(replace_non_utf8(TEXT).encode()) == len(RAW)
        names = [one.name.decode() for one in attributes_in(data)]
        assert sorted(names) == sorted({*read_headers(tmp_path / "a.exr")[0]})
        assert set(header(**GOOD)) <= set(names)


class TestWriting:
    def test_bytes_are_written_as_they_were(self, tmp_path):
        out = rewritten(single(tmp_path / "a.exr"), tmp_path / "b.exr", ViewLayers("", "", refs()))
        assert RAW in out.read_bytes()
        assert read_headers(out)[0][MANIFEST] == TEXT
        assert generated_frames.read_fingerprint(out) == "abc"
        assert generated_frames.read_facts(out)["recipe"] == "abc"
        with ExrFile(out) as file:
            assert file.header.texts[0][MANIFEST] == TEXT

    def test_of_parts_each_gets_its_own(self, tmp_path):
        source = double(tmp_path / "a.exr")
        with ExrFile(source) as file:
            names = [part.channels[0].raw_name for part in file.parts]
        assert names[1] == "V.Dirt.X"
        data = source.read_bytes()
        headers = read_headers(source)
        passed, _ = in_utf8(data)
        assert passed != data and restore_non_utf8(passed, headers) == data
        out = rewritten(source, tmp_path / "b.exr", ViewLayers("", "", refs("V.Combined.")))
        assert [h["note"] for h in read_headers(out)] == ["B\x01ume"]
