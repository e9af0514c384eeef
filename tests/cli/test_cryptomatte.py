"""Cryptomatte as ids: of what the user names, of what moves by itself, and where they are none."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import read_image
from exwarp_cli.io.shot import open_shot
from exwarp_cli.pipeline.depth_and_ids import read_ids
from tests.cli import shots
from tests.cli.conftest import run_quietly
from tests.cli.shots import VECTORS
from tests.cli.street import Street
from tests.matrix import spread
from tests.unit.cryptomatte_files import Style, attributes_of, planes_of

SMALL = shots.SMALL
NAMES = ("the box", "floor", "wall")
INDEX = "Object Index.X"
PLAIN = Style("CryptoObject", "CryptoObject")


def shares(street: Street, time: float) -> dict[str, np.ndarray]:
    """Which object each pixel's centre shows, by name: 1 or 0."""
    g = street.geometry(time)
    box, sky = g["id"] == 1, np.isinf(g["depth"])
    floor = (g["normal"][..., 1] == -1) & ~box
    return dict(zip(NAMES, (box, floor, ~box & ~floor & ~sky), strict=True))


def key_planes(street: Street, time: float) -> shots.Planes:
    """All passes but ids."""
    found = {k: v for group in shots.blender_passes(street, time) for k, v in group.items()}
    return {name: plane for name, plane in found.items() if name != INDEX}


def slot_planes(street: Street, time: float) -> shots.Planes:
    return {k: v for k, v in shots.slot_planes(street, time).items() if k != "IndexOB.X"}


def matte(street: Street, time: float, style: Style = PLAIN) -> shots.Planes:
    layers = planes_of(shares(street, time), style).values()
    return {name: plane for planes in layers for name, plane in planes.items()}


def with_matte(planes, style: Style = PLAIN, **header) -> shots.FrameWriter:
    def write(path: Path, street: Street, time: float) -> None:
        attributes = shots.header(**attributes_of(NAMES, style), **header)
        shots.write(path, {"": planes(street, time) | matte(street, time, style)}, attributes)

    return write


def with_index(planes) -> shots.FrameWriter:
    def write(path: Path, street: Street, time: float) -> None:
        index = {INDEX: street.geometry(time)["id"].astype(np.float32)}
        shots.write(path, {"": planes(street, time) | index})

    return write


def without_ids(path: Path, street: Street, time: float) -> None:
    shots.write(path, {"": key_planes(street, time)})


def slots_without_ids(path: Path, street: Street, time: float) -> None:
    shots.write(path, {"": slot_planes(street, time)})


def keys(folder: Path, frame: shots.FrameWriter, count: int = 3) -> Path:
    return shots.sequence(folder, frame, range(1, count + 1), SMALL)


def slots(folder: Path, frame: shots.FrameWriter) -> Path:
    return shots.sequence(folder, frame, range(1, 10), SMALL, 0.25)


@pytest.fixture(scope="module")
def only_matte(tmp_path_factory) -> Path:
    """Key frames whose only ids are Cryptomatte."""
    return keys(tmp_path_factory.mktemp("matte") / "keys", with_matte(key_planes))


@pytest.fixture(scope="module")
def only_index(tmp_path_factory) -> Path:
    """Key frames whose ids are numbers."""
    return keys(tmp_path_factory.mktemp("index") / "keys", with_index(key_planes))


@pytest.fixture(scope="module")
def bare(tmp_path_factory) -> Path:
    return keys(tmp_path_factory.mktemp("bare") / "keys", without_ids)


@pytest.fixture(scope="module")
def colour(tmp_path_factory) -> Path:
    return keys(tmp_path_factory.mktemp("colour") / "colour", shots.colour_only)


@pytest.fixture(scope="module")
def matte_slots(tmp_path_factory) -> Path:
    return slots(tmp_path_factory.mktemp("slots") / "slots", with_matte(slot_planes))


@pytest.fixture(scope="module")
def frames_of(tmp_path_factory) -> Callable[..., Path]:
    """Return the folder of a run on a sequence, by method and options; each made once."""
    root = tmp_path_factory.mktemp("frames")
    known: dict[tuple[object, ...], Path] = {}

    def run(sequence: Path, method: str, *options: object) -> Path:
        words = (sequence, "-m", method, *VECTORS, *options)
        if words not in known:
            known[words] = root / str(len(known))
            run_quietly("upsample", *words, "-o", known[words])
        return known[words]

    return run


def same_pictures(folder: Path, other: Path) -> None:
    assert shots.names(folder) == shots.names(other)
    assert len(shots.names(folder)) == 12
    for name in shots.names(folder):
        if int(name.split(".")[1]) % 4 != 1:  # rendered frames have other channels
            first, second = shots.colour_of(folder / name), shots.colour_of(other / name)
            np.testing.assert_array_equal(first, second, err_msg=name)


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


class TestNamed:
    @pytest.mark.parametrize("option", spread(["the box", "*box", "the*"], 2))
    def test_named_objects_are_the_stencil(self, frames_of, only_index, only_matte, option):
        index = frames_of(only_index, "softsplat")
        same_pictures(index, frames_of(only_matte, "softsplat", "--dynamic", option))
        with pytest.raises(AssertionError):
            same_pictures(index, frames_of(only_matte, "softsplat", "--dynamic", "wall"))

    def test_slots_tell_of_ids_where_there_are_some(
        self, frames_of, exwarp, colour, matte_slots, tmp_path
    ):
        given, option = (colour, "s6", "--gbuffers"), "--dynamic"
        index = frames_of(*given, slots(tmp_path / "index", with_index(slot_planes)))
        same_pictures(index, frames_of(*given, matte_slots, option, "the box"))
        with pytest.raises(AssertionError):
            same_pictures(index, frames_of(*given, matte_slots, option, "wall"))
        refused = exwarp("upsample", colour, "-o", tmp_path / "d", *VECTORS, option, "x")
        refused.refused(3, "colour/shot.####.exr has none")

    def test_it_comes_before_an_object_index(self, frames_of, only_index, tmp_path):
        def both(path: Path, street: Street, time: float) -> None:
            wrong = {INDEX: np.ones((street.height, street.width), np.float32)}
            attributes = shots.header(**attributes_of(NAMES, PLAIN))
            planes = key_planes(street, time) | matte(street, time) | wrong
            shots.write(path, {"": planes}, attributes)

        shot = open_shot(str(keys(tmp_path / "both", both)))
        assert Role.STENCIL in read_ids(None, shot, None)[0].layout
        assert Role.STENCIL not in read_ids("the*", shot, None)[0].layout
        named = frames_of(tmp_path / "both", "s6", "--dynamic", "the*")
        same_pictures(frames_of(only_index, "s6"), named)

    def test_a_file_of_its_own(self, frames_of, bare, only_index, tmp_path):
        apart = keys(tmp_path / "ids", with_matte(lambda *_: {}))
        given = ("--aov", f"stencil={apart}/shot.####.exr", "--dynamic", "the box")
        same_pictures(frames_of(only_index, "s6"), frames_of(bare, "s6", *given))

    def test_channels_named_by_hand_are_ids_not_numbers(self, frames_of, only_matte, tmp_path):
        (tmp_path / "m.toml").write_text('[channels]\nstencil = "CryptoObject00.r"\n')
        mapped = frames_of(only_matte, "s6", "--channel-map", tmp_path / "m.toml")
        same_pictures(frames_of(only_matte, "s6"), mapped)


class TestUnnamed:
    """No option says what moves: what an interval reads decides it."""

    @pytest.mark.parametrize("method", ["s6", "softsplat"])
    def test_what_moves_is_the_stencil(self, frames_of, only_matte, bare, method):
        found = frames_of(only_matte, method)
        same_pictures(frames_of(only_matte, method, "--dynamic", "the box"), found)
        with pytest.raises(AssertionError):
            same_pictures(found, frames_of(bare, method))

    @pytest.mark.parametrize("method", ["s6", "causal"])
    def test_so_it_is_by_slots(self, frames_of, colour, matte_slots, tmp_path, method):
        given = (colour, method, "--gbuffers")
        found = frames_of(*given, matte_slots)
        same_pictures(frames_of(*given, matte_slots, "--dynamic", "the box"), found)
        with pytest.raises(AssertionError):
            same_pictures(found, frames_of(*given, slots(tmp_path / "bare", slots_without_ids)))

    @pytest.mark.parametrize("setting", ["key", "slot"])
    def test_any_part_of_a_sequence_finds_what_the_whole_does(
        self, frames_of, upsample, only_matte, colour, matte_slots, tmp_path, setting
    ):
        given = () if setting == "key" else ("--gbuffers", matte_slots)
        sequence = only_matte if setting == "key" else colour
        for number in (3, 1):
            options = ("-m", "causal", *VECTORS, *given, "--frames", number)
            upsample(sequence, tmp_path / "parts", *options)
        shots.require_part(tmp_path / "parts", frames_of(sequence, "causal", *given), 8)


class TestManifests:
    def late(self, folder: Path) -> Path:
        """Key frames of which only the last one's manifest knows the box."""

        def frame(path: Path, street: Street, time: float) -> None:
            known = NAMES if time == 2 else NAMES[1:]
            attributes = shots.header(**attributes_of(known, PLAIN))
            shots.write(path, {"": key_planes(street, time) | matte(street, time)}, attributes)

        return keys(folder, frame)

    def test_any_part_of_a_sequence_finds_what_the_whole_does(self, upsample, tmp_path):
        sequence = self.late(tmp_path / "keys")
        given = ("-m", "softsplat", *VECTORS, "--dynamic", "the box")
        upsample(sequence, tmp_path / "whole", *given)
        upsample(sequence, tmp_path / "part", *given, "--frames", 1)
        shots.require_part(tmp_path / "part", tmp_path / "whole", 4)

    def test_a_file_beside(self, frames_of, only_matte, tmp_path):
        beside = replace(PLAIN, manifest=Path("ids.json"))
        sequence = keys(tmp_path / "keys", with_matte(key_planes, beside))
        manifest = attributes_of(NAMES, PLAIN)[f"cryptomatte/{PLAIN.key}/manifest"]
        (sequence / "ids.json").write_text(manifest)
        given = ("s6", "--dynamic", "the*")
        same_pictures(frames_of(only_matte, *given), frames_of(sequence, *given))

    def test_names_that_are_no_utf8(self, frames_of, upsample, only_matte, tmp_path):
        """As a program wrote it that took the artist's letters for Latin-1."""
        sequence = keys(tmp_path / "keys", with_matte(key_planes))
        spellings = b'"the box"', b'"th\xe9 box"'
        for path in sequence.iterdir():
            data = path.read_bytes()
            assert spellings[0] in data
            path.write_bytes(data.replace(*spellings))
        given, read = ("-m", "s6", *VECTORS), frames_of(only_matte, "s6")
        again = lambda *more: upsample(sequence, tmp_path / "b", *given, "--layers", "all", *more)  # noqa: E731
        again()
        assert shots.names(read) == shots.names(tmp_path / "b")
        for name in shots.names(tmp_path / "b"):
            written = tmp_path / "b" / name
            assert spellings[1] in written.read_bytes()
            expected = read_image(read / name).pixels
            np.testing.assert_array_equal(read_image(written).pixels, expected)
        assert shots.changed_by(lambda: again("--skip-existing"), tmp_path / "b") == set()

    def test_without_one_whole_names_do(self, frames_of, exwarp, only_matte, tmp_path):
        none = replace(PLAIN, manifest="none")
        sequence = keys(tmp_path / "keys", with_matte(key_planes, none))
        given = ("s6", "--dynamic", "the box")
        same_pictures(frames_of(only_matte, *given), frames_of(sequence, *given))
        exwarp("features", sequence, *VECTORS, "--dynamic", "the*").refused(
            2, "'the*' cannot be looked up", "its header has no manifest", "whole names"
        )

    def test_frames_are_made_anew_for_other_names(self, frames_of, upsample, only_matte, tmp_path):
        shutil.copytree(frames_of(only_matte, "s6", "--dynamic", "the box"), tmp_path / "out")

        def again(*options: str) -> set[int]:
            given = ("-m", "s6", *VECTORS, "--skip-existing", *options)
            run = lambda: upsample(only_matte, tmp_path / "out", *given)  # noqa: E731
            return shots.changed_by(run, tmp_path / "out")

        assert again("--dynamic", "*box") == set()
        assert again("--dynamic", "wall") == shots.generated(1, 2, 3)
        assert again() == shots.generated(1, 2, 3)


class TestFeatures:
    @pytest.mark.parametrize("setting", ["key", "slot"])
    def test_what_moves_is_counted_as_ids_have_it(self, exwarp, tmp_path, setting):
        def counted(name: str, ids, *options: str) -> list[str]:
            if setting == "key":
                given = (keys(tmp_path / name, ids(key_planes)),)
            else:
                colour = keys(tmp_path / name / "keys", shots.colour_only)
                given = (colour, "--gbuffers", slots(tmp_path / name / "slots", ids(slot_planes)))
            found = exwarp("features", *given, *VECTORS, *options, "--progress", "none")
            assert found.code == 0, found.err
            return [row["N_d"] for row in rows(found.out)]

        expected = counted("index", with_index)
        assert len(expected) == 15 and set(expected) == {"1"}
        # Nothing comes before the first instant, hence no camera.
        first = 5 if setting == "key" else 1
        assert counted("matte", with_matte)[first:] == expected[first:]
        assert counted("matte", with_matte, "--dynamic", "the box") == expected
        assert set(counted("matte", with_matte, "--dynamic", "the box,wall")) == {"2"}

    def test_the_report_says_where_ids_came_from(self, exwarp, upsample, only_matte, tmp_path):
        def reported(name: str, *options: str) -> tuple[str, list[str] | None, str]:
            out = tmp_path / name
            given = (
                only_matte,
                out / "frames",
                "--causal",
                "--policy",
                "paper",
                "--frames",
                2,
                *VECTORS,
                "--report",
                out / "report",
                *options,
            )
            run = upsample(*given, "--progress", "plain")
            document = json.loads((out / "report" / "report.json").read_text())
            page = (out / "report" / "report.html").read_text()
            assert ("moving by name" in page) and ("the box" in page) == bool(options)
            return document["policy"]["objects_from"], document["input"]["dynamic"], run.err

        source, names, err = reported("a", "--dynamic", "the*,wall")
        assert (source, names) == ("cryptomatte", ["the box", "wall"])
        assert "moving by name: 'the box', 'wall'" in err
        source, names, err = reported("b")
        assert (source, names) == ("cryptomatte", None)
        assert "count as moving; --dynamic says by name" in err and "by name:" not in err
        assert "of the Cryptomatte's objects those count as moving" in err


def halves(folder: Path) -> Path:
    with np.errstate(over="ignore"):
        return keys(folder, with_matte(key_planes, replace(PLAIN, dtype=np.float16)))


def lossy(folder: Path) -> Path:
    """DWA takes channels named R, G, B for colour."""
    style = replace(PLAIN, spelling="upper")
    header = {"compression": OpenEXR.DWAA_COMPRESSION}

    def frame(path: Path, street: Street, time: float) -> None:
        noise = np.random.default_rng(0).uniform(0.3, 0.6, (street.height, street.width))
        some = {name: part * noise for name, part in shares(street, time).items()}
        layers = planes_of(some, style).values()
        planes = {name: plane for group in layers for name, plane in group.items()}
        attributes = shots.header(**attributes_of(NAMES, style)) | header
        shots.write(path, {"": key_planes(street, time) | planes}, attributes)

    return keys(folder, frame)


class TestUnusable:
    @pytest.mark.parametrize(
        ("write", "words"),
        [
            (halves, ("does not hold the ids", "32-bit floats")),
            (lossy, ("'CryptoObject'", "lossy compression", "ZIP")),
        ],
    )
    def test_ids_without_their_bits(self, exwarp, upsample, tmp_path, write, words):
        sequence = write(tmp_path / "keys")
        given = ("upsample", sequence, "-o", tmp_path / "out", *VECTORS, "--dynamic", "the box")
        exwarp(*given).refused(3, "shot.0001.exr", *words)
        assert shots.names(tmp_path / "out") == []
        # No option asks for the ids: they are left alone, and inspect says so.
        upsample(sequence, tmp_path / "b", "-m", "s6", *VECTORS)
        found = exwarp("features", sequence, *VECTORS, "--progress", "none")
        assert found.code == 0 and {row["N_d"] for row in rows(found.out)[5:]} == {"1"}
        shown = exwarp("inspect", sequence, "--json").out
        (cryptomatte,) = json.loads(shown)["cryptomattes"]
        assert cryptomatte["names"] == [] and words[-1] in cryptomatte["problem"]
        assert (
            f"Cryptomatte CryptoObject (object): {cryptomatte['problem']}"
            in exwarp("inspect", sequence).out
        )

    def test_names_that_are_not_there(self, exwarp, only_matte, tmp_path):
        given = ("upsample", only_matte, "-o", tmp_path / "out", *VECTORS, "--dynamic")
        exwarp(*given, "the box,car*").refused(
            2, "--dynamic 'car*' matches no name", "which have 'floor', 'the box', 'wall'; name"
        )
        exwarp(*given, " , ").refused(2, "--dynamic names nothing")
        assert shots.names(tmp_path / "out") == []

    def test_no_cryptomatte(self, exwarp, bare):
        exwarp("features", bare, "--dynamic", "x").refused(3, "keys/shot.####.exr has none")


def test_inspect_lists_names(exwarp, only_matte):
    found = exwarp("inspect", only_matte).out
    assert "Cryptomatte CryptoObject (object), 3 names: 'floor', 'the box', 'wall'" in found
    document = json.loads(exwarp("inspect", only_matte, "--json", "--dynamic", "*o*").out)
    assert document["dynamic"] == ["floor", "the box"]
    assert document["cryptomattes"][0]["names"] == ["floor", "the box", "wall"]
    assert "moving by name: floor\n" in exwarp("inspect", only_matte, "--dynamic", "fl*").out


def test_a_layer_that_only_the_header_knows_is_no_colour(exwarp, tmp_path):
    """Its channels look like a beauty's, and the sequence has none."""
    style = Style("light", "light", spelling="upper")

    def frame(path: Path, street: Street, time: float) -> None:
        (layer,) = planes_of(shares(street, time), style, ranks=2).values()
        shots.write(path, {"": layer}, shots.header(**attributes_of(NAMES, style)))

    sequence = keys(tmp_path / "keys", frame)
    exwarp("upsample", sequence, "-o", tmp_path / "out").refused(3, "no colour channels")
